"""Driver that lets a navigation policy drive by scan, odometry and goal."""

from __future__ import annotations

import math

import numpy as np

from lirs_envs.policies import Policy
from lirs_envs.robots.robot import Robot, Twist
from lirs_validation.driving.driver import Frame
from lirs_wct import LaserScan, Pose2
from lirs_wct.arrays import Float32Array, FloatArray

REACHED = 0.5
"""Distance at which a goal counts as reached, meters."""


class PolicyDriver:
    """Lets a policy drive to goals one after the other.

    As in the environments, the policy sees distance and bearing of the goal from the true pose.

    Args:
        policy: reads the observations `scan`, `goal` and `odometry`.
        robot: figures of the robot.
        start: start pose of the robot, world frame.
        goals: (n, 2) places in their order, world frame, meters; at least one.
    """

    frame: Frame = "world"
    stuck = False

    def __init__(self, policy: Policy, robot: Robot, start: Pose2, goals: FloatArray) -> None:
        self.start = start
        self._policy, self._robot, self._goals = policy, robot, goals
        self._at = 0
        policy.reset({})

    @property
    def finished(self) -> str:
        """Reason for the end of the drive; empty before the end."""
        return "the last goal is reached" if self._at == len(self._goals) else ""

    def sense(self, scan: LaserScan, odometry: Pose2) -> None:
        """Keep scan and odometry for the next command."""
        self._scan = _finite(scan)
        self._odometry = odometry.as_array()

    def command(self, pose: Pose2, time: float) -> Twist:
        """Return the policy's command; at rest after the last goal."""
        if not self.finished and self._polar(pose)[0] < REACHED:
            self._at += 1
            self._policy.reset({})
        if self.finished:
            return Twist()
        seen = {"scan": self._scan, "goal": self._polar(pose), "odometry": self._odometry}
        v, omega = self._policy.act(seen)[:2].tolist()
        return Twist(v * self._robot.max_speed, omega * self._robot.max_turn_rate)

    def _polar(self, pose: Pose2) -> tuple[float, float]:
        """Return distance and bearing of the present goal."""
        dx, dy = (self._goals[self._at] - (pose.x, pose.y)).tolist()
        return math.hypot(dx, dy), math.remainder(math.atan2(dy, dx) - pose.yaw, math.tau)


def _finite(scan: LaserScan) -> Float32Array:
    """Return ranges without infinities: no hit is `range_max`, too near or invalid is 0."""
    ranges = np.nan_to_num(scan.ranges, nan=0.0, posinf=scan.range_max, neginf=0.0)
    return np.clip(ranges, 0.0, scan.range_max)
