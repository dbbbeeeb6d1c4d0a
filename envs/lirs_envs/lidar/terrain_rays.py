"""Rays against a height field: down and up its maximum-mipmap, then cell by cell through a block.

The kernels are inlined into one: a call would count references to each array, which costs more than a step.
An unsigned index spares numba's look for a negative one, and numpy's error model the one for a divisor of 0,
which none of them has: a tenth of the time.
"""

from __future__ import annotations

import numpy as np

from lirs_envs.lidar.clipping import FAR, clip, inverse
from lirs_envs.lidar.mipmap import EDGE, LEAF, ROW, TerrainMipmap
from lirs_envs.lidar.ray_bundles import BUNDLE, SMALLEST_FIELD, safe_distance
from lirs_wct.arrays import Float32Array, FloatArray
from lirs_wct.kernels import njit

Ray = tuple[float, float, float, float, float, float]
"""u, v, w: start, in cells from the south-west node and meters up; du, dv, dw: its change per meter."""
GridStep = tuple[float, float, float, float, int, int]
"""per_u, per_v: meters along the ray a cell of each axis, 0 = it crosses none; far_u, far_v: FAR where it
does not, else 0; east, north: 1 = the ray runs up that axis (Amanatides and Woo, "A fast voxel traversal
algorithm for ray tracing", 1987)."""
START_LEVEL = 6
"""Squares of 64 cells: the fastest start, measured from 257^2 to 4097^2."""
NEAR_LEVEL = 4
"""The same, of 16 cells, where a bundle has come near the ground."""
BORDER = 1e-9
"""Cells by which the border reaches out, so that rounding puts no ray on it outside."""
FUSED = {"contract"}
"""Products and sums in one instruction, and nothing else that changes a result."""


@njit(cache=True, error_model="numpy", fastmath=FUSED)
def terrain_ranges(
    terrain: TerrainMipmap, origins: FloatArray, directions: FloatArray, max_range: float, ranges: FloatArray
) -> None:
    """Shorten `ranges` (n,) to the first triangle on each ray within `max_range`.

    All rays start at one origin (1, 3), or each at its own (n, 3).
    """
    frame, (nx, ny) = terrain.frame, terrain.cells
    per_x, per_y = 1.0 / frame[2], 1.0 / frame[3]
    low, high = frame[4] - frame[6], frame[5] + frame[6]
    u, v, w, i0, j0, above, safe, bundled = 0.0, 0.0, 0.0, 0, 0, 0.0, 0.0, False
    for k in range(len(directions)):
        if k < len(origins):
            u, v, w = (origins[k, 0] - frame[0]) * per_x, (origins[k, 1] - frame[1]) * per_y, origins[k, 2]
            i0, j0 = min(max(int(u), 0), nx - 1), min(max(int(v), 0), ny - 1)
            # Where a ray starts in the field's box, which is the same for all of one origin.
            above = w - _surface(terrain, i0, j0, u - i0, v - j0)
            over = 0.0 <= u <= nx and 0.0 <= v <= ny and above > 0.0
            bundled = over and len(origins) == 1 and min(nx, ny) >= SMALLEST_FIELD
        if bundled and k % BUNDLE == 0:
            safe = safe_distance(terrain, (u, v, w), directions[k : k + BUNDLE], max_range)
        du, dv, dw = directions[k, 0] * per_x, directions[k, 1] * per_y, directions[k, 2]
        per_u, per_v = inverse(du), inverse(dv)
        t, t_end = clip(u, per_u, -BORDER, nx + BORDER, safe, min(max_range, ranges[k]))
        t, t_end = clip(v, per_v, -BORDER, ny + BORDER, t, t_end)
        t, t_end = clip(w, inverse(dw), low, high, t, t_end)
        if t <= t_end:
            i, j, height = i0, j0, above
            if t > 0.0:
                i, j = min(max(int(u + t * du), 0), nx - 1), min(max(int(v + t * dv), 0), ny - 1)
                if not bundled:
                    height = w + t * dw - _surface(terrain, i, j, u + t * du - i, v + t * dv - j)
            far_u, far_v = 0.0 if per_u != 0.0 else FAR, 0.0 if per_v != 0.0 else FAR
            step = (per_u, per_v, far_u, far_v, 1 if du > 0.0 else 0, 1 if dv > 0.0 else 0)
            ray = (u, v, w, du, dv, dw)
            level = NEAR_LEVEL if bundled else START_LEVEL
            hit = _traverse(terrain, (i, j), ray, step, height, t, t_end, level)
            ranges[k] = min(ranges[k], hit)


@njit(cache=True, error_model="numpy", forceinline=True, fastmath=FUSED)
def _traverse(
    terrain: TerrainMipmap,
    cell: tuple[int, int],
    ray: Ray,
    step: GridStep,
    height: float,
    t: float,
    t_end: float,
    level: int,
) -> float:
    """Return where a ray meets the surface in [t, t_end], which lies in the field's box, else inf.

    At t it is in `cell`, `height` above the surface. Begins with squares of `level`, descends into one only
    where the ray, over its stretch through it, is not wholly above its maximum (from below: not wholly below
    its minimum). Cells are stepped in integers: rounding moves a crossing by 1e-12 cells and never loses one.
    """
    if height == 0.0:
        return t
    bound, start, width = terrain.bound, terrain.start, terrain.width
    (nx, ny), (i, j), top = terrain.cells, cell, len(width) - 1
    u, v, w, du, dv, dw = ray
    per_u, per_v, far_u, far_v, east, north = step
    side = 1.0 if height > 0.0 else -1.0
    first = 0 if height > 0.0 else len(bound) // 2
    w, dw = side * w, side * dw
    level = max(min(top, level), LEAF)
    while True:
        c, r = i >> level, j >> level
        tx = (((c + east) << level) - u) * per_u + far_u
        ty = (((r + north) << level) - v) * per_v + far_v
        t_out = max(t, min(tx, ty, t_end))
        row = np.uint64(level)
        square = first + start[row] + r * width[row] + c
        if w + dw * (t if dw > 0.0 else t_out) <= bound[np.uint64(square)]:
            if level > LEAF:
                level -= 1
                continue
            number = np.uint64(r * width[LEAF] + c)
            hit: float = _block_range(
                terrain.block, number, (i, j), (u, v, w, du, dv, dw), step, side, t, t_out
            )
            if hit < np.inf:
                return hit
        if t_out >= t_end:
            return np.inf
        t = t_out
        if tx <= ty:
            i = ((c + east) << level) + east - 1
            j = min(max(int(v + t * dv), r << level), min(((r + 1) << level), ny) - 1)
        else:
            j = ((r + north) << level) + north - 1
            i = min(max(int(u + t * du), c << level), min(((c + 1) << level), nx) - 1)
        if i < 0 or j < 0 or i >= nx or j >= ny:
            return np.inf
        if level < top and ((i >> level) >> 1 != c >> 1 or (j >> level) >> 1 != r >> 1):
            level += 1


@njit(cache=True, error_model="numpy", forceinline=True, fastmath=FUSED)
def _surface(terrain: TerrainMipmap, i: int, j: int, a: float, b: float) -> float:
    """Return the height of the surface in cell (j, i), a to the east and b to the north of its corner."""
    block, number = terrain.block, np.uint64((j >> LEAF) * terrain.width[LEAF] + (i >> LEAF))
    node = ROW * (j % EDGE) + i % EDGE
    # float() of a float32 stays one in numba, and the differences below would be rounded to it.
    sw, ne = np.float64(block[number, node]), np.float64(block[number, node + ROW + 1])
    # The diagonal runs from south-west to north-east: a = b.
    if a >= b:
        se = np.float64(block[number, node + 1])
        return sw + a * (se - sw) + b * (ne - se)
    nw = np.float64(block[number, node + ROW])
    return sw + a * (ne - nw) + b * (nw - sw)


@njit(cache=True, error_model="numpy", forceinline=True, fastmath=FUSED)
def _block_range(
    block: Float32Array,
    number: int,
    cell: tuple[int, int],
    ray: Ray,
    step: GridStep,
    side: float,
    t: float,
    t_end: float,
) -> float:
    """Return where a ray on `side` of the surface meets a block in [t, t_end], else inf.

    The ray's w and dw are multiplied by the side. It begins in `cell`, which is one of the block's.
    """
    i, j = cell
    u, v, w, du, dv, dw = ray
    per_u, per_v, far_u, far_v, east, north = step
    c, r = i >> LEAF, j >> LEAF
    tx, ty = (i + east - u) * per_u + far_u, (j + north - v) * per_v + far_v
    while True:
        node = np.uint64(ROW * (j & (EDGE - 1)) + (i & (EDGE - 1)))
        sw, se = block[number, node], block[number, node + np.uint64(1)]
        nw, ne = block[number, node + np.uint64(ROW)], block[number, node + np.uint64(ROW + 1)]
        top = np.float64(max(sw, se, nw, ne)) if side > 0.0 else -np.float64(min(sw, se, nw, ne))
        t_out = max(t, min(tx, ty, t_end))
        if w + dw * (t if dw > 0.0 else t_out) <= top:
            corners = (
                side * np.float64(sw),
                side * np.float64(se),
                side * np.float64(nw),
                side * np.float64(ne),
            )
            hit: float = _cell_range(corners, (u - i, v - j, w, du, dv, dw), t, t_out)
            if hit < np.inf:
                return hit
        if t_out >= t_end:
            return np.inf
        t = t_out
        if tx <= ty:
            i += 2 * east - 1
            tx = (i + east - u) * per_u + far_u
        else:
            j += 2 * north - 1
            ty = (j + north - v) * per_v + far_v
        if i >> LEAF != c or j >> LEAF != r:
            return np.inf


@njit(cache=True, error_model="numpy", forceinline=True, fastmath=FUSED)
def _cell_range(corners: tuple[float, float, float, float], ray: Ray, t: float, t_out: float) -> float:
    """Return where a ray above the surface meets a cell's two triangles in [t, t_out], else inf.

    The ray's u and v begin at the cell's corner. Over each triangle (ray - surface) is linear in t. It was
    above 0 before, so that a value of 0 or less at the end of a segment is a hit within it.
    """
    sw, se, nw, ne = corners
    a, b, w, du, dv, dw = ray
    t_diagonal = (b - a) / (du - dv) if du != dv else t
    segments = 2 if t < t_diagonal < t_out else 1
    for segment in range(segments):
        begin = t_diagonal if segment == 1 else t
        end = t_diagonal if segment + 1 < segments else t_out
        middle = 0.5 * (begin + end)
        if a + middle * du >= b + middle * dv:
            gx, gy = se - sw, ne - se
        else:
            gx, gy = ne - nw, nw - sw
        height = w - (sw + a * gx + b * gy)
        slope = dw - (du * gx + dv * gy)
        if height + end * slope <= 0.0:
            # Not falling, it was at 0 or less from the beginning, by rounding.
            return min(max(-height / slope, begin), end) if slope < 0.0 else begin
    return np.inf
