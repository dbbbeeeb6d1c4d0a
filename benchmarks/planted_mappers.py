"""Mappers with one planted defect each, around our hector; `lirs-wct falsify` should find every one.

Example: lirs-wct falsify --mapper planted_mappers:WrongRoll --reference hector -o out/
"""
# ruff: noqa: D102

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

from lirs_wct import Imu, LaserScan, Pose2, Trajectory
from slam_baselines.hector import HectorConfig, HectorMapper

LAG = 0.1
"""Seconds."""
DRIFT = math.radians(2.0)
"""Rate of the heading at standstill, rad/s."""
STILL = 0.02
"""Speed below which the robot stands still or turns on the spot, m/s."""


class WrongRoll(HectorMapper):
    """The sign of the roll is wrong."""

    def update(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        return super().update(scan, odometry, imu and replace(imu, roll=-imu.roll))


class LateScans(HectorMapper):
    """Scans are 100 ms older than odometry and attitude."""

    def __init__(self) -> None:
        super().__init__()
        self._late: deque[LaserScan] = deque()

    def update(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        self._late.append(scan)
        while len(self._late) > 1 and self._late[1].stamp <= scan.stamp - LAG + 1e-6:
            self._late.popleft()
        return super().update(replace(self._late[0], stamp=scan.stamp), odometry, imu)


class LosesScans(HectorMapper):
    """Every third scan is lost, and its odometry increment with it."""

    def __init__(self) -> None:
        super().__init__()
        self._count, self._sum = 0, Pose2()
        self._before: Pose2 | None = None

    def update(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        assert odometry is not None, "this mapper needs odometry"
        step = (self._before or odometry).inverse() @ odometry
        self._before, self._count = odometry, self._count + 1
        if self._count % 3 == 0:
            return self.front.estimate.pose
        self._sum = self._sum @ step
        return super().update(scan, self._sum, imu)


class NeverForgets(HectorMapper):
    """Free space does not lower the occupancy of a cell."""

    def __init__(self) -> None:
        super().__init__(HectorConfig(update_factor_free=0.4999))


class DriftsAtStandstill(HectorMapper):
    """The heading drifts while the robot stands still or turns on the spot."""

    def __init__(self) -> None:
        super().__init__()
        self._drift, self._stamp = Pose2(), 0.0
        self._before: Pose2 | None = None
        self._stamps: list[float] = []
        self._poses: list[Pose2] = []

    def update(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        assert odometry is not None, "this mapper needs odometry"
        pose, step = super().update(scan, odometry, imu), scan.stamp - self._stamp
        moved = (self._before or odometry).inverse() @ odometry
        if math.hypot(moved.x, moved.y) < STILL * step:
            place = self._drift @ Pose2(pose.x, pose.y)
            self._drift = place @ Pose2(0.0, 0.0, DRIFT * step) @ Pose2(-pose.x, -pose.y)
        self._before, self._stamp = odometry, scan.stamp
        self._stamps.append(scan.stamp)
        self._poses.append(self._drift @ pose)
        return self._poses[-1]

    def trajectory(self) -> Trajectory:
        return Trajectory.from_poses(self._stamps, self._poses)


DEFECTS = (WrongRoll, LateScans, LosesScans, NeverForgets, DriftsAtStandstill)
