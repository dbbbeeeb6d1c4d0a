"""Local SLAM of the original: prediction, scan matching, and insertion into two submaps.

As in the original, scans are matched in axes that turn with the predicted heading (its "gravity-aligned"
frame, a plane without IMU); only the voxels depend on it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from lirs_extensions.originals.cartographer.config import CartographerOriginalConfig
from lirs_extensions.originals.cartographer.probability_grid import (
    ProbabilityGrid,
    RangeData,
    adaptive_voxel_filter,
    read_scan,
    update_table,
)
from lirs_extensions.originals.cartographer.scan_matching import match_scan, search_online
from lirs_wct.geometry import Float32Array, LaserScan, Pose2, wrap_angle

MIN_INTERVAL = 0.001
"""Poses closer in time than this give no velocity, seconds."""


class StampedPose(NamedTuple):
    """A pose and its time, seconds."""

    stamp: float
    pose: Pose2


class Velocity(NamedTuple):
    """Velocity in the local frame, m/s and rad/s."""

    x: float = 0.0
    y: float = 0.0
    turn: float = 0.0


class PoseExtrapolator:
    """Predictor of poses in the local frame.

    The heading is the sum of all predicted turns until the last pose, radians; the axes of the "gravity-
    aligned" frame in which scans are matched.
    """

    def __init__(self) -> None:
        self.heading = 0.0
        self._poses: list[StampedPose] = []
        self._odometry: list[StampedPose] = []
        self._by_poses = self._by_odometry = Velocity()
        self._turn_rate = 0.0

    @property
    def last_stamp(self) -> float:
        """Time of the last pose, seconds; -inf before the first."""
        return self._poses[-1].stamp if self._poses else -math.inf

    def add_pose(self, stamp: float, pose: Pose2) -> None:
        """Add a matched pose `T_local_base`."""
        self.heading = self.heading_at(stamp)
        self._poses.append(StampedPose(stamp, pose))
        while len(self._poses) > 2 and self._poses[1].stamp <= stamp - MIN_INTERVAL:
            del self._poses[0]
        oldest = self._poses[0]
        seconds = stamp - oldest.stamp
        if seconds >= MIN_INTERVAL:
            turn = wrap_angle(pose.yaw - oldest.pose.yaw)
            dx, dy = pose.x - oldest.pose.x, pose.y - oldest.pose.y
            self._by_poses = Velocity(dx / seconds, dy / seconds, turn / seconds)
        # Set after the heading has turned: the rate acts one scan late.
        self._turn_rate = self._velocity.turn
        self._trim()

    def add_odometry(self, stamp: float, odometry: Pose2) -> None:
        """Add odometry `T_odom_base`, not older than the last pose; ignored before the first."""
        if not self._poses:
            return
        self._odometry.append(StampedPose(stamp, odometry))
        self._trim()
        oldest = self._odometry[0]
        seconds = stamp - oldest.stamp
        if seconds <= 0:
            return
        back = odometry.inverse() @ oldest.pose
        yaw = self.predict(stamp).yaw
        # The step is in the axes of the newer pose.
        vx, vy = -back.x / seconds, -back.y / seconds
        c, s = math.cos(yaw), math.sin(yaw)
        self._by_odometry = Velocity(c * vx - s * vy, s * vx + c * vy, -back.yaw / seconds)

    def heading_at(self, stamp: float) -> float:
        """Return the heading at a time not before the last pose, radians."""
        return wrap_angle(self.heading + self._predict_turn(stamp))

    def predict(self, stamp: float) -> Pose2:
        """Return the pose `T_local_base` at a time not before the last pose."""
        last, velocity = self._poses[-1], self._velocity
        seconds = stamp - last.stamp
        pose, yaw = last.pose, wrap_angle(last.pose.yaw + self._predict_turn(stamp))
        return Pose2(pose.x + seconds * velocity.x, pose.y + seconds * velocity.y, yaw)

    @property
    def _velocity(self) -> Velocity:
        return self._by_poses if len(self._odometry) < 2 else self._by_odometry

    def _predict_turn(self, stamp: float) -> float:
        return self._turn_rate * (stamp - self.last_stamp) if self._poses else 0.0

    def _trim(self) -> None:
        """Drop odometry before the last that is not newer than the last pose."""
        while len(self._odometry) > 2 and self._odometry[1].stamp <= self.last_stamp:
            del self._odometry[0]


class GridSubmap:
    """Submap with a probability grid in the local frame.

    Its pose `T_local_submap` is the base at its first scan, with the axes of the local frame.
    """

    def __init__(self, resolution: float, pose: Pose2) -> None:
        self.pose = pose
        self.grid = ProbabilityGrid(resolution, np.array((pose.x, pose.y)))
        self.count = 0
        self.finished = False


class TrajectoryNode(NamedTuple):
    """Scan that entered the submaps.

    Attributes:
        pose: `T_local_node`, in the axes in which the scan was matched.
        heading: Angle of the base in these axes, radians.
        odometry: `T_odom_base` at the scan; None without.
        points: (n, 2) that were matched, in the node's frame, meters.
        submaps: Indices of the submaps that it entered, the older first.
        finished: Whether it was the last scan of the older one.
    """

    stamp: float
    pose: Pose2
    heading: float
    odometry: Pose2 | None
    points: Float32Array
    submaps: tuple[int, ...]
    finished: bool

    @property
    def T_local_base(self) -> Pose2:  # noqa: N802
        """Pose of the base in the local frame."""
        return self.pose @ Pose2(yaw=self.heading)


class TrajectoryBuilder:
    """Local SLAM, and all its submaps."""

    def __init__(self, config: CartographerOriginalConfig) -> None:
        self._config = config
        self.submaps: list[GridSubmap] = []
        self._active: list[int] = []
        self._extrapolator = PoseExtrapolator()
        self._tables = update_table(config.hit_probability), update_table(config.miss_probability)
        self._last: tuple[float, Pose2] | None = None

    def add_scan(self, scan: LaserScan, odometry: Pose2 | None) -> tuple[Pose2, bool, TrajectoryNode | None]:
        """Match a scan; insert it if the robot has moved.

        Returns `T_local_base`, predicted without a match; whether it was matched; and its node if inserted.
        """
        c, extrapolator, stamp = self._config, self._extrapolator, scan.stamp
        if extrapolator.last_stamp == -np.inf:
            extrapolator.add_pose(stamp, Pose2())
        elif odometry is not None:
            extrapolator.add_odometry(stamp, odometry)
        heading, predicted = extrapolator.heading_at(stamp), extrapolator.predict(stamp)
        data = read_scan(scan, c).transform(Pose2(yaw=heading)).thin(c.voxel_filter_size)
        points = adaptive_voxel_filter(data.returns, c)
        if len(points) == 0:
            return predicted, False, None
        expected = predicted @ Pose2(yaw=-heading)
        pose = expected
        if self._active:
            grid, start = self.submaps[self._active[0]].grid, expected
            if c.use_online_correlative_scan_matching:
                start = search_online(grid, points, expected, c)
            pose = match_scan(grid, points, expected, start, c.ceres_matcher)
        T_local_base = pose @ Pose2(yaw=heading)
        extrapolator.add_pose(stamp, T_local_base)
        if not self._node_due(stamp, T_local_base):
            return T_local_base, True, None
        entered, finished = self._insert(data.transform(pose))
        node = TrajectoryNode(stamp, pose, heading, odometry, points, entered, finished)
        return T_local_base, True, node

    def _node_due(self, stamp: float, pose: Pose2) -> bool:
        """Return whether time, distance or turn since the last node exceed their limits."""
        c = self._config
        if self._last is not None:
            then, last = self._last
            turn = abs(wrap_angle(pose.yaw - last.yaw))
            near = pose.distance(last) <= c.max_distance_meters and turn <= c.max_angle_radians
            if near and stamp - then <= c.max_time_seconds:
                return False
        self._last = stamp, pose
        return True

    def _insert(self, data: RangeData) -> tuple[tuple[int, ...], bool]:
        """Insert data; return the entered submaps, and whether the older one is finished."""
        size = self._config.num_range_data
        if not self._active or self.submaps[self._active[-1]].count == size:
            # The finished submap is matched until the next one begins.
            self._active = [i for i in self._active if not self.submaps[i].finished]
            self._active.append(len(self.submaps))
            x, y = data.origin.tolist()
            self.submaps.append(GridSubmap(self._config.resolution, Pose2(x, y)))
        for i in self._active:
            self.submaps[i].grid.insert(data, *self._tables)
            self.submaps[i].count += 1
        oldest = self.submaps[self._active[0]]
        if oldest.count == 2 * size:
            oldest.grid, oldest.finished = oldest.grid.crop(), True
        return tuple(self._active), oldest.finished
