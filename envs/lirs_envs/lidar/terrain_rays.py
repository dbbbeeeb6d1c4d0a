"""Ray casting against a height field by traversal of its maximum mipmap.

After Tevs, Ihrke, Seidel 2008, "Maximum mipmaps for fast, accurate, and scalable dynamic height field
rendering": level k bounds squares of 2^k x 2^k cells. A ray above the surface needs the maximum only and
a ray below it the minimum only, so the two are stored separately.

The finest level has squares of 8 x 8 cells, blocks whose nodes are adjacent in memory. A ray through a block
touches few cache lines; with rows of the whole field each row would lie on its own page.

Neighboring beams of one lidar form a bundle. Interval arithmetic on their directions gives the box of cells
below them along a stretch and their lowest height there. Where that height is above the maximum of the
squares below the box, no beam hits the ground: one test then serves all beams of the bundle.

The kernels are inlined into one: a call would count references to each array, which costs more than a step.
An unsigned index saves numba's test for negative indices, which do not occur here.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lirs_wct.geometry import Float32Array, FloatArray, HeightField, IntArray, njit

LEAF = 3
"""Level of the blocks, which hold 2^LEAF x 2^LEAF cells."""
EDGE = 2**LEAF
"""Cells along a block's side."""
ROW = EDGE + 1
"""Nodes along a block's side; neighbors hold the nodes between them both."""


class TerrainMipmap(NamedTuple):
    """A height field as the kernels read it; row 0 = south.

    Attributes:
        block: (blocks, ROW * ROW) float32 heights of each block's nodes, row by row, meters; beyond the
            field's edge its last node again.
        bound: flat float32: for levels LEAF, LEAF + 1, ... one after the other the highest z over each
            square; then once more the highest of -z, so that one comparison serves both sides.
        start: (levels + 1,) index of each level's first square; entries below LEAF are unused.
        width: (levels + 1,) squares a row of each level; entries below LEAF are unused.
        frame: (7,) x and y of the south-west node, cell x and y, lowest and highest z, margin; meters.
        cells: columns and rows.
    """

    block: Float32Array
    bound: Float32Array
    start: IntArray
    width: IntArray
    frame: FloatArray
    cells: tuple[int, int]


def build_terrain_mipmap(surface: HeightField) -> TerrainMipmap:
    """Build blocks and bounds of a height field."""
    z = surface.south_up
    rows, cols = (-(-(nodes - 1) // EDGE) for nodes in z.shape)
    missing = [(0, EDGE * n + 1 - nodes) for n, nodes in zip((rows, cols), z.shape, strict=True)]
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(z, missing, mode="edge"), (ROW, ROW))
    block = windows[::EDGE, ::EDGE].reshape(rows, cols, ROW * ROW)
    levels = [np.stack((block.max(axis=-1), -block.min(axis=-1)))]
    while levels[-1][0].size > 1:
        even = np.pad(levels[-1], ((0, 0), *((0, n % 2) for n in levels[-1].shape[1:])), mode="edge")
        of_rows = np.maximum(even[:, ::2], even[:, 1::2])
        levels.append(np.maximum(of_rows[:, :, ::2], of_rows[:, :, 1::2]))
    bound = np.concatenate([level.reshape(2, -1) for level in levels], axis=1)
    ends = np.cumsum([level[0].size for level in levels])
    unused = (0,) * LEAF
    start = np.array((*unused, 0, *ends[:-1]), dtype=np.int64)
    width = np.array((*unused, *(level.shape[2] for level in levels)), dtype=np.int64)
    low, high = float(z.min()), float(z.max())
    # A ray enters the slab of heights this far from the surface, so that rounding cannot put it on the
    # wrong side there.
    margin = 1e-3 + 0.01 * (high - low) + 1e-6 * max(abs(low), abs(high))
    frame = np.array((*surface.origin, *surface.cell, low, high, margin), dtype=np.float64)
    cells = (z.shape[1] - 1, z.shape[0] - 1)
    return TerrainMipmap(block.reshape(-1, ROW * ROW), bound.ravel(), start, width, frame, cells)


FAR_DISTANCE = 1e300
"""Finite substitute for infinity, so that products with 0 stay numbers."""


@njit(forceinline=True)
def inverse(slope: float) -> float:
    """Return 1 / slope; 0 for a slope of at most 1e-14.

    Such a slope moves no ray by more than rounding does.
    """
    return 1.0 / slope if abs(slope) > 1e-14 else 0.0


@njit(forceinline=True)
def clip(o: float, per: float, low: float, high: float, t0: float, t1: float) -> tuple[float, float]:
    """Return the part of [t0, t1] with low <= o + t / per <= high.

    It is empty when its start is after its end.

    `per` is the inverse of the slope, 0 for a slope of 0.
    """
    if per == 0.0:
        return (t0, t1) if low <= o <= high else (1.0, 0.0)
    a, b = (low - o) * per, (high - o) * per
    return max(t0, min(a, b)), min(t1, max(a, b))


BUNDLE = 16
"""Beams of a bundle: 8 are a third more questions, 32 spread over too much ground."""
SMALLEST_FIELD = 400
"""Cells along the shorter side from which bundles gain; a ray crosses a smaller field in a few steps."""
CLEARANCE = 1e-6
"""Meters by which beams stay above a bound, far more than rounding."""


@njit
def safe_distance(
    terrain: TerrainMipmap, start: tuple[float, float, float], directions: FloatArray, max_range: float
) -> float:
    """Return a distance, at most `max_range`, without ground hits for all beams (n, 3) of a bundle, meters.

    The start is u, v, w: in cells from the south-west node, over the field, and meters up.
    """
    (u, v, w), (nx, ny) = start, terrain.cells
    per_x, per_y = 1.0 / terrain.frame[2], 1.0 / terrain.frame[3]
    least_u, most_u, least_v, most_v, least_w = np.inf, -np.inf, np.inf, -np.inf, np.inf
    for k in range(len(directions)):
        du, dv = directions[k, 0] * per_x, directions[k, 1] * per_y
        least_u, most_u = min(least_u, du), max(most_u, du)
        least_v, most_v = min(least_v, dv), max(most_v, dv)
        least_w = min(least_w, directions[k, 2])
    speed = max(-least_u, most_u, -least_v, most_v)
    if speed <= 0.0:
        return 0.0
    # Beyond this distance the fastest beam has left the field.
    reach, per_cell = min(max_range, (nx + ny) / speed), 1.0 / speed
    # Not `LEAF` itself: for a literal, numba would compile `_highest` a second time.
    top, level, t = len(terrain.width) - 1, int(np.int64(LEAF)), 0.0
    while t < reach:
        t_out = min(t + (1 << level) * per_cell, reach)
        west, east = u + min(least_u * t, least_u * t_out), u + max(most_u * t, most_u * t_out)
        south, north = v + min(least_v * t, least_v * t_out), v + max(most_v * t, most_v * t_out)
        if west > nx or east < 0.0 or south > ny or north < 0.0:
            return max_range
        box = (max(int(west), 0), max(int(south), 0), min(int(east), nx - 1), min(int(north), ny - 1))
        if w + min(least_w * t, least_w * t_out) > _highest(terrain, box, level) + CLEARANCE:
            t, level = t_out, min(level + 1, top)
        elif level > LEAF:
            level -= 1
        else:
            break
    return t


@njit(forceinline=True)
def _highest(terrain: TerrainMipmap, box: tuple[int, int, int, int], level: int) -> float:
    """Return the highest bound of a level's squares that cover a box of cells.

    The box is west, south, east, north.
    """
    # Unsigned: an index that might be negative costs a comparison.
    row, highest = np.uint64(level), np.float32(-np.inf)
    first, width = terrain.start[row], terrain.width[row]
    west, south, east, north = box
    for r in range(south >> level, (north >> level) + 1):
        for c in range(west >> level, (east >> level) + 1):
            highest = max(highest, terrain.bound[np.uint64(first + r * width + c)])
    return np.float64(highest)


Ray = tuple[float, float, float, float, float, float]
"""u, v, w: start, in cells from the south-west node and meters up; du, dv, dw: its change per meter."""
GridStep = tuple[float, float, float, float, int, int]
"""per_u, per_v: meters along the ray a cell of each axis, 0 = it crosses none; far_u, far_v: FAR_DISTANCE
where it does not, else 0; east, north: 1 = the ray runs up that axis (Amanatides and Woo, "A fast voxel
traversal algorithm for ray tracing", 1987)."""
START_LEVEL = 6
"""Squares of 64 cells: the fastest start, measured from 257^2 to 4097^2."""
NEAR_LEVEL = 4
"""Start level with squares of 16 cells, after a bundle has come near the ground."""
BORDER = 1e-9
"""Margin of the border in cells, so that rounding puts no ray on the border outside."""
FUSED = {"contract"}
"""Fast-math flags: fused multiply-add only, no other change of results."""


@njit(fastmath=FUSED)
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
            # Start in the field's box, common to all rays of one origin.
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
            far_u, far_v = 0.0 if per_u != 0.0 else FAR_DISTANCE, 0.0 if per_v != 0.0 else FAR_DISTANCE
            step = (per_u, per_v, far_u, far_v, 1 if du > 0.0 else 0, 1 if dv > 0.0 else 0)
            ray = (u, v, w, du, dv, dw)
            level = NEAR_LEVEL if bundled else START_LEVEL
            hit = _traverse(terrain, (i, j), ray, step, height, t, t_end, level)
            ranges[k] = min(ranges[k], hit)


@njit(forceinline=True, fastmath=FUSED)
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
    """Return the distance of a ray's first surface hit in [t, t_end], else inf.

    The interval lies in the field's box.

    At t the ray is in `cell`, `height` above the surface. The traversal begins with squares of `level`. It
    descends into a square only if the ray inside it is not wholly above its maximum (from below: not wholly
    below its minimum). Cells are stepped in integers: rounding moves a crossing by 1e-12 cells and never
    loses one.
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
    lifted = (u, v, w, du, dv, dw)
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
            hit: float = _block_range(terrain.block, number, (i, j), lifted, step, side, t, t_out)
            if hit < np.inf:
                return hit
        if t_out >= t_end:
            return np.inf
        t = t_out
        if tx <= ty:
            i, j = _next_cells(c, east, r, v + t * dv, level, ny)
        else:
            j, i = _next_cells(r, north, c, u + t * du, level, nx)
        if i < 0 or j < 0 or i >= nx or j >= ny:
            return np.inf
        if level < top and ((i >> level) >> 1 != c >> 1 or (j >> level) >> 1 != r >> 1):
            level += 1


@njit(forceinline=True, fastmath=FUSED)
def _next_cells(square: int, up: int, beside: int, at: float, level: int, count: int) -> tuple[int, int]:
    """Return the cell of a ray that leaves a square of a level, along the axis that it leaves and across it.

    Args:
        square: Number of the square along the axis.
        up: 1 = the ray runs up the axis, else 0.
        beside: Number of the square across the axis.
        at: Position across the axis, cells.
        level: Level of the square.
        count: Number of cells across the axis.
    """
    along = ((square + up) << level) + up - 1
    return along, min(max(int(at), beside << level), min((beside + 1) << level, count) - 1)


@njit(forceinline=True, fastmath=FUSED)
def _surface(terrain: TerrainMipmap, i: int, j: int, a: float, b: float) -> float:
    """Return the surface height in cell (j, i).

    a and b are the distances east and north of the cell's corner, cells.
    """
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


@njit(forceinline=True, fastmath=FUSED)
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
    """Return the distance of a ray's hit in a block in [t, t_end], else inf.

    The ray is on `side` of the surface.

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


@njit(forceinline=True, fastmath=FUSED)
def _cell_range(corners: tuple[float, float, float, float], ray: Ray, t: float, t_out: float) -> float:
    """Return the distance of a ray's hit on a cell's two triangles, else inf.

    The interval is [t, t_out], the ray starts above the surface.

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
            # A ray that does not fall was at 0 or less from the start, by rounding.
            return min(max(-height / slope, begin), end) if slope < 0.0 else begin
    return np.inf


@njit
def side_ranges(
    terrain: TerrainMipmap,
    base: float,
    origin: FloatArray,
    directions: FloatArray,
    max_range: float,
    ranges: FloatArray,
) -> None:
    """Shorten `ranges` (n,) of rays from one origin to the side walls and the bottom of a solid height field.

    The bottom is at height `base`, below all nodes.
    """
    frame, cells = terrain.frame, terrain.cells
    size = (cells[0] * frame[2], cells[1] * frame[3])
    start = (origin[0] - frame[0], origin[1] - frame[1])
    for k in range(len(directions)):
        rise, nearest = directions[k, 2], min(max_range, ranges[k])
        for axis in range(2):
            other, slope = 1 - axis, directions[k, axis]
            for side in range(2):
                t = (side * size[axis] - start[axis]) / slope if slope != 0.0 else -1.0
                across = start[other] + t * directions[k, other]
                if 0.0 <= t <= nearest and 0.0 <= across <= size[other]:
                    z = origin[2] + t * rise
                    at = (side * cells[axis], across / frame[2 + other])
                    i, j = at if axis == 0 else (at[1], at[0])
                    column, row = min(int(i), cells[0] - 1), min(int(j), cells[1] - 1)
                    if base <= z <= _surface(terrain, column, row, i - column, j - row):
                        nearest = ranges[k] = t
        t = (base - origin[2]) / rise if rise != 0.0 else -1.0
        x, y = start[0] + t * directions[k, 0], start[1] + t * directions[k, 1]
        if 0.0 <= t <= nearest and 0.0 <= x <= size[0] and 0.0 <= y <= size[1]:
            ranges[k] = t
