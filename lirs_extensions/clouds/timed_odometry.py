"""Adapter of a system whose poses lie at times of their own."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Sequence

import numpy as np

from lirs_wct.arrays import FloatArray
from lirs_wct.geometry import Imu, ImuReadings, PointCloud, Pose3, Trajectory
from slam_baselines.kiss_icp import pose_of
from slam_baselines.mapper import MapperStats, Stopwatch

SLACK = 1e-3
"""Seconds by which a sweep may end after the last inertial reading."""


class TimedSystem(ABC):
    """System behind a `TimedOdometry`.

    Attributes:
        inertial: whether it takes inertial readings.
    """

    inertial = False

    def add_readings(self, readings: ImuReadings) -> None:
        """Take in inertial readings; nothing by default."""
        return

    @abstractmethod
    def register(self, cloud: PointCloud) -> Sequence[tuple[float, FloatArray]]:
        """Register a sweep with points; return new poses `T_world_base` (4, 4) and their times."""


class TimedOdometry:
    """A `CloudMapper` of a system whose poses lie at times of their own.

    A system with inertial readings gets a sweep when the readings reach the sweep's end. Poses at the stamps
    are interpolated; the present one is extrapolated at constant velocity.

    The map frame is the first base pose. An inertial system first measures gravity while the robot stands
    still: there, the first pose that differs from the initial one counts.
    """

    reads_clouds = True
    lost = False

    def __init__(self, system: TimedSystem) -> None:
        self._system, self.reads_inertial = system, system.inertial
        self._waiting: deque[PointCloud] = deque()
        self._stamps: list[float] = []
        self._times: list[float] = []
        self._poses: list[Pose3] = []
        self._empty, self._reached = 0, -np.inf
        self._watch = Stopwatch()

    def update(self, cloud: PointCloud, imu: Imu | None, readings: ImuReadings | None = None) -> Pose3:
        """Register all complete sweeps; return `T_map_base` at the stamp."""
        started = self._watch.start()
        self._stamps.append(cloud.stamp)
        self._waiting.append(cloud)
        if readings is not None and len(readings):
            self._system.add_readings(readings)
            self._reached = float(readings.stamps[-1])
        while self._waiting and self._complete(self._waiting[0]):
            self._register(self._waiting.popleft())
        pose = self._at(self._stamps[-1:])[0]
        self._watch.stop(started)
        return pose

    def trajectory(self) -> Trajectory:
        """Return the poses at the stamps of all sweeps."""
        return Trajectory.from_poses(self._stamps, self._at(self._stamps))

    @property
    def stats(self) -> MapperStats:
        """Sweeps and times."""
        received, waiting = len(self._stamps), len(self._waiting)
        reasons = {"empty": self._empty, "after the last reading": waiting}
        skipped = {reason: count for reason, count in reasons.items() if count}
        used = received - self._empty - waiting
        return MapperStats(received=received, used=used, skipped=skipped, **self._watch.summary())

    def _complete(self, cloud: PointCloud) -> bool:
        end = cloud.stamp + (float(cloud.time.max()) if len(cloud) else 0.0)
        return not self.reads_inertial or end <= self._reached + SLACK

    def _register(self, cloud: PointCloud) -> None:
        if not len(cloud):
            self._empty += 1
            return
        for time, matrix in self._system.register(cloud):
            pose = pose_of(matrix)
            # A repeated pose means that the system skipped the sweep, or does not run yet.
            if not self._poses or pose != self._poses[-1]:
                self._times.append(time)
                self._poses.append(pose)

    def _at(self, stamps: Sequence[float]) -> list[Pose3]:
        """Return `T_map_base` at some stamps; the identity before the map frame's time."""
        first = 1 if self.reads_inertial else 0
        times, poses = self._times[first:], self._poses[first:]
        if len(poses) < 2:
            return [Pose3()] * len(stamps)
        T_map_world = poses_at(times, poses, [max(times[0], self._stamps[0])])[0].inverse()
        found = poses_at(times, poses, [max(stamp, times[0]) for stamp in stamps])
        return [T_map_world @ pose for pose in found]


def poses_at(times: Sequence[float], poses: Sequence[Pose3], stamps: Sequence[float]) -> list[Pose3]:
    """Return poses interpolated linearly between two or more, or extrapolated from the nearest two.

    Args:
        times: increasing, seconds.
        poses: at these times.
        stamps: Times of the wanted poses, seconds.
    """
    t = np.asarray(times)
    after = np.clip(np.searchsorted(t, stamps), 1, len(t) - 1)
    share = (np.asarray(stamps) - t[after - 1]) / (t[after] - t[after - 1])
    found = []
    for k, s in zip(after.tolist(), share.tolist(), strict=True):
        a, b = poses[k - 1], poses[k]
        qa, qb = a.quaternion, b.quaternion
        q = (1 - s) * qa + s * (qb if qa @ qb > 0 else -qb)
        found.append(Pose3.from_arrays((1 - s) * a.position + s * b.position, q))
    return found


def deskew(points: FloatArray, times: FloatArray, motion: FloatArray) -> FloatArray:
    """Return points (n, 3) as seen from the sensor in the middle of the sweep.

    The motion is constant in the sweep: rotation by Rodrigues' formula, translation linear. Seen from the
    middle, an error of the motion hardly moves the cloud; seen from the start, it would come back as the next
    motion's error.

    Args:
        points: (n, 3) in the sensor's frame at the time of each, meters.
        times: (n,) seconds since the stamp, or none (0,): the points are returned unchanged.
        motion: (4, 4) pose of the sensor at the sweep's end in its frame at the stamp.
    """
    if not len(times):
        return points
    share = (times / times.max() - 0.5)[:, None]
    w, *v = pose_of(motion).quaternion
    sine = np.linalg.norm(v)
    axis = np.asarray(v) / max(sine, 1e-12)
    angle = 2 * np.arctan2(sine, w) * share
    along = (points @ axis)[:, None] * axis
    turned = along + (points - along) * np.cos(angle) + np.cross(axis, points) * np.sin(angle)
    seen: FloatArray = turned + share * motion[:3, 3]
    return seen


def matrix_of(pose: Pose3) -> FloatArray:
    """Return the homogeneous matrix (4, 4) of a pose, meters."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = pose.rotation, pose.position
    return matrix
