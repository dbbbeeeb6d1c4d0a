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
from dataclasses import dataclass
from typing import Any

import numpy as np

from lirs_wct.arrays import ByteArray, FloatArray
from lirs_wct.field_validators import require_above
from lirs_wct.geometry.pose import Pose2
from lirs_wct.kernels import njit
from slam_baselines.mapping.growing_grid import GrowingGrid
from slam_baselines.mapping.minimum_slope import (
    BLOCK_BITS,
    IN_FULL,
    NOT_DRAWN,
    DrawnSlopes,
    Limits,
    Margins,
    UpperBound,
    blocks_of,
    limits_for_weights,
    lower,
    neighbors_of,
    raise_min_slopes,
)
from slam_baselines.mapping.occupancy_map import SLOPE_STEP, OccupancyMap, bounding_box
from slam_baselines.scan.leveling import LeveledScan, ScanPoints

STANDSTILL = 1e-4
"""A shorter step is none, meters."""
_Place = tuple[float, float, float, float]
"""x, y, yaw, z of a frame in that of the map."""
IN_MAP: _Place = (0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class GroundFilterConfig:
    """Errors of attitude and height, and slopes of the ground.

    Attributes:
        resolution: edge of a cell of the upper bound, meters.
        attitude_error: of roll and pitch, radians.
        height_error: of a beam's height close to the robot, meters.
        confidence: how many of these errors a proof must exceed.
        drift: of the robot's height, per meter driven.
        tilt_lever: drift of the robot's height per radian by which its tilt changes, meters: base_link does
            not rise as steeply as the robot is tilted while an axle climbs or drops.
        slip_slope: slope that wheels slip down on, radians; on less steep ones the share of a step that they
            slip falls with the square of the grade.
        base_height: of base_link above the ground, meters.
        footprint: radius of the ground that the robot stands on, meters.
        flat_tilt: ground on which the robot never tilted more is a floor: every hit is a wall. Radians.
        wall_slope: faces steeper than this are walls, on uneven ground, radians.
        match_margin: what is steeper than the robot's largest tilt by this is a wall for matching, radians.
        full_weight_slope: rise over run from which on a hit has full weight in matching; where it is less
            steep, an error of height shifts it more, and its weight falls with the square of the slope.
        first_margin: added to it at the start, when little ground is known, radians.
        first_meters: distance over which the first margin falls to 1/e, meters.
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
        height: of base_link in the map frame, 0 at the start, meters.
        distance_traveled: meters.
        tilt: largest of the robot so far, radians.
        drift: largest that the robot's height may have drifted since the start, meters.
    """

    def __init__(self, config: GroundFilterConfig | None = None) -> None:
        self.config = config or GroundFilterConfig()
        self.grid = GrowingGrid(self.config.resolution, {"upper_bound": (np.float32, np.inf)})
        self.height = 0.0
        self.distance_traveled = 0.0
        self.tilt = 0.0
        self.drift = 0.0
        self._slope: tuple[float, float] | None = None
        self._neighbors = neighbors_of(self.config.resolution)
        self._take_over()
        self._weights: tuple[int, FloatArray] = -1, np.empty(0)

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
        bound = bounding_box(scan)
        if self.grid.ensure(bound[0] - 2.0, bound[1] - 2.0, bound[2] + 2.0, bound[3] + 2.0):
            self._take_over()
        margins = self._margins
        near, far = margins.near - margins.old, margins.far
        lower_along_beams(self._upper_bound, scan.origin, scan.hits, True, near, far)
        lower_along_beams(self._upper_bound, scan.origin, scan.free, False, near, far)
        self._stand(base)
        return self._raised(self.no_min_slope(len(scan.hits)), scan.origin, scan.hits, IN_MAP, base)

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
        """Return (n,) the minimum slopes of a scan's hits as known by now, SLOPE_STEP; 0 on a floor.

        Args:
            scan: leveled.
            pose: `T_map_base`.
            height: of the base in the map frame, meters; None: the present one.
            known: (n,) what was known of the hits before.
            drawn: the map whose cells' minimum slopes count as well.
            limits: slopes below the first and from the second on need not be told apart, which is faster.
        """
        slopes = self.no_min_slope(len(scan.hits)) if known is None else known.copy()
        if self.match_wall_slope == 0:
            return slopes
        height = self.height if height is None else height
        cells = NOT_DRAWN if drawn is None else _drawn_slopes(drawn)
        T = pose.x, pose.y, pose.yaw, height
        return self._raised(slopes, scan.origin, scan.hits, T, pose, limits, cells)

    def match_walls(
        self,
        scan: LeveledScan,
        pose: Pose2,
        height: float | None = None,
        *,
        known: ByteArray | None = None,
        drawn: OccupancyMap | None = None,
    ) -> FloatArray:
        """Return (n,) 1 for hits on walls, 0 for those that may be ground; on a floor every hit is a wall.

        Arguments are those of min_slopes.
        """
        wall = self.match_wall_slope
        limits = float(wall), float(wall)
        slopes = self.min_slopes(scan, pose, height, known=known, drawn=drawn, limits=limits)
        return (slopes >= wall).astype(np.float64)

    def match_weights(
        self, scan: LeveledScan, pose: Pose2, drawn: OccupancyMap, wall_slope: int
    ) -> FloatArray:
        """Return (n,) the graded weights of a scan's hits by the minimum slopes as known by now.

        Args:
            scan: leveled.
            pose: `T_map_base`.
            drawn: the map whose cells' minimum slopes count as well.
            wall_slope: minimum slope from which on a hit is a wall, SLOPE_STEP.
        """
        if wall_slope != self._weights[0]:
            every = np.arange(256, dtype=np.uint8)
            self._weights = wall_slope, self.graded_weights(every, wall_slope)
        limits = limits_for_weights(wall_slope, self.config.full_weight_slope)
        slopes, T = self.no_min_slope(len(scan.hits)), (pose.x, pose.y, pose.yaw, self.height)
        weights: FloatArray = self._weights[1].take(
            self._raised(slopes, scan.origin, scan.hits, T, pose, limits, _drawn_slopes(drawn))
        )
        return weights

    def graded_weights(self, min_slopes: ByteArray, wall_slope: int) -> FloatArray:
        """Return (n,) 1 for hits on steep walls, less on a slope, 0 for those that may be ground."""
        full = self.config.full_weight_slope / SLOPE_STEP
        weights: FloatArray = np.minimum(1.0, (min_slopes / full) ** 2) * (min_slopes >= wall_slope)
        return weights

    def _raised(
        self, slopes: ByteArray, origin: FloatArray, hits: FloatArray, T: _Place, base: Pose2,
        limits: Limits = IN_FULL, drawn: DrawnSlopes = NOT_DRAWN,
    ) -> ByteArray:  # fmt: skip
        """Return (n,) minimum slopes of hits raised to what was observed so far, SLOPE_STEP; T is theirs."""
        raise_min_slopes(
            self._upper_bound, origin, hits, T, self._ground(base), self._margins, limits, drawn, slopes
        )
        return slopes

    def _stand(self, base: Pose2) -> None:
        """Lower the upper bound where the robot stands: the ground is where its wheels are."""
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
        return Margins(self.drift, c.confidence * c.height_error, c.confidence * c.attitude_error)

    def _ground(self, base: Pose2) -> tuple[float, float, float]:
        """Return the highest that the ground under the robot may be."""
        c = self.config
        return base.x, base.y, self.height - c.base_height + c.confidence * c.height_error

    def _take_over(self) -> None:
        """Take over the grid's arrays."""
        g = self.grid
        cells = g.layers["upper_bound"]
        frame = np.array((g.row0, g.col0, g.resolution))
        self._upper_bound = UpperBound(cells, blocks_of(cells), frame, self._neighbors)

    @staticmethod
    def no_min_slope(n: int) -> ByteArray:
        """Return the minimum slopes of n hits about whose height nothing is known."""
        return np.zeros(n, np.uint8)


def _drawn_slopes(drawn: OccupancyMap) -> DrawnSlopes:
    """Return what a map knows of its cells."""
    return DrawnSlopes(drawn.layers.min_slope, drawn.frame)


@njit(cache=True, nogil=True)
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
