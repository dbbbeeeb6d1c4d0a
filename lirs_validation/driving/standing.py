"""Standing still before a drive, as inertial systems need it to find gravity and biases."""

from __future__ import annotations

from lirs_envs.robots.command import Twist
from lirs_validation.driving.driver import Driver, Frame
from lirs_wct.geometry import Pose2


class StandingDriver:
    """Driver that hands over to another one after the robot has stood still.

    Args:
        driver: drives then; its time begins with the first motion.
        seconds: simulated time to stand still.
    """

    def __init__(self, driver: Driver, seconds: float) -> None:
        self._driver, self._seconds = driver, seconds

    @property
    def start(self) -> Pose2:
        """Start pose of the robot."""
        return self._driver.start

    @property
    def frame(self) -> Frame:
        """Frame of the poses that the driver gets."""
        return self._driver.frame

    @property
    def stuck(self) -> bool:
        """Whether the driver gave up."""
        return self._driver.stuck

    @property
    def finished(self) -> str:
        """Reason for the end of the drive; empty before the end."""
        return self._driver.finished

    def command(self, pose: Pose2, time: float) -> Twist:
        """Return no motion at first, then the driver's command (see `Driver.command`)."""
        # Half a microsecond: sums of periods are not exact.
        if time < self._seconds - 5e-7:
            return Twist()
        return self._driver.command(pose, time - self._seconds)
