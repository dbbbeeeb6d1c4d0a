"""Planar HectorSLAM as the original: Gauss-Newton on the map alone.

Kohlbrecher et al. 2011, sections IV and V, with the defaults of hector_mapping. The odometry is only the
start of the match. No attitude, no prior, no wider search, no ground filter: on uneven ground it takes
hillsides for walls, as the original does. It never reports that it is lost.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from lirs_wct.arrays import BoolArray, FloatArray, njit
from lirs_wct.errors import Checked, ConfigError, limited
from lirs_wct.geometry import Imu, LaserScan, OccupancyGrid, Pose2, Trajectory, wrap_angle
from slam_baselines.mapper import MapperStats, PlanarMapper
from slam_baselines.registration import solve3

ITERATIONS = (6, 4, 4)
"""Gauss-Newton steps on the finest level, and on each coarser one."""


@dataclass(frozen=True, kw_only=True)
class HectorOriginalConfig(Checked, of="hector_original"):
    """Parameters of hector_mapping by their names.

    Attributes:
        map_resolution: edge of a cell of the finest level, meters.
        map_size: cells along an edge of the finest level, with the start in its middle. Beams that leave the
            map are not drawn and not matched; outside, the estimate follows the odometry. The launch file of
            the original has 2048: at 0.05 m it ends 51 m from the start, too near for a log of a campus.
        map_multi_res_levels: number of levels, each twice as coarse as the one before.
        map_update_distance_thresh: distance to the last map update after which the next is due, meters.
        map_update_angle_thresh: Turn since the last map update after which the next is due, radians.
        update_factor_free: probability that a cell is occupied, given that a beam passed it.
        update_factor_occupied: probability that a cell is occupied, given that a beam ended there.
        laser_min_dist: nearer hits are not used, meters.
        laser_max_dist: farther hits are not used, meters.

    Raises:
        ConfigError: a value is not legal, or the map size cannot be halved for each level.
    """

    map_resolution: float = limited(0.05, "(0, inf]", "m")
    map_size: int = 4096
    map_multi_res_levels: int = limited(3, "[1, inf]")
    map_update_distance_thresh: float = limited(0.4, "[0, inf]")
    map_update_angle_thresh: float = limited(0.9, "[0, inf]")
    update_factor_free: float = limited(0.4, "(0, 0.5)")
    update_factor_occupied: float = limited(0.9, "(0.5, 1)")
    laser_min_dist: float = limited(0.4, "[0, inf]")
    laser_max_dist: float = limited(30.0, "(0, inf]", "m")

    def __post_init__(self) -> None:
        super().__post_init__()
        multiple = 2**self.map_multi_res_levels
        if self.map_size < multiple or self.map_size % multiple:
            raise ConfigError(
                f"map_size must be a multiple of {multiple} (2^map_multi_res_levels), got {self.map_size}"
            )


class HectorOriginalMapper(PlanarMapper):
    """Scan-to-map matching, coarse to fine; the map is drawn after 0.4 m or 0.9 rad.

    Without odometry the last pose is the start of the match.
    """

    name = "hector_original"

    def __init__(self, config: HectorOriginalConfig | None = None) -> None:
        super().__init__()
        self.config = c = config or HectorOriginalConfig()
        odds = [math.log(p / (1 - p)) for p in (c.update_factor_free, c.update_factor_occupied)]
        self._levels = [
            OriginalMap(c.map_resolution * 2**level, c.map_size >> level, odds[0], odds[1])
            for level in range(c.map_multi_res_levels)
        ]
        self._pose = Pose2()
        self._drawn_at: Pose2 | None = None
        self._odometry: Pose2 | None = None
        self._poses: dict[float, Pose2] = {}
        self._updates = 0

    def process(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        """Match the scan from the pose by odometry, draw it if due; return `T_map_base`."""
        c, (laser, ends) = self.config, self._points(scan)
        start, before, self._odometry = self._pose, self._odometry, odometry
        if before is not None and odometry is not None:
            start = start @ (before.inverse() @ odometry)
        self._pose = self._match(ends, start)
        drawn = self._drawn_at
        if (
            drawn is None
            or self._pose.distance(drawn) > c.map_update_distance_thresh
            or abs(wrap_angle(self._pose.yaw - drawn.yaw)) > c.map_update_angle_thresh
        ):
            for level in self._levels:
                level.draw(self._pose, laser, ends)
            self._drawn_at = self._pose
            self._updates += 1
        self._poses[scan.stamp] = self._pose
        return self._pose

    def map(self) -> OccupancyGrid:
        """Return the finest level."""
        return self._levels[0].occupancy_grid()

    def trajectory(self) -> Trajectory:
        """Return the pose of every scan, by stamp."""
        stamps = sorted(self._poses)
        return Trajectory.from_poses(stamps, [self._poses[t] for t in stamps])

    def counts(self) -> MapperStats:
        """Return used scans, memory and other counts."""
        return MapperStats(
            used=self.received,
            memory=sum(level.nbytes for level in self._levels),
            counts={"map_updates": self._updates},
        )

    def _points(self, scan: LaserScan) -> tuple[FloatArray, FloatArray]:
        """Return laser (2,) and usable ends of beams (n, 2) in the level base frame."""
        c, ranges = self.config, scan.ranges.astype(np.float64)
        farthest = min(scan.range_max - 0.01, c.laser_max_dist)
        usable = (ranges > max(scan.range_min, c.laser_min_dist)) & (ranges < farthest)
        r, angle = ranges[usable], scan.angles[usable]
        points = np.stack((r * np.cos(angle), r * np.sin(angle), np.zeros(len(r))), axis=-1)
        mount = scan.T_base_laser
        ends: FloatArray = (points @ mount.rotation.T + mount.position)[:, :2]
        return np.asarray(mount.position[:2], dtype=np.float64), ends

    def _match(self, ends: FloatArray, start: Pose2) -> Pose2:
        """Return the pose after Gauss-Newton from the coarsest level to the finest."""
        pose = start.as_array()
        for i in reversed(range(len(self._levels))):
            pose = self._levels[i].match(ends, pose, ITERATIONS[min(i, len(ITERATIONS) - 1)])
        x, y, yaw = pose.tolist()
        return Pose2(x, y, wrap_angle(yaw))


MAX_LOG_ODDS = 50.0
"""Upper limit of the log-odds of a raised cell."""
LARGEST_TURN = 0.2
"""Largest turn of one Gauss-Newton step, radians."""


class OriginalMap:
    """Square map of log-odds, 0 in unknown cells; a scan changes each cell once.

    As in the original, the size is fixed, the start is the center of cell (size / 2, size / 2), and a beam is
    drawn only where both its ends are inside.
    """

    def __init__(self, resolution: float, size: int, miss: float, hit: float) -> None:
        """Start empty, with an even number of cells along an edge of the map.

        A beam adds the log-odds `miss` where it passes, and `hit` where it ends.
        """
        self._resolution, self._middle = resolution, size // 2
        self._odds = miss, hit
        self._log_odds = np.zeros((size, size), np.float32)
        self._probability = np.full((size, size), 0.5, np.float32)
        self._drawn = np.zeros((size, size), np.int32)
        self._scans = 0

    @property
    def nbytes(self) -> int:
        """Memory of its layers."""
        return self._log_odds.nbytes + self._probability.nbytes + self._drawn.nbytes

    def match(self, ends: FloatArray, pose: FloatArray, steps: int) -> FloatArray:
        """Return the (3,) pose after Gauss-Newton steps (Eqs. 7-13); `pose` where no end is inside.

        The ends of beams (n, 2) are in the base frame, meters.
        """
        matched: FloatArray = _match(self._probability, self._middle, self._resolution, ends, pose, steps)
        return matched

    def draw(self, pose: Pose2, laser: FloatArray, ends: FloatArray) -> None:
        """Raise the cells where beams end, lower those that they pass.

        The laser (2,) and the ends of beams (n, 2) are in the base frame, meters.
        """
        self._scans += 2
        points = np.vstack((pose.apply(laser[None]), pose.apply(ends)))
        size = len(self._drawn)
        # Clipped, so that no number is too large for a cell's; -1 and `size` are outside.
        cells = np.clip(points / self._resolution + self._middle + 0.5, -1, size).astype(np.int64)
        inside: BoolArray = np.all((cells >= 0) & (cells < size), axis=1)
        if inside[0]:
            layers = self._log_odds, self._probability, self._drawn
            _draw(layers, cells[inside], self._scans, self._odds)

    def occupancy_grid(self) -> OccupancyGrid:
        """Return the known cells."""
        values = np.where(self._drawn > 0, self._log_odds, np.float32(np.nan)).astype(np.float32)
        first = -self._middle - 0.5
        return OccupancyGrid.of_lattice(values, self._resolution, first, first)


@njit
def _match(probability: Any, middle: int, resolution: float, ends: Any, pose: Any, steps: int) -> Any:
    """Gauss-Newton in cells: the probability at the ends of the beams shall become 1 (Eq. 7)."""
    scale = 1 / resolution
    x, y, yaw = pose[0] * scale + middle, pose[1] * scale + middle, pose[2]
    for _ in range(steps):
        s, c = math.sin(yaw), math.cos(yaw)
        H, g = np.zeros((3, 3)), np.zeros(3)
        for k in range(len(ends)):
            u, v = ends[k, 0] * scale, ends[k, 1] * scale
            value, dx, dy = _interpolate(probability, c * u - s * v + x, s * u + c * v + y)
            turn = (-s * u - c * v) * dx + (c * u - s * v) * dy
            J = (dx, dy, turn)
            for i in range(3):
                g[i] += J[i] * (1 - value)
                for j in range(3):
                    H[i, j] += J[i] * J[j]
        if H[0, 0] == 0 or H[1, 1] == 0:
            break
        step = solve3(H, g)
        if not np.isfinite(step).all():
            break
        x, y = x + step[0], y + step[1]
        yaw += min(max(step[2], -LARGEST_TURN), LARGEST_TURN)
    return np.array(((x - middle) / scale, (y - middle) / scale, yaw))


@njit
def _interpolate(probability: Any, x: float, y: float) -> Any:
    """Return probability and its derivatives at a point in cells (Eqs. 4-6); zeros outside.

    The derivatives' weights are those of the original's code: each difference is weighted along its own axis,
    while the paper uses the other one.
    """
    rows, cols = probability.shape
    if not (0 <= x <= cols - 2 and 0 <= y <= rows - 2):
        return 0.0, 0.0, 0.0
    col, row = int(x), int(y)
    fx, fy = x - col, y - row
    a, b = probability[row, col], probability[row, col + 1]
    c, d = probability[row + 1, col], probability[row + 1, col + 1]
    value = (a * (1 - fx) + b * fx) * (1 - fy) + (c * (1 - fx) + d * fx) * fy
    return value, (b - a) * (1 - fx) + (d - c) * fx, (c - a) * (1 - fy) + (d - b) * fy


@njit
def line_cells(row: int, col: int, last_row: int, last_col: int) -> Any:
    """Return the cells (n, 2) of Bresenham's line: row and column, without the last."""
    dy, dx = last_row - row, last_col - col
    along, across = max(abs(dx), abs(dy)), min(abs(dx), abs(dy))
    cells = np.empty((along, 2), np.int64)
    error = along // 2
    for k in range(along):
        cells[k, 0], cells[k, 1] = row, col
        error += across
        sideways = error >= along
        if sideways:
            error -= along
        if abs(dx) >= abs(dy) or sideways:
            col += 1 if dx > 0 else -1
        if abs(dx) < abs(dy) or sideways:
            row += 1 if dy > 0 else -1
    return cells


@njit
def _draw(layers: Any, cells: Any, scan: int, odds: Any) -> None:
    """Draw the lines from cells[0] to all others.

    In `drawn`, `scan` marks a cell as passed, `scan` + 1 as hit.
    """
    log_odds, probability, drawn = layers
    for k in range(1, len(cells)):
        if cells[k, 0] == cells[0, 0] and cells[k, 1] == cells[0, 1]:
            continue
        for row, col in line_cells(cells[0, 1], cells[0, 0], cells[k, 1], cells[k, 0]):
            if drawn[row, col] < scan:
                _change(log_odds, probability, row, col, odds[0])
                drawn[row, col] = scan
        row, col = cells[k, 1], cells[k, 0]
        if drawn[row, col] < scan + 1:
            if drawn[row, col] == scan:  # passed by another beam of this scan: a hit wins
                _change(log_odds, probability, row, col, -odds[0])
            if log_odds[row, col] < MAX_LOG_ODDS:
                _change(log_odds, probability, row, col, odds[1])
            drawn[row, col] = scan + 1


@njit(inline="always")
def _change(log_odds: Any, probability: Any, row: int, col: int, by: float) -> None:
    log_odds[row, col] += by
    probability[row, col] = 1 - 1 / (1 + math.exp(log_odds[row, col]))
