"""Driver that lets a navigation policy drive by scan, odometry and goal."""

from __future__ import annotations

import math

import numpy as np

from lirs_envs.episodes.observations import make_finite
from lirs_envs.policies import Policy
from lirs_envs.robots.robot import Robot, Twist, clip
from lirs_validation.driving.driver import Frame
from lirs_wct import LaserScan, Pose2
from lirs_wct.arrays import FloatArray

REACHED = 0.5
"""Distance at which a goal counts as reached, meters."""
STEP, PATIENCE = 0.5, 30.0
"""The driver gives up after PATIENCE seconds within STEP meters of a place."""


class PolicyDriver:
    """Lets a policy drive to goals one after the other.

    As in the environments, the policy sees distance and bearing of the goal from the true pose.

    Args:
        policy: reads the observations `scan`, `goal` and `odometry`.
        robot: figures of the robot.
        start: start pose of the robot, world frame.
        goals: (n, 2) places in their order, world frame, meters; at least one.
        factors: of the policy's speed and turn rate.
    """

    frame: Frame = "world"

    def __init__(
        self, policy: Policy, robot: Robot, start: Pose2, goals: FloatArray, factors: tuple[float, float]
    ) -> None:
        self.start, self.stuck = start, False
        self._policy, self._robot, self._goals, self._factors = policy, robot, goals, factors
        self._at = 0
        self._place, self._moved_at = start, 0.0
        policy.reset({})

    @property
    def finished(self) -> str:
        """Reason for the end of the drive; empty before the end."""
        return "the last goal is reached" if self._at == len(self._goals) else ""

    def sense(self, scan: LaserScan, odometry: Pose2) -> None:
        """Keep scan and odometry for the next command."""
        ranges = scan.ranges[None].copy()
        make_finite(ranges, np.float32(scan.range_max))
        self._scan = ranges[0]
        self._odometry = odometry.as_array()

    def command(self, pose: Pose2, time: float) -> Twist:
        """Return the policy's command; at rest after the last goal, and after it gave up."""
        if not self.finished and self._polar(pose)[0] < REACHED:
            self._at += 1
            self._policy.reset({})
        if math.hypot(pose.x - self._place.x, pose.y - self._place.y) > STEP:
            self._place, self._moved_at = pose, time
        self.stuck = not self.finished and time - self._moved_at > PATIENCE
        if self.finished or self.stuck:
            return Twist()
        seen = {"scan": self._scan, "goal": self._polar(pose), "odometry": self._odometry}
        v, omega = (self._policy.act(seen)[:2] * self._factors).tolist()
        return Twist(clip(v, 1.0) * self._robot.max_speed, clip(omega, 1.0) * self._robot.max_turn_rate)

    def _polar(self, pose: Pose2) -> tuple[float, float]:
        """Return distance and bearing of the present goal."""
        dx, dy = (self._goals[self._at] - (pose.x, pose.y)).tolist()
        return math.hypot(dx, dy), math.remainder(math.atan2(dy, dx) - pose.yaw, math.tau)
