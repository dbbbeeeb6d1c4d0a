"""Ray casting against wall cells of a laser map and against walkers, and the intensity of returns.

Free space between walls is skipped by distance. Walkers are upright capsules, all of one size.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np

from lirs_envs.lidar.terrain_rays import EDGE, FAR_DISTANCE, LEAF, ROW, TerrainMipmap, clip, inverse
from lirs_envs.walkers import HALF_LENGTH, RADIUS
from lirs_wct.geometry import BoolArray, ByteArray, Float32Array, FloatArray, WallGrid, njit

BLOCK = 16
"""Number of neighboring rays tested together: they mostly miss a walker together."""
SAME = 1e-5
"""Tolerance of equal ranges to a walker, meters: MuJoCo's and the builtin rays round differently."""


class WallCells(NamedTuple):
    """Walls as the kernels read them.

    Attributes:
        distance: (rows, cols) uint8, row 0 = south: cells to the nearest wall cell in the larger of the two
            directions (0 = wall), at most 255; without walls (0, 0).
        frame: (6,) x and y of the outer corner of cell (0, 0), cosine and sine of the grid's yaw,
            resolution, height.
        hole: (rows, cols) bool, cells without floor; without holes (0, 0).
    """

    distance: ByteArray
    frame: FloatArray
    hole: BoolArray


NO_WALLS = WallCells(np.zeros((0, 0), np.uint8), np.zeros(6), np.zeros((0, 0), np.bool_))


def build_wall_cells(walls: WallGrid) -> WallCells:
    """Build the distances to the walls; none when there is no wall cell."""
    distance, _, hole = NO_WALLS
    if walls.solid.any():
        cells = cv2.distanceTransform((~walls.solid).astype(np.uint8), cv2.DIST_C, 3)
        distance = np.minimum(cells, 255).astype(np.uint8)
    if walls.hole is not None:
        hole = np.ascontiguousarray(walls.hole)
    T = walls.origin
    frame = np.array((T.x, T.y, math.cos(T.yaw), math.sin(T.yaw), walls.resolution, walls.height))
    return WallCells(distance, frame, hole)


@njit
def wall_ranges(
    walls: WallCells, origins: FloatArray, directions: FloatArray, max_range: float, ranges: FloatArray
) -> None:
    """Fill `ranges` (n,) with the distance to the first wall cell on each ray; inf = none within `max_range`.

    All rays start at one origin (1, 3), or each at its own (n, 3).
    """
    ranges[:] = np.inf
    distance, frame = walls.distance, walls.frame
    if distance.size == 0:
        return
    ny, nx = distance.shape
    c, s, per_meter, height = frame[2], frame[3], 1.0 / frame[4], frame[5]
    u, v, z = 0.0, 0.0, 0.0
    for k in range(len(directions)):
        if k < len(origins):
            x, y, z = origins[k, 0] - frame[0], origins[k, 1] - frame[1], origins[k, 2]
            u, v = (c * x + s * y) * per_meter, (c * y - s * x) * per_meter
        du = (c * directions[k, 0] + s * directions[k, 1]) * per_meter
        dv = (c * directions[k, 1] - s * directions[k, 0]) * per_meter
        per_u, per_v = inverse(du), inverse(dv)
        t, t_end = clip(u, per_u, 0.0, float(nx), 0.0, max_range)
        t, t_end = clip(v, per_v, 0.0, float(ny), t, t_end)
        t, t_end = clip(z, inverse(directions[k, 2]), 0.0, height, t, t_end)
        if t <= t_end:
            ranges[k] = _first_wall(distance, (u, v, du, dv, per_u, per_v), t, t_end)


@njit
def remove_hits_in_holes(
    walls: WallCells, origins: FloatArray, directions: FloatArray, wall_range: FloatArray, ranges: FloatArray
) -> None:
    """Replace hits on floor holes by the range of the wall behind, or inf."""
    rows, cols = walls.hole.shape
    x0, y0, c, s, resolution = walls.frame[0], walls.frame[1], walls.frame[2], walls.frame[3], walls.frame[4]
    for k in range(len(ranges)):
        if ranges[k] < wall_range[k]:
            start = min(k, len(origins) - 1)
            x = origins[start, 0] + ranges[k] * directions[k, 0] - x0
            y = origins[start, 1] + ranges[k] * directions[k, 1] - y0
            i, j = math.floor((c * x + s * y) / resolution), math.floor((c * y - s * x) / resolution)
            if 0 <= i < cols and 0 <= j < rows and walls.hole[j, i]:
                ranges[k] = wall_range[k]


@njit(forceinline=True)
def _first_wall(
    distance: ByteArray, ray: tuple[float, float, float, float, float, float], t: float, t_end: float
) -> float:
    """Return where a ray enters the first wall cell in [t, t_end], else inf.

    Around a cell at distance d every cell nearer than d is free: the ray leaves that square in one step.
    At a corner it steps through one of the two neighbors, so that it never slips between two cells that
    touch at a corner only.
    """
    u, v, du, dv, per_u, per_v = ray
    ny, nx = distance.shape
    east, north = 1 if du > 0.0 else 0, 1 if dv > 0.0 else 0
    far_u, far_v = 0.0 if per_u != 0.0 else FAR_DISTANCE, 0.0 if per_v != 0.0 else FAR_DISTANCE
    i, j = min(max(int(u + t * du), 0), nx - 1), min(max(int(v + t * dv), 0), ny - 1)
    while True:
        free = np.int64(distance[j, i])  # int() of an unsigned stays unsigned in numba
        if free == 0:
            return t
        tx = ((i + free if east else i + 1 - free) - u) * per_u + far_u
        ty = ((j + free if north else j + 1 - free) - v) * per_v + far_v
        t = max(t, min(tx, ty))
        if t >= t_end:
            return np.inf
        if tx <= ty:
            j = min(max(int(v + t * dv), j + 1 - free, 0), j + free - 1, ny - 1)
            i += free if east else -free
        else:
            i = min(max(int(u + t * du), i + 1 - free, 0), i + free - 1, nx - 1)
            j += free if north else -free
        if i < 0 or j < 0 or i >= nx or j >= ny:
            return np.inf


@njit
def meet_walkers(
    centers: FloatArray,
    origins: FloatArray,
    directions: FloatArray,
    max_range: float,
    ranges: FloatArray,
    nearest: FloatArray,
    met: BoolArray,
) -> None:
    """Fill `nearest` (n,) with the nearer of `ranges` (n,) and walkers (m, 3), `met` (n,) with walker hits.

    All rays start at one origin (1, 3), or each at its own (n, 3). The ranges may already be those to the
    walkers.
    """
    nearest[:] = np.inf
    if len(origins) == 1:
        _cast_fan(centers, origins[0], directions, max_range, nearest)
    else:
        for k in range(len(directions)):
            _cast_fan(centers, origins[k], directions[k : k + 1], max_range, nearest[k : k + 1])
    for k in range(len(directions)):
        met[k] = nearest[k] < np.inf and nearest[k] <= ranges[k] + SAME
        nearest[k] = min(nearest[k], ranges[k])


def capsule_normals(centers: FloatArray, points: FloatArray) -> FloatArray:
    """Return (n, 3) normals of the walkers nearest to points (n, 3) on them, not normalized."""
    offsets = points[:, None] - centers
    offsets[..., 2] -= np.clip(offsets[..., 2], -HALF_LENGTH, HALF_LENGTH)
    nearest = np.square(offsets).sum(axis=2).argmin(axis=1)
    normals: FloatArray = offsets[np.arange(len(points)), nearest]
    return normals


@njit
def _cast_fan(
    centers: FloatArray, origin: FloatArray, directions: FloatArray, max_range: float, nearest: FloatArray
) -> None:
    """Shorten `nearest` (n,) of rays from one origin."""
    n = len(directions)
    blocks = -(-n // BLOCK)
    cones = np.empty((blocks, 3))
    for j in range(blocks):
        _bound_block(directions[j * BLOCK : min((j + 1) * BLOCK, n)], cones[j])
    for m in range(len(centers)):
        x, y, z = origin[0] - centers[m, 0], origin[1] - centers[m, 1], origin[2] - centers[m, 2]
        distance = math.sqrt(x * x + y * y)
        if distance - RADIUS > max_range:
            continue
        # Half the horizontal angle of the walker.
        sine = RADIUS / distance if distance > RADIUS else 1.0
        cosine = math.sqrt(1.0 - sine * sine)
        for j in range(blocks):
            towards = -(x * cones[j, 0] + y * cones[j, 1]) / distance if distance > RADIUS else 1.0
            spread = cones[j, 2]
            # A spread of -1 is the whole circle: every walker may be hit.
            if spread > -1.0 and towards < cosine * spread - sine * math.sqrt(1.0 - spread * spread):
                continue
            for k in range(j * BLOCK, min((j + 1) * BLOCK, n)):
                hit = _capsule_range(x, y, z, directions[k, 0], directions[k, 1], directions[k, 2])
                if hit <= max_range and hit < nearest[k]:
                    nearest[k] = hit


@njit
def _bound_block(directions: FloatArray, cone: FloatArray) -> None:
    """Fill a cone with the mean horizontal direction of rays and the least cosine.

    Rays that do not keep within a quarter turn of it, upright ones among them, get the whole circle.
    """
    cone[0], cone[1], cone[2] = 1.0, 0.0, -1.0
    x, y = directions[:, 0].sum(), directions[:, 1].sum()
    length = math.sqrt(x * x + y * y)
    if length < 1e-9:
        return
    x, y, least = x / length, y / length, 1.0
    for k in range(len(directions)):
        flat = math.sqrt(directions[k, 0] ** 2 + directions[k, 1] ** 2)
        if flat < 1e-9:
            return
        least = min(least, (directions[k, 0] * x + directions[k, 1] * y) / flat)
    if least > 0.0:
        # Rounding leaves no ray outside.
        cone[0], cone[1], cone[2] = x, y, least - 1e-9


@njit
def _capsule_range(x: float, y: float, z: float, dx: float, dy: float, dz: float) -> float:
    """Return the distance of a ray's first hit on the capsule, else inf.

    The start (x, y, z) is relative to the capsule's center.
    """
    nearest = np.inf
    flat, along = dx * dx + dy * dy, x * dx + y * dy
    if flat > 0.0:
        root = along * along - flat * (x * x + y * y - RADIUS * RADIUS)
        if root >= 0.0:
            for side in (-1.0, 1.0):
                t = (-along + side * math.sqrt(root)) / flat
                if t >= 0.0 and abs(z + t * dz) <= HALF_LENGTH:
                    nearest = min(nearest, t)
    for end in (-1.0, 1.0):
        h = z - end * HALF_LENGTH
        b = along + h * dz
        root = b * b - (x * x + y * y + h * h - RADIUS * RADIUS)
        if root >= 0.0:
            for side in (-1.0, 1.0):
                t = -b + side * math.sqrt(root)
                if t >= 0.0 and end * (h + t * dz) >= 0.0:
                    nearest = min(nearest, t)
    return nearest


GROUND, WALL, PROP, WALKER = 0.25, 0.4, 0.5, 0.6
"""Assumed diffuse reflectivities near 905 nm: dry soil, concrete, painted boxes, clothes."""
BRIGHTEST = 255.0
"""Intensity of a white diffuse surface (reflectivity 1) at normal incidence, up to REFERENCE_RANGE."""
REFERENCE_RANGE = 10.0
"""Range up to which the receiver corrects the loss, meters."""
ON_FACE = 1e-6
"""Largest distance of a hit from the face of its wall, cells: far more than rounding."""


def intensities(ranges: Float32Array, reflectances: FloatArray) -> Float32Array:
    """Return (n,) intensities of returns, 0 to BRIGHTEST.

    The lidar equation for diffuse surfaces wider than the beam (Hoefle and Pfeifer, "Correction of laser
    scanning intensity data", ISPRS Journal 2007, eq. 5), without atmosphere.

    Args:
        ranges: (n,) meters; inf = no return.
        reflectances: (n,) reflectivity times cosine of the incidence.
    """
    loss = np.minimum(1.0, np.square(REFERENCE_RANGE / np.maximum(ranges, REFERENCE_RANGE)))
    return (BRIGHTEST * reflectances * loss).astype(np.float32)


def reflect(reflectivity: float, normals: FloatArray, directions: FloatArray) -> FloatArray:
    """Return (n,) reflectances of surfaces: reflectivity times cosine of the incidence.

    Args:
        reflectivity: Diffuse reflectivity of the surfaces.
        normals: (n, 3) of any length; 0 where nothing is hit.
        directions: (n, 3) unit vectors of the beams.
    """
    length = np.maximum(np.linalg.norm(normals, axis=1), 1e-300)
    cosines: FloatArray = np.abs(np.einsum("ij,ij->i", normals, directions)) / length
    return reflectivity * cosines


@njit
def world_reflectances(
    terrain: TerrainMipmap,
    walls: WallCells,
    origins: FloatArray,
    directions: FloatArray,
    ranges: FloatArray,
    reflectances: FloatArray,
) -> None:
    """Fill `reflectances` (n,) of hits at `ranges` (n,) on walls and ground. 0 = no hit."""
    for k in range(len(ranges)):
        reflectances[k] = 0.0
        if ranges[k] < np.inf:
            o, d = origins[min(k, len(origins) - 1)], directions[k]
            x, y, z = o[0] + ranges[k] * d[0], o[1] + ranges[k] * d[1], o[2] + ranges[k] * d[2]
            cosine = _wall_cosine(walls, x, y, z, d)
            reflectances[k] = WALL * cosine if cosine >= 0.0 else GROUND * _ground_cosine(terrain, x, y, d)


@njit
def _wall_cosine(walls: WallCells, x: float, y: float, z: float, d: FloatArray) -> float:
    """Return the cosine of the incidence on a wall's face. -1 = the point is on no face."""
    distance, frame = walls.distance, walls.frame
    if distance.size == 0:
        return -1.0
    rows, columns = distance.shape
    c, s, resolution, height = frame[2], frame[3], frame[4], frame[5]
    u = (c * (x - frame[0]) + s * (y - frame[1])) / resolution
    v = (c * (y - frame[1]) - s * (x - frame[0])) / resolution
    du, dv = c * d[0] + s * d[1], c * d[1] - s * d[0]
    # The cell behind the face lies a little farther along the beam.
    i, j = math.floor(u + math.copysign(ON_FACE, du)), math.floor(v + math.copysign(ON_FACE, dv))
    if not (0 <= i < columns and 0 <= j < rows) or distance[j, i] > 0 or z > height + ON_FACE:
        return -1.0
    if abs(u - round(u)) < ON_FACE:
        return float(abs(du))
    if abs(v - round(v)) < ON_FACE:
        return float(abs(dv))
    return float(abs(d[2])) if abs(z - height) < ON_FACE else -1.0


@njit
def _ground_cosine(terrain: TerrainMipmap, x: float, y: float, d: FloatArray) -> float:
    """Return the cosine of the incidence on the triangle at a point."""
    frame, (nx, ny) = terrain.frame, terrain.cells
    u, v = (x - frame[0]) / frame[2], (y - frame[1]) / frame[3]
    i, j = min(max(int(u), 0), nx - 1), min(max(int(v), 0), ny - 1)
    block = terrain.block[(j >> LEAF) * terrain.width[LEAF] + (i >> LEAF)]
    sw = ROW * (j % EDGE) + i % EDGE
    if u - i >= v - j:
        rise_u, rise_v = block[sw + 1] - block[sw], block[sw + ROW + 1] - block[sw + 1]
    else:
        rise_u, rise_v = block[sw + ROW + 1] - block[sw + ROW], block[sw + ROW] - block[sw]
    a, b = rise_u / frame[2], rise_v / frame[3]
    return float(abs(d[2] - a * d[0] - b * d[1])) / math.sqrt(1.0 + a * a + b * b)
