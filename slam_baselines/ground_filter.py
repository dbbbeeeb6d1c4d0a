"""Ground filter: separation of ground and walls by a planar laser on uneven ground.

A single scan does not distinguish a hill from a wall; many scans do. Ground has a single height at each
place, and it is nowhere steeper than a slope that a robot drives. So the map keeps for each place the lowest
height of a beam that passed or ended there, or of the robot that stood there. The ground cannot be higher;
this is the *upper bound* of the ground. A beam that ends at P at height z has the minimum slope

    s = max over Q near P of (z - upper_bound(Q)) / (|PQ| + margin)

between Q and P. If s exceeds every slope that the robot has driven, P is a wall. All bounds hold with the
stated confidence: a beam's height is known to h0 + sigma r, and the drift of the robot's own height,
integrated from attitude and motion, loosens old bounds by the distance traveled since.

Few neighbors raise a slope: blocks of cells with their lowest upper bound rule out many at once. Weights for
matching need only the slopes between that of a wall and that of full weight.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from lirs_wct.errors import Checked, limited
from lirs_wct.geometry import ByteArray, Float32Array, FloatArray, IntArray, Pose2, njit
from slam_baselines.leveling import LeveledScan, ScanPoints
from slam_baselines.occupancy_map import SLOPE_STEP, GrowingGrid, OccupancyMap, bounding_box

BLOCK_BITS = 3
"""A block is 8 x 8 cells of the upper bound."""
Limits = tuple[float, float]
"""Slopes below the first, and those from the second on, may be returned as equal, SLOPE_STEP."""
IN_FULL: Limits = (0.0, 255.0)


class Neighbors(NamedTuple):
    """Cells around a hit: all nearby ones, fewer far ones.

    Attributes:
        cell: (k, 2) row and column offsets: nearby ones, then far ones, both by distance.
        distance: (k,) of their centers plus a cell's edge, meters.
        close: number of the nearby ones.
        close_reach: largest offset among them.
        reach: largest offset of all.
    """

    cell: IntArray
    distance: FloatArray
    close: int
    close_reach: int
    reach: int


class UpperBound(NamedTuple):
    """Upper bound of the ground's height for the kernels, meters; inf where unknown.

    Attributes:
        cells: (rows, cols) of each cell.
        blocks: (rows / 8, cols / 8) smallest of each block of cells.
        frame: (3,) lattice row and column of cell (0, 0), resolution in meters.
        neighbors: Cells around a hit.
    """

    cells: Float32Array
    blocks: Float32Array
    frame: FloatArray
    neighbors: Neighbors


DrawnSlopes = tuple[ByteArray, FloatArray]
"""Minimum slopes (rows, cols) of a map's cells, SLOPE_STEP, with a frame of UpperBound."""
NOT_DRAWN: DrawnSlopes = np.zeros((0, 0), np.uint8), np.array((0.0, 0.0, 1.0))
"""Of a map without cells."""


class Margins(NamedTuple):
    """Largest errors of heights, meters.

    Drift of the robot's height since the start, error of a hit close to the laser, and growth of a hit's
    error per meter of range.
    """

    old: float
    near: float
    far: float


STANDSTILL = 1e-4
"""Length below which a step counts as standing, meters."""
_Place = tuple[float, float, float, float]
"""x, y, yaw, z of a frame in that of the map."""
IN_MAP: _Place = (0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class GroundFilterConfig(Checked):
    """Errors of attitude and height, and slopes of the ground.

    Attributes:
        ground_resolution: Edge of a cell of the upper bound, meters.
        attitude_error: Error of roll and pitch, radians.
        height_error: Error of a beam's height close to the robot, meters.
        height_confidence: Factor of these errors that a proof must exceed.
        height_drift: Drift of the robot's height per meter driven.
        tilt_lever: Drift of the robot's height per radian by which its tilt changes, meters: base_link does
            not rise as steeply as the robot is tilted while an axle climbs or drops.
        slip_slope: Slope that wheels slip down on, radians; on less steep ones the share of a step that they
            slip falls with the square of the grade.
        base_height: Height of base_link above the ground, meters.
        footprint: Radius of the ground that the robot stands on, meters.
        flat_tilt: Largest tilt on a floor, where every hit is a wall, radians.
        flat_rise: Largest height gained on a floor at a larger tilt, meters; a robot that brakes leans, but
            does not climb.
        wall_slope: Slope of the least steep walls on uneven ground, radians.
        match_margin: Angle by which walls for matching are steeper than the robot's largest tilt, radians.
        first_match_margin: Angle added to it at the start, when little ground is known, radians.
        first_match_meters: Distance over which this first margin falls to 1/e, meters.
        match_slope_limit: Slope of the steepest ground for matching, radians.
        full_weight_slope: Rise over run from which on a hit has full weight in matching; where it is less
            steep, an error of height shifts it more, and its weight falls with the square of the slope.
        least_wall_share: Share of a scan's hits that must be on walls for any to be used in matching.
    """

    ground_resolution: float = limited(0.1, "(0, inf]")
    attitude_error: float = limited(math.radians(0.15), "(0, inf]")
    height_error: float = limited(0.01, "(0, inf]")
    height_confidence: float = limited(3.0, "(0, inf]")
    height_drift: float = 0.0015
    tilt_lever: float = 0.05
    slip_slope: float = math.radians(25.0)
    base_height: float = 0.13
    footprint: float = 0.3
    flat_tilt: float = math.radians(0.6)
    flat_rise: float = limited(0.001, "[0, inf]", "m")
    wall_slope: float = limited(math.radians(45.0), "(0, inf]")
    match_margin: float = math.radians(3.0)
    first_match_margin: float = math.radians(15.0)
    first_match_meters: float = 5.0
    match_slope_limit: float = limited(math.radians(40.0), "(0, inf]")
    full_weight_slope: float = limited(2.0, "(0, inf]")
    least_wall_share: float = limited(0.15, "[0, 1]")


class GroundFilter:
    """Upper bound of the ground, height of the robot, and slope of walls.

    Attributes:
        height: Height of base_link in the map frame, 0 at the start, meters.
        distance_traveled: meters.
        tilt: largest of the robot so far, radians.
        drift: largest that the robot's height may have drifted since the start, meters.
    """

    def __init__(self, config: GroundFilterConfig | None = None) -> None:
        self.config = config or GroundFilterConfig()
        self.grid = GrowingGrid(self.config.ground_resolution, {"upper_bound": (np.float32, np.inf)})
        self.height = self.distance_traveled = self.tilt = self.drift = self._rise = 0.0
        self._slope: tuple[float, float] | None = None
        self._neighbors = neighbors_of(self.config.ground_resolution)
        self._take_over()
        self._weights: tuple[int, FloatArray] = -1, np.empty(0)

    def move(self, delta: Pose2, scan: LeveledScan, *, registered: bool = True) -> None:
        """Update height, tilt and drift by a step on ground as steep as the tilt.

        Unless scans fitted at both ends (`registered`), wheels may have slipped on the slope.
        """
        c, step = self.config, math.hypot(delta.x, delta.y)
        self.height += scan.ground_slope[0] * delta.x + scan.ground_slope[1] * delta.y
        self.distance_traveled += step
        x, y = scan.ground_slope if self._slope is None else self._slope
        # Noise of single readings is no slope.
        self._slope = 0.8 * x + 0.2 * scan.ground_slope[0], 0.8 * y + 0.2 * scan.ground_slope[1]
        grade = math.hypot(*self._slope)
        above = grade - math.tan(c.flat_tilt)
        self._rise = self._rise + above * step if above > 0.0 else 0.0
        climbs = self._rise > c.flat_rise or self.distance_traveled < STANDSTILL
        tilt = math.atan(grade)
        self.tilt = max(self.tilt, tilt if climbs or not self.flat else min(tilt, c.flat_tilt))
        if step > STANDSTILL:
            tilting = math.dist((x, y), self._slope)
            slip = 0.0 if registered else min(1.0, (grade / math.tan(c.slip_slope)) ** 2)
            self.drift += (c.height_drift + grade * slip) * step
            self.drift += c.tilt_lever * max(0.0, tilting - 0.2 * c.attitude_error)

    @property
    def flat(self) -> bool:
        """Whether the robot has never driven on more than a floor's tilt."""
        return self.tilt <= self.config.flat_tilt

    @property
    def wall_slope(self) -> int:
        """Minimum slope of hits that are drawn as walls, SLOPE_STEP; 0 on a floor."""
        return 0 if self.flat else round(math.tan(self.config.wall_slope) / SLOPE_STEP)

    @property
    def match_wall_slope(self) -> int:
        """Minimum slope of walls for matching: ground is hardly steeper than the driven slopes."""
        c = self.config
        if self.flat:
            return 0
        unknown = c.first_match_margin * math.exp(-self.distance_traveled / c.first_match_meters)
        angle = math.degrees(min(self.tilt + c.match_margin + unknown, c.match_slope_limit))
        return round(math.tan(math.radians(math.ceil(angle))) / SLOPE_STEP)

    def insert(self, scan: LeveledScan, pose: Pose2) -> tuple[ScanPoints, ByteArray]:
        """Observe a scan; return it in the map frame, and its hits' (n,) minimum slopes."""
        placed = scan.transformed(pose, self.height)
        return placed, self.observe(placed, pose) if scan.leveled else np.zeros(len(placed.hits), np.uint8)

    def observe(self, scan: ScanPoints, base: Pose2) -> ByteArray:
        """Lower the upper bound by a placed scan; return its hits' (n,) minimum slopes."""
        bound = bounding_box(scan)
        if self.grid.ensure(bound[0] - 2.0, bound[1] - 2.0, bound[2] + 2.0, bound[3] + 2.0):
            self._take_over()
        margins = self._margins
        near, far = margins.near - margins.old, margins.far
        lower_along_beams(self._upper_bound, scan.origin, scan.hits, True, near, far)
        lower_along_beams(self._upper_bound, scan.origin, scan.free, False, near, far)
        self._stand(base)
        return self._raise_slopes(np.zeros(len(scan.hits), np.uint8), scan.origin, scan.hits, IN_MAP, base)

    def min_slopes(
        self,
        scan: LeveledScan,
        pose: Pose2,
        height: float | None = None,
        *,
        known: ByteArray | None = None,
        drawn: OccupancyMap | None = None,
        limits: Limits = IN_FULL,
    ) -> ByteArray:
        """Return the present (n,) minimum slopes of a scan's hits, SLOPE_STEP; 0 on a floor.

        Args:
            scan: Leveled scan.
            pose: `T_map_base`.
            height: Height of the base in the map frame, meters; None: the present one.
            known: (n,) minimum slopes of the hits known before.
            drawn: Map whose cells' minimum slopes count as well.
            limits: Range in which slopes are exact (see Limits).
        """
        slopes = np.zeros(len(scan.hits), np.uint8) if known is None else known.copy()
        if self.match_wall_slope == 0:
            return slopes
        height = self.height if height is None else height
        cells = NOT_DRAWN if drawn is None else (drawn.layers.min_slope, drawn.frame)
        T = pose.x, pose.y, pose.yaw, height
        return self._raise_slopes(slopes, scan.origin, scan.hits, T, pose, limits, cells)

    def match_walls(
        self,
        scan: LeveledScan,
        pose: Pose2,
        height: float | None = None,
        *,
        known: ByteArray | None = None,
        drawn: OccupancyMap | None = None,
    ) -> FloatArray:
        """Return (n,) 1 for hits on walls, 0 for possible ground; arguments as of min_slopes."""
        wall = self.match_wall_slope
        limits = float(wall), float(wall)
        slopes = self.min_slopes(scan, pose, height, known=known, drawn=drawn, limits=limits)
        return self._among_walls((slopes >= wall).astype(np.float64))

    def match_weights(
        self,
        scan: LeveledScan,
        pose: Pose2,
        drawn: OccupancyMap,
        wall_slope: int,
        height: float | None = None,
    ) -> FloatArray:
        """Return (n,) graded weights of hits; arguments as of min_slopes and graded_weights."""
        if wall_slope != self._weights[0]:
            every = np.arange(256, dtype=np.uint8)
            self._weights = wall_slope, self.graded_weights(every, wall_slope)
        limits = limits_for_weights(wall_slope, self.config.full_weight_slope)
        slopes = self.min_slopes(scan, pose, height, drawn=drawn, limits=limits)
        return self._among_walls(self._weights[1].take(slopes))

    def weights_among_walls(self, min_slopes: ByteArray, wall_slope: int) -> FloatArray:
        """Return (n,) graded weights of all hits of a scan."""
        return self._among_walls(self.graded_weights(min_slopes, wall_slope))

    def _among_walls(self, weights: FloatArray) -> FloatArray:
        """Return weights of hits; all 0 with too few on walls: they may be ground."""
        few = np.count_nonzero(weights) < self.config.least_wall_share * len(weights)
        return np.zeros_like(weights) if few else weights

    def graded_weights(self, min_slopes: ByteArray, wall_slope: int) -> FloatArray:
        """Return (n,) weights: 1 on steep walls, less on slopes, 0 for possible ground."""
        full = self.config.full_weight_slope / SLOPE_STEP
        weights: FloatArray = np.minimum(1.0, (min_slopes / full) ** 2) * (min_slopes >= wall_slope)
        return weights

    def _raise_slopes(
        self, slopes: ByteArray, origin: FloatArray, hits: FloatArray, T: _Place, base: Pose2,
        limits: Limits = IN_FULL, drawn: DrawnSlopes = NOT_DRAWN,
    ) -> ByteArray:  # fmt: skip
        """Raise (n,) minimum slopes of hits in the frame T to those observed."""
        raise_min_slopes(
            self._upper_bound, origin, hits, T, self._ground(base), self._margins, limits, drawn, slopes
        )
        return slopes

    def _stand(self, base: Pose2) -> None:
        """Lower the upper bound under the robot to the height of its wheels."""
        x, y, z = self._ground(base)
        row0, col0, resolution = self._upper_bound.frame.tolist()
        reach = int(self.config.footprint / resolution)
        row, col = int(y / resolution - row0), int(x / resolution - col0)
        for layer, bits in ((self._upper_bound.cells, 0), (self._upper_bound.blocks, BLOCK_BITS)):
            rows = slice((row - reach) >> bits, ((row + reach) >> bits) + 1)
            cols = slice((col - reach) >> bits, ((col + reach) >> bits) + 1)
            np.minimum(layer[rows, cols], np.float32(z - self.drift), out=layer[rows, cols])

    @property
    def _margins(self) -> Margins:
        c = self.config
        return Margins(
            self.drift, c.height_confidence * c.height_error, c.height_confidence * c.attitude_error
        )

    def _ground(self, base: Pose2) -> tuple[float, float, float]:
        """Return x, y and the largest height of the ground under the robot."""
        c = self.config
        return base.x, base.y, self.height - c.base_height + c.height_confidence * c.height_error

    def _take_over(self) -> None:
        """Take over the grid's arrays."""
        g = self.grid
        cells = g.layers["upper_bound"]
        frame = np.array((g.row0, g.col0, g.resolution))
        self._upper_bound = UpperBound(cells, blocks_of(cells), frame, self._neighbors)


def neighbors_of(resolution: float) -> Neighbors:
    """Return the cells whose upper bounds limit the ground in front of a hit."""
    reach = round(0.35 / resolution)
    close = [(r, c) for r in range(-reach, reach + 1) for c in range(-reach, reach + 1)]
    rays = [(math.sin(a), math.cos(a)) for a in np.arange(12) * math.tau / 12]
    rings = [(round(d * s / resolution), round(d * c / resolution)) for d in (0.5, 0.8, 1.2) for s, c in rays]
    near_to_far = sorted(close, key=_length) + sorted(rings, key=_length)
    cells = np.array(near_to_far, np.int64)
    distance = np.array([_length(cell) * resolution + resolution for cell in near_to_far])
    return Neighbors(cells, distance, len(close), reach, int(np.abs(cells).max()))


def _length(cell: tuple[int, int]) -> float:
    return math.hypot(*cell)


def blocks_of(cells: Float32Array) -> Float32Array:
    """Return the smallest upper bound of each block of cells."""
    size = 1 << BLOCK_BITS
    rows, cols = cells.shape
    of_rows = cells.reshape(rows // size, size, cols).min(axis=1)
    lowest: Float32Array = of_rows.reshape(rows // size, cols // size, size).min(axis=2)
    return lowest


def limits_for_weights(wall_slope: int, full_weight_slope: float) -> Limits:
    """Return the slopes of a wall and of full weight, between which weights differ, SLOPE_STEP."""
    return float(wall_slope), min(255.0, max(float(wall_slope), full_weight_slope / SLOPE_STEP + 1.0))


@njit
def lower(upper_bound: Any, row: int, col: int, z: Any) -> None:
    """Lower the upper bounds of a cell and of its block to at most z."""
    r, c = np.uintp(row), np.uintp(col)
    if z < upper_bound.cells[r, c]:
        upper_bound.cells[r, c] = z
        r, c = np.uintp(row >> BLOCK_BITS), np.uintp(col >> BLOCK_BITS)
        upper_bound.blocks[r, c] = min(upper_bound.blocks[r, c], z)


@njit
def raise_min_slopes(
    upper_bound: Any, origin: Any, hits: Any, pose: Any, ground: Any, margins: Any, limits: Any, drawn: Any,
    slopes: Any,
) -> None:  # fmt: skip
    """Raise minimum slopes to the largest rise over run that must lie before each hit.

    Args:
        upper_bound: Upper bound of the ground.
        origin: (3,) the laser, meters.
        hits: (n, 3) ends of beams in the same frame.
        pose: x, y, yaw, z of this frame in that of the map.
        ground: x, y and largest height of the ground under the robot.
        margins: Errors of the heights.
        limits: Range in which slopes are exact (see Limits).
        drawn: Minimum slopes of a map's cells.
        slopes: (n,) minimum slopes of the hits known before; raised in place, SLOPE_STEP.
    """
    layer, known = drawn
    x0, y0, yaw, z0 = pose
    c, s, res = np.cos(yaw), np.sin(yaw), upper_bound.frame[2]
    laser_x, laser_y = x0 + c * origin[0] - s * origin[1], y0 + s * origin[0] + c * origin[1]
    laser_z = z0 + origin[2]
    # Half a step is more than any rounding.
    least, most = max(0.0, (limits[0] - 0.5) * SLOPE_STEP), (limits[1] + 0.5) * SLOPE_STEP
    for i in range(len(hits)):
        u, v = hits[i, 0], hits[i, 1]
        x, y, z = x0 + c * u - s * v, y0 + s * u + c * v, z0 + hits[i, 2]
        row, col = int(np.floor(y / known[2] - known[0])), int(np.floor(x / known[2] - known[1]))
        if 0 <= row < layer.shape[0] and 0 <= col < layer.shape[1]:
            slopes[i] = max(slopes[i], layer[row, col])
        best = max(least, slopes[i] * SLOPE_STEP)
        if best >= most:
            continue
        z -= margins.near + margins.far * np.sqrt(
            (x - laser_x) ** 2 + (y - laser_y) ** 2 + (z - laser_z) ** 2
        )
        dx, dy, rise = x - ground[0], y - ground[1], z - ground[2]
        if rise > best * (max(abs(dx), abs(dy)) + res):
            best = max(best, rise / (np.hypot(dx, dy) + res))
        best = _steepest(upper_bound, x, y, z - margins.old, best, most)
        slopes[i] = max(slopes[i], np.uint8(min(best / SLOPE_STEP, 255.0)))


@njit(forceinline=True)
def _steepest(upper_bound: Any, x: float, y: float, z: float, best: float, most: float) -> float:
    """Return the largest rise over run from nearby cells, between `best` and `most`."""
    cells, blocks, frame, neighbors = upper_bound
    rows, cols = cells.shape
    cell, distance, close, close_reach, reach = neighbors
    row, col = int(np.floor(y / frame[2] - frame[0])), int(np.floor(x / frame[2] - frame[1]))
    if not (reach <= row < rows - reach and reach <= col < cols - reach):
        for k in range(len(cell)):
            r, c = row + cell[k, 0], col + cell[k, 1]
            if 0 <= r < rows and 0 <= c < cols:
                best = max(best, (z - cells[r, c]) / distance[k])
        return best
    for first, end, around in ((0, close, close_reach), (close, len(cell), reach)):
        most_rise = z - _lowest(blocks, row, col, around)
        for k in range(first, end):
            # A product replaces the quotient, which is four times as slow; few cells raise the slope.
            needed = best * distance[k]
            if most_rise <= needed:
                break
            rise = z - cells[np.uintp(row + cell[k, 0]), np.uintp(col + cell[k, 1])]
            if rise > needed:
                best = max(best, rise / distance[k])
                if best >= most:
                    return best
    return best


@njit(forceinline=True)
def _lowest(blocks: Any, row: int, col: int, reach: int) -> Any:
    """Return the smallest upper bound of the blocks within `reach` cells of a cell."""
    lowest = np.float32(np.inf)
    for r in range((row - reach) >> BLOCK_BITS, ((row + reach) >> BLOCK_BITS) + 1):
        for c in range((col - reach) >> BLOCK_BITS, ((col + reach) >> BLOCK_BITS) + 1):
            lowest = min(lowest, blocks[np.uintp(r), np.uintp(c)])
    return lowest


@njit
def lower_along_beams(
    upper_bound: Any, origin: Any, ends: Any, with_end: bool, near: float, far: float
) -> None:
    """Lower the upper bound along beams to their height plus near + far * range."""
    res, row0, col0 = upper_bound.frame[2], upper_bound.frame[0], upper_bound.frame[1]
    x, y = origin[0] / res - col0, origin[1] / res - row0
    for i in range(len(ends)):
        dx, dy, dz = ends[i, 0] / res - col0 - x, ends[i, 1] / res - row0 - y, ends[i, 2] - origin[2]
        length = np.sqrt((dx * res) ** 2 + (dy * res) ** 2 + dz * dz)
        steps = int(max(abs(dx), abs(dy))) + 1
        dx, dy, rise, loose = dx / steps, dy / steps, dz / steps, far * length / steps
        for k in range(steps + 1 if with_end else steps):
            z = np.float32(origin[2] + k * rise + near + k * loose)
            lower(upper_bound, int(y + k * dy), int(x + k * dx), z)
