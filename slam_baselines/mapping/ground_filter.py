"""What is ground and what is wall, on uneven ground, from a laser that sees one plane at a time.

One scan cannot tell a hill from a wall; time can. Ground is a single height over each place, and it
is nowhere steeper than a slope that a robot drives. So the map keeps for each place the lowest height
at which a beam was seen there - passing over, ending, or the robot standing on it: the ground cannot
be higher (the *upper bound* of the ground). A beam that ends at P at height z has the minimum slope

    s = max over Q near P of (z - upper_bound(Q)) / (|PQ| + margin)

between Q and P. If s exceeds every slope that the robot has driven, P is a wall. All bounds hold with the
stated confidence: a beam's height is known to h0 + sigma r, and the drift of the robot's own height,
integrated from attitude and motion, loosens old bounds by the distance traveled since.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from lirs_wct.arrays import ByteArray, FloatArray, IntArray
from lirs_wct.field_validators import require_above
from lirs_wct.geometry.pose import Pose2
from slam_baselines.mapping.growing_grid import GrowingGrid
from slam_baselines.mapping.occupancy_map import SLOPE_STEP
from slam_baselines.scan.leveling import LeveledScan, ScanPoints

STANDSTILL = 1e-4
"""A shorter step is none, metres."""


@dataclass(frozen=True, kw_only=True)
class GroundFilterConfig:
    """Errors of attitude and height, and slopes of the ground.

    Attributes:
        resolution: edge of a cell of the upper bound, metres.
        attitude_error: of roll and pitch, radians.
        height_error: of a beam's height close to the robot, metres.
        confidence: how many of these errors a proof must exceed.
        drift: of the robot's height, per metre driven.
        tilt_lever: drift of the robot's height per radian by which its tilt changes, metres: base_link does
            not rise as steeply as the robot is tilted while an axle climbs or drops.
        slip_slope: slope that wheels slip down on, radians; on less steep ones the share of a step that they
            slip falls with the square of the grade.
        base_height: of base_link above the ground, metres.
        footprint: radius of the ground that the robot stands on, metres.
        flat_tilt: ground on which the robot never tilted more is a floor: every hit is a wall. Radians.
        wall_slope: faces steeper than this are walls, on uneven ground, radians.
        match_margin: what is steeper than the robot's largest tilt by this is a wall for matching, radians.
        full_weight_slope: rise over run from which on a hit has full weight in matching; where it is less
            steep, an error of height shifts it more, and its weight falls with the square of the slope.
        first_margin: added to it at the start, when little ground is known, radians.
        first_meters: distance over which the first margin falls to 1/e, metres.
        slope_limit: of the steepest ground for matching, radians.

    Raises:
        ConfigError: a value that is not above 0.
    """

    resolution: float = 0.1
    attitude_error: float = math.radians(0.15)
    height_error: float = 0.01
    confidence: float = 3.0
    drift: float = 0.0015
    tilt_lever: float = 0.05
    slip_slope: float = math.radians(25.0)
    base_height: float = 0.13
    footprint: float = 0.3
    flat_tilt: float = math.radians(0.6)
    wall_slope: float = math.radians(45.0)
    match_margin: float = math.radians(3.0)
    full_weight_slope: float = 2.0
    first_margin: float = math.radians(15.0)
    first_meters: float = 5.0
    slope_limit: float = math.radians(40.0)

    def __post_init__(self) -> None:
        above = "resolution", "attitude_error", "height_error", "confidence", "wall_slope"
        require_above(self, 0, *above, "full_weight_slope", "slope_limit", of="the ground filter")


class GroundFilter:
    """Upper bound of the ground, the robot's height, and the slope from which on a hit is a wall.

    Attributes:
        height: of base_link in the map frame, 0 at the start, metres.
        distance_traveled: metres.
        tilt: largest of the robot so far, radians.
        drift: largest that the robot's height may have drifted since the start, metres.
    """

    def __init__(self, config: GroundFilterConfig | None = None) -> None:
        self.config = config or GroundFilterConfig()
        self.grid = GrowingGrid(self.config.resolution, {"upper_bound": (np.float32, np.inf)})
        self.height = 0.0
        self.distance_traveled = 0.0
        self.tilt = 0.0
        self.drift = 0.0
        self._slope: tuple[float, float] | None = None
        self._neighbors = _neighbors(self.config.resolution)

    def move(self, delta: Pose2, scan: LeveledScan, *, registered: bool = True) -> None:
        """Follow the ground over a step of the base, as steep as the robot is tilted.

        Args:
            delta: `T_before_now`.
            scan: tells the tilt.
            registered: whether scans fitted at both ends; else wheels may have slipped on the slope.
        """
        c, step = self.config, math.hypot(delta.x, delta.y)
        self.height += scan.ground_slope[0] * delta.x + scan.ground_slope[1] * delta.y
        self.distance_traveled += step
        x, y = scan.ground_slope if self._slope is None else self._slope
        # Noise of single readings is no slope.
        self._slope = 0.8 * x + 0.2 * scan.ground_slope[0], 0.8 * y + 0.2 * scan.ground_slope[1]
        self.tilt = max(self.tilt, math.atan(math.hypot(*self._slope)))
        if step > STANDSTILL:
            tilting = math.dist((x, y), self._slope)
            grade = math.hypot(*self._slope)
            slip = 0.0 if registered else min(1.0, (grade / math.tan(c.slip_slope)) ** 2)
            self.drift += (c.drift + grade * slip) * step
            self.drift += c.tilt_lever * max(0.0, tilting - 0.2 * c.attitude_error)

    @property
    def flat(self) -> bool:
        """Whether the robot has never tilted more than on a floor."""
        return self.tilt <= self.config.flat_tilt

    @property
    def wall_slope(self) -> int:
        """Rise over run, in SLOPE_STEP, from which on a hit is drawn as a wall; 0 on a floor."""
        return 0 if self.flat else round(math.tan(self.config.wall_slope) / SLOPE_STEP)

    @property
    def match_wall_slope(self) -> int:
        """The same, for matching: ground is hardly steeper than where the robot has been."""
        c = self.config
        if self.flat:
            return 0
        unknown = c.first_margin * math.exp(-self.distance_traveled / c.first_meters)
        angle = math.degrees(min(self.tilt + c.match_margin + unknown, c.slope_limit))
        return round(math.tan(math.radians(math.ceil(angle))) / SLOPE_STEP)

    def insert(self, scan: LeveledScan, pose: Pose2) -> tuple[ScanPoints, ByteArray]:
        """Take in a scan; return it in the map frame, and (n,) the minimum slopes of its hits."""
        placed = scan.transformed(pose, self.height)
        return placed, self.observe(placed, pose) if scan.leveled else self.no_min_slope(len(placed.hits))

    def observe(self, scan: ScanPoints, base: Pose2) -> ByteArray:
        """Lower the upper bound by what a scan has seen; return (n,) the minimum slopes of its hits.

        Args:
            scan: in the map frame.
            base: `T_map_base`.
        """
        c, g = self.config, self.grid
        ends = np.concatenate((scan.hits, scan.free, scan.origin[None]))
        low, high = ends.min(axis=0) - 2.0, ends.max(axis=0) + 2.0
        g.ensure(low[0], low[1], high[0], high[1])
        upper_bound = g.layers["upper_bound"]
        old = self.drift
        near, far = c.confidence * c.height_error, c.confidence * c.attitude_error
        frame = np.array((g.row0, g.col0, g.resolution))
        lower(upper_bound, frame, scan.origin, scan.hits, True, near - old, far)
        lower(upper_bound, frame, scan.origin, scan.free, False, near - old, far)
        stand(upper_bound, frame, self._ground(base), c.footprint, old)
        return self._min_slopes(scan, base)

    def min_slopes(
        self,
        scan: LeveledScan,
        pose: Pose2,
        height: float | None = None,
        *,
        known: ByteArray | None = None,
        drawn: Callable[[FloatArray], ByteArray] | None = None,
    ) -> ByteArray:
        """Return (n,) the minimum slopes of a scan's hits as known by now, SLOPE_STEP; 0 on a floor.

        Args:
            scan: leveled.
            pose: `T_map_base`.
            height: of the base in the map frame, metres; None: the present one.
            known: (n,) what was known of the hits before.
            drawn: what a map knows of hits (n, 3) in its frame.
        """
        slopes = self.no_min_slope(len(scan.hits)) if known is None else known
        if self.match_wall_slope == 0:
            return slopes
        placed = scan.transformed(pose, self.height if height is None else height)
        slopes = np.maximum(slopes, self._min_slopes(placed, pose))
        return slopes if drawn is None else np.maximum(slopes, drawn(placed.hits))

    def wall_weights(self, min_slopes: ByteArray) -> FloatArray:
        """Return (n,) 1 for hits on walls, 0 for those that may be ground; on a floor every hit is a wall."""
        return (min_slopes >= self.match_wall_slope).astype(np.float64)

    def graded_weights(self, min_slopes: ByteArray, wall_slope: int) -> FloatArray:
        """Return (n,) 1 for hits on steep walls, less on a slope, 0 for those that may be ground."""
        full = self.config.full_weight_slope / SLOPE_STEP
        weights: FloatArray = np.minimum(1.0, (min_slopes / full) ** 2) * (min_slopes >= wall_slope)
        return weights

    def _min_slopes(self, scan: ScanPoints, base: Pose2) -> ByteArray:
        """Return (n,) the minimum slopes of hits from what was observed so far, SLOPE_STEP."""
        c, g = self.config, self.grid
        near, far = c.confidence * c.height_error, c.confidence * c.attitude_error
        frame = np.array((g.row0, g.col0, g.resolution))
        bounds = self.drift, near, far
        slopes: ByteArray = min_slopes(
            g.layers["upper_bound"], frame, scan, self._ground(base), bounds, self._neighbors
        )
        return slopes

    def _ground(self, base: Pose2) -> FloatArray:
        """Return (3,) the highest that the ground under the robot may be."""
        c = self.config
        return np.array((base.x, base.y, self.height - c.base_height + c.confidence * c.height_error))

    @staticmethod
    def no_min_slope(n: int) -> ByteArray:
        """Return the minimum slopes of n hits about whose height nothing is known."""
        return np.zeros(n, np.uint8)


class Neighbors(NamedTuple):
    """Cells around a hit: all close by, fewer farther off.

    Attributes:
        cell: (k, 2) row and column offsets.
        distance: (k,) of their middles, and a cell's edge, metres.
        reach: largest offset.
    """

    cell: IntArray
    distance: FloatArray
    reach: int


def _neighbors(resolution: float) -> Neighbors:
    """Return the cells that tell how high the ground before a hit can be."""
    reach = round(0.35 / resolution)
    close = [(r, c) for r in range(-reach, reach + 1) for c in range(-reach, reach + 1)]
    rays = [(math.sin(a), math.cos(a)) for a in np.arange(12) * math.tau / 12]
    rings = [(round(d * s / resolution), round(d * c / resolution)) for d in (0.5, 0.8, 1.2) for s, c in rays]
    cells = np.array(close + rings, np.int64)
    distance = np.array([math.hypot(r, c) * resolution + resolution for r, c in close + rings])
    return Neighbors(cells, distance, int(np.abs(cells).max()))


@njit(cache=True, nogil=True)
def lower(
    upper_bound: Any, frame: Any, origin: Any, ends: Any, with_end: bool, near: float, far: float
) -> None:
    """Lower the upper bound along beams to their height plus near + far * range."""
    res = frame[2]
    x, y = origin[0] / res - frame[1], origin[1] / res - frame[0]
    for i in range(len(ends)):
        dx, dy, dz = ends[i, 0] / res - frame[1] - x, ends[i, 1] / res - frame[0] - y, ends[i, 2] - origin[2]
        length = np.sqrt((dx * res) ** 2 + (dy * res) ** 2 + dz * dz)
        steps = int(max(abs(dx), abs(dy))) + 1
        dx, dy, rise, loose = dx / steps, dy / steps, dz / steps, far * length / steps
        for k in range(steps + 1 if with_end else steps):
            z = np.float32(origin[2] + k * rise + near + k * loose)
            row, col = int(y + k * dy), int(x + k * dx)
            if z < upper_bound[row, col]:
                upper_bound[row, col] = z


@njit(cache=True, nogil=True)
def stand(upper_bound: Any, frame: Any, ground: Any, footprint: float, old: float) -> None:
    """The robot stands here: the ground is where its wheels are."""
    reach = int(footprint / frame[2])
    row0, col0 = int(ground[1] / frame[2] - frame[0]), int(ground[0] / frame[2] - frame[1])
    for row in range(row0 - reach, row0 + reach + 1):
        for col in range(col0 - reach, col0 + reach + 1):
            upper_bound[row, col] = min(upper_bound[row, col], np.float32(ground[2] - old))


@njit(cache=True, nogil=True)
def min_slopes(upper_bound: Any, frame: Any, scan: Any, ground: Any, bounds: Any, neighbors: Any) -> Any:
    """Return (n,) the largest rise over run that must lie before each hit, SLOPE_STEP."""
    old, near, far = bounds
    origin, hits = scan.origin, scan.hits
    cell, distance, reach = neighbors
    res = frame[2]
    rows, cols = upper_bound.shape
    slopes = np.empty(len(hits), np.uint8)
    for i in range(len(hits)):
        x, y, z = hits[i, 0], hits[i, 1], hits[i, 2]
        length = np.sqrt((x - origin[0]) ** 2 + (y - origin[1]) ** 2 + (z - origin[2]) ** 2)
        z -= near + far * length
        best = (z - ground[2]) / (np.hypot(x - ground[0], y - ground[1]) + res)
        z -= old
        row, col = int(np.floor(y / res - frame[0])), int(np.floor(x / res - frame[1]))
        inside = reach <= row < rows - reach and reach <= col < cols - reach
        for k in range(len(cell)):
            r, c = row + cell[k, 0], col + cell[k, 1]
            if not inside and (r < 0 or c < 0 or r >= rows or c >= cols):
                continue
            rise = z - upper_bound[np.uintp(r), np.uintp(c)]
            # A product asks what a quotient, four times as slow, would; few cells raise the slope.
            if rise > best * distance[k]:
                best = max(best, rise / distance[k])
        slopes[i] = np.uint8(min(max(best / SLOPE_STEP, 0.0), 255.0))
    return slopes
