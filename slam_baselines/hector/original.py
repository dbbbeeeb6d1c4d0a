"""HectorSLAM as its original behaves: planar, Gauss-Newton on the map alone, the odometry only as a start.

Kohlbrecher et al. 2011, sections IV and V, with the defaults of hector_mapping. No attitude, no prior, no
wider search, no ground filter: on uneven ground it takes hillsides for walls, as the original does. It never
says that it is lost.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lirs_wct.arrays import FloatArray
from lirs_wct.errors import ConfigError
from lirs_wct.field_validators import require_above, require_at_least, require_within
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.pose import Pose2, wrap_angle
from lirs_wct.geometry.scan import Imu, LaserScan
from lirs_wct.geometry.trajectory import Trajectory
from slam_baselines.common.stopwatch import Stopwatch
from slam_baselines.hector.original_map import OriginalMap
from slam_baselines.mapper import MapperStats

ITERATIONS = (6, 4, 4)
"""Gauss-Newton steps on the finest level, and on each coarser one."""


@dataclass(frozen=True, kw_only=True)
class HectorOriginalConfig:
    """Parameters of hector_mapping by their names.

    Attributes:
        map_resolution: edge of a cell of the finest level, meters.
        map_size: cells along an edge of the finest level, with the start in its middle. Beams that leave the
            map are not drawn and not matched; outside, the estimate follows the odometry. The launch file of
            the original has 2048: at 0.05 m it ends 51 m from the start, too near for a log of a campus.
        map_multi_res_levels: number of levels, each twice as coarse as the one before.
        map_update_distance_thresh: distance to the last map update after which the next is due, meters.
        map_update_angle_thresh: the same for the heading, radians.
        update_factor_free: probability that a cell is occupied, given that a beam passed it.
        update_factor_occupied: probability that a cell is occupied, given that a beam ended there.
        laser_min_dist: nearer hits are not used, meters.
        laser_max_dist: farther hits are not used, meters.

    Raises:
        ConfigError: a length that is not above 0, a map size that cannot be halved for each level, or a
            probability on the wrong side of 0.5.
    """

    map_resolution: float = 0.05
    map_size: int = 4096
    map_multi_res_levels: int = 3
    map_update_distance_thresh: float = 0.4
    map_update_angle_thresh: float = 0.9
    update_factor_free: float = 0.4
    update_factor_occupied: float = 0.9
    laser_min_dist: float = 0.4
    laser_max_dist: float = 30.0

    def __post_init__(self) -> None:
        require_above(self, 0, "map_resolution", "laser_max_dist", unit="m")
        require_at_least(self, 1, "map_multi_res_levels")
        multiple = 2**self.map_multi_res_levels
        if self.map_size < multiple or self.map_size % multiple:
            raise ConfigError(
                f"map_size must be a multiple of {multiple} (2^map_multi_res_levels), got {self.map_size}"
            )
        require_at_least(self, 0, "map_update_distance_thresh", "map_update_angle_thresh", "laser_min_dist")
        require_within(self, "(0, 0.5)", "update_factor_free")
        require_within(self, "(0.5, 1)", "update_factor_occupied")


class HectorOriginalMapper:
    """Scan-to-map matching, coarse to fine; the map is drawn after 0.4 m or 0.9 rad.

    Attributes:
        lost: always False: the original has no monitor.
        requires_odometry: False; without odometry the last pose is the start of the match.
    """

    lost = False
    requires_odometry = False

    def __init__(self, config: HectorOriginalConfig | None = None) -> None:
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
        self._received = self._updates = 0
        self._stopwatch = Stopwatch()

    @property
    def resolution(self) -> float:
        """Edge of a cell of the map, meters."""
        return self.config.map_resolution

    def update(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        """Match the scan to the map from where the odometry leads, draw it if due; return `T_map_base`."""
        started = self._stopwatch.start()
        self._received += 1
        laser, ends = self._points(scan)
        self._pose = self._match(ends, self._start(odometry))
        if self._update_due():
            for level in self._levels:
                level.draw(self._pose, laser, ends)
            self._drawn_at = self._pose
            self._updates += 1
        self._poses[scan.stamp] = self._pose
        self._stopwatch.stop(started)
        return self._pose

    def map(self) -> OccupancyGrid:
        """Return the finest level."""
        return self._levels[0].occupancy_grid()

    def trajectory(self) -> Trajectory:
        """Return the pose of every scan, by stamp."""
        stamps = sorted(self._poses)
        return Trajectory.from_poses(stamps, [self._poses[t] for t in stamps])

    @property
    def stats(self) -> MapperStats:
        """What was done so far."""
        return MapperStats(
            received=self._received,
            used=self._received,
            memory=sum(level.nbytes for level in self._levels),
            counts={"map_updates": self._updates},
            **self._stopwatch.summary(),
        )

    def _points(self, scan: LaserScan) -> tuple[FloatArray, FloatArray]:
        """Return (2,) the laser and (n, 2) usable ends of beams in the base frame, as if it were level."""
        c, ranges = self.config, scan.ranges.astype(np.float64)
        nearest, farthest = (
            max(scan.range_min, c.laser_min_dist),
            min(scan.range_max - 0.01, c.laser_max_dist),
        )
        usable = (ranges > nearest) & (ranges < farthest)
        r, angle = ranges[usable], scan.angles[usable]
        points = np.stack((r * np.cos(angle), r * np.sin(angle), np.zeros(len(r))), axis=-1)
        mount = scan.T_base_laser
        ends: FloatArray = (points @ mount.rotation.T + mount.position)[:, :2]
        return np.asarray(mount.position[:2], dtype=np.float64), ends

    def _start(self, odometry: Pose2 | None) -> Pose2:
        """Return the last pose, moved by what the odometry says since."""
        before, self._odometry = self._odometry, odometry
        if before is None or odometry is None:
            return self._pose
        return self._pose @ (before.inverse() @ odometry)

    def _match(self, ends: FloatArray, start: Pose2) -> Pose2:
        """Return the pose after Gauss-Newton from the coarsest level to the finest."""
        pose = start.as_array()
        for i in reversed(range(len(self._levels))):
            pose = self._levels[i].match(ends, pose, ITERATIONS[min(i, len(ITERATIONS) - 1)])
        x, y, yaw = pose.tolist()
        return Pose2(x, y, wrap_angle(yaw))

    def _update_due(self) -> bool:
        c, before = self.config, self._drawn_at
        return (
            before is None
            or self._pose.distance(before) > c.map_update_distance_thresh
            or abs(wrap_angle(self._pose.yaw - before.yaw)) > c.map_update_angle_thresh
        )
