"""Motion filter: selection of the scans that become nodes."""

from __future__ import annotations

import math
from dataclasses import dataclass

from lirs_wct.checks import Checked, limited
from lirs_wct.geometry import Pose2, wrap_angle
from slam_baselines.leveling import LeveledScan


@dataclass(frozen=True, kw_only=True)
class MotionFilterConfig(Checked, of="the motion filter"):
    """Motion after which a scan becomes a node; names as in Cartographer's motion_filter.

    Attributes:
        max_time_seconds: longest time between two nodes.
        max_distance_meters: largest distance between two nodes.
        max_angle_radians: largest turn between two nodes.
        max_tilt_radians: largest change of tilt between two nodes; it shows other heights of the same things.
    """

    max_time_seconds: float = limited(math.inf, "[0, inf]")
    max_distance_meters: float = limited(0.2, "[0, inf]")
    max_angle_radians: float = limited(math.radians(10.0), "[0, inf]")
    max_tilt_radians: float = limited(math.radians(1.0), "[0, inf]")


class MotionFilter:
    """Comparison of scans with the last node."""

    def __init__(self, config: MotionFilterConfig) -> None:
        self._config = config
        self._pose: Pose2 | None = None
        self._slope = (0.0, 0.0)
        self._stamp = -math.inf

    def note(self, scan: LeveledScan, pose: Pose2) -> None:
        """Record a node."""
        self._pose, self._slope, self._stamp = pose, scan.ground_slope, scan.stamp

    def correct_pose(self, pose: Pose2) -> None:
        """Correct the last node's pose."""
        self._pose = pose

    def due(self, scan: LeveledScan, pose: Pose2) -> bool:
        """Whether the robot has moved enough since the last node."""
        if self._pose is None:
            return True
        c = self._config
        tilt = math.hypot(scan.ground_slope[0] - self._slope[0], scan.ground_slope[1] - self._slope[1])
        return (
            pose.distance(self._pose) > c.max_distance_meters
            or abs(wrap_angle(pose.yaw - self._pose.yaw)) > c.max_angle_radians
            or tilt > c.max_tilt_radians
            or scan.stamp - self._stamp > c.max_time_seconds
        )
