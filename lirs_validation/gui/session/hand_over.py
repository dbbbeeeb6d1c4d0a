"""A driver that a person can take the wheel from, and give it back to."""

from __future__ import annotations

from lirs_envs.robots.command import Twist, clip
from lirs_envs.robots.robot import Robot
from lirs_validation.driving.driver import Driver, Frame
from lirs_wct.geometry.pose import Pose2


class HandOverDriver:
    """Drives as another driver does, or as a person says.

    Attributes:
        by_hand: whether a person drives.
        touched: whether a person drove at any time.

    Args:
        driver: that drives otherwise.
        robot: whose limits hold for the person, too.
    """

    def __init__(self, driver: Driver, robot: Robot) -> None:
        self._driver, self._robot = driver, robot
        self._wanted = Twist()
        self.by_hand = self.touched = False

    def steer(self, forward: float, left: float) -> None:
        """Take in where the stick is, from -1 to 1 each: forward, and to the left."""
        self._wanted = Twist(
            clip(forward, 1.0) * self._robot.max_speed, clip(left, 1.0) * self._robot.max_turn_rate
        )

    @property
    def start(self) -> Pose2:
        """Where the robot is set down."""
        return self._driver.start

    @property
    def frame(self) -> Frame:
        """Which poses it is given."""
        return self._driver.frame

    @property
    def stuck(self) -> bool:
        """Whether the driver gave up; a person never does."""
        return not self.by_hand and self._driver.stuck

    @property
    def finished(self) -> str:
        """Why nothing is left to drive; empty while there is."""
        return "" if self.by_hand else self._driver.finished

    def command(self, pose: Pose2, time: float) -> Twist:
        """Return the command for the next tick."""
        if not self.by_hand:
            return self._driver.command(pose, time)
        self.touched = True
        return self._wanted
