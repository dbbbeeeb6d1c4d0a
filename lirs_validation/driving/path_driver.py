"""Path driver: follows a route, backs off, replans and finally gives up."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal, Protocol

from lirs_envs.robots.command import Twist
from lirs_envs.robots.robot import Robot
from lirs_validation.driving.driver import Frame
from lirs_validation.driving.pursuit import Pursuit, PursuitConfig
from lirs_wct.arrays import FloatArray
from lirs_wct.field_validators import require_above
from lirs_wct.geometry import Pose2, wrap_angle

DriverState = Literal["driving", "turning", "backing off", "waiting", "stuck", "finished"]


@dataclass(frozen=True, kw_only=True)
class DriverConfig:
    """Parameters of a path driver.

    Attributes:
        pursuit: how a path is followed.
        patience: seconds without progress before it backs off.
        step: meters along the path that count as progress; a path's end is reached within them.
        back_off: seconds that it drives backwards.
        back_speed: m/s while doing so.
        tries: how often in a row it backs off before it gives up.
        off_path: distance from the path at which it replans, meters.
        facing: heading error that is left after a turn to a wanted yaw, radians.

    Raises:
        ConfigError: a value is not above 0.
    """

    pursuit: PursuitConfig = field(default_factory=PursuitConfig)
    patience: float = 8.0
    step: float = 0.3
    back_off: float = 2.5
    back_speed: float = 0.3
    tries: int = 4
    off_path: float = 1.0
    facing: float = math.radians(5)

    def __post_init__(self) -> None:
        own = ("patience", "step", "back_off", "back_speed", "tries", "off_path", "facing")
        require_above(self, 0, *own, of="a driver")


@dataclass(frozen=True)
class Path:
    """A path to drive.

    Attributes:
        points: (n, 2) meters, about 0.1 m apart, in the driver's frame.
        speed: (n,) m/s.
        yaw: where to face at its end; None = as it comes.
    """

    points: FloatArray
    speed: FloatArray
    yaw: float | None = None


class Route(Protocol):
    """Interface of a route: the source of a driver's paths."""

    frame: Frame
    """Of the poses and the paths."""
    refresh: float
    """Seconds after which a valid path is planned again; inf = never."""
    ends: str
    """Why the drive is over once no path is left; empty = there may be one later."""

    def path(self, pose: Pose2, time: float, undriven: float | None) -> Path | None:
        """Return the path from a pose; None if there is none.

        `ends` says whether there may be one later.

        Args:
            pose: of the robot.
            time: seconds since the start.
            undriven: meters of the path before that are left; None = this is the first one.
        """
        ...

    def avoid(self, point: tuple[float, float], radius: float) -> None:
        """Avoid a place where the robot got stuck.

        Meters, in the driver's frame.
        """
        ...


class PathDriver:
    """Follows the paths of a route.

    Attributes:
        start: where the robot is set down, world frame.
        frame: frame of the poses that it receives.
        state: current activity.

    Args:
        route: where to drive.
        start: where the robot is set down, world frame.
        config: how to drive.
    """

    def __init__(self, route: Route, start: Pose2, config: DriverConfig | None = None) -> None:
        self.start, self.frame = start, route.frame
        self.state: DriverState = "waiting"
        self.config = config or DriverConfig()
        self._route = route
        self._back_until, self._failures = 0.0, 0
        self._mark, self._moved_at, self._planned_at = 0.0, 0.0, -math.inf
        self._v, self._commanded_at = 0.0, 0.0
        if self.frame == "world":  # a mapper has no map yet
            self._follow(start, 0.0, None)

    @property
    def stuck(self) -> bool:
        """Whether it gave up."""
        return self.state == "stuck"

    @property
    def finished(self) -> str:
        """Why nothing is left to drive; empty while there is."""
        return self._route.ends if self.state == "finished" else ""

    @property
    def path(self) -> FloatArray:
        """(n, 2) points of the present path, meters."""
        return self._path.points

    def command(self, pose: Pose2, time: float) -> Twist:
        """Return the command for the next tick: wheels that start with a jerk would spin."""
        wanted = self._choose_command(pose, time)
        gain = self.config.pursuit.acceleration * max(0.0, time - self._commanded_at)
        self._v = min(wanted.v, max(0.0, self._v) + gain)
        self._commanded_at = time
        return Twist(self._v, wanted.omega)

    def _choose_command(self, pose: Pose2, time: float) -> Twist:
        if self.state in ("stuck", "finished"):
            return Twist(0.0, 0.0)
        if self.state == "backing off":
            if time < self._back_until:
                return self._backwards()
            self._replan(pose, time)
        elif time - self._planned_at >= self._route.refresh:
            self._refresh(pose, time)
        if self.state == "waiting":
            self.state = "stuck" if time - self._moved_at > self.config.patience else "waiting"
            return Twist(0.0, 0.0)
        if self.state == "turning":
            return self._turn(pose, time)
        return self._pursue(pose, time)

    def _pursue(self, pose: Pose2, time: float) -> Twist:
        """Follow the path.

        Replan at its end or far from it; back off without progress.
        """
        twist = self._pursuit.twist(pose)
        if self._pursuit.distance > self.config.off_path or self._pursuit.remaining < self.config.step:
            if self._path.yaw is not None and self._pursuit.distance <= self.config.off_path:
                self.state, self._moved_at = "turning", time
                return self._turn(pose, time)
            self._replan(pose, time)
            return Twist(0.0, 0.0) if self.state != "driving" else self._pursuit.twist(pose)
        if self._pursuit.progress >= self._mark + self.config.step:
            self._mark, self._moved_at = self._pursuit.progress, time
            self._failures = 0 if self._mark > 10 * self.config.step else self._failures
        elif time - self._moved_at > self.config.patience:
            return self._give_way(pose, time)
        return twist

    def _turn(self, pose: Pose2, time: float) -> Twist:
        """Turn in place to the yaw at the path's end.

        Go on once it is reached, or the robot cannot turn.
        """
        error = wrap_angle((self._path.yaw or 0.0) - pose.yaw)
        if abs(error) <= self.config.facing or time - self._moved_at > self.config.patience:
            self._replan(pose, time)
            return Twist(0.0, 0.0)
        limit = self.config.pursuit.turn_rate
        return Twist(0.0, max(-limit, min(limit, 2.0 * error)))

    def _give_way(self, pose: Pose2, time: float) -> Twist:
        """Back off and avoid the place ahead.

        Give up after too many tries.
        """
        self._failures += 1
        if self._failures > self.config.tries:
            self.state = "stuck"
            return Twist(0.0, 0.0)
        self.state = "backing off"
        self._back_until = time + self.config.back_off
        ahead = pose @ Pose2(0.7, 0.0, 0.0)
        self._route.avoid((ahead.x, ahead.y), 0.5)
        return self._backwards()

    def _backwards(self) -> Twist:
        """Reverse: straight the first time, then in turn to either side."""
        turn = (0.0, 0.5, -0.5)[(self._failures - 1) % 3]
        return Twist(-self.config.back_speed, turn)

    def _replan(self, pose: Pose2, time: float) -> None:
        self._follow(pose, time, self._pursuit.remaining)
        self._mark, self._moved_at = 0.0, time

    def _refresh(self, pose: Pose2, time: float) -> None:
        """Replan while driving; keep counting progress, so that a standing robot is noticed."""
        if self.state == "waiting":
            self._follow(pose, time, None)
            return
        driven = self._pursuit.progress
        self._follow(pose, time, self._pursuit.remaining)
        self._mark -= driven

    def _follow(self, pose: Pose2, time: float, undriven: float | None) -> None:
        """Ask the route for a path, and begin to follow it."""
        self._planned_at = time
        path = self._route.path(pose, time, undriven)
        if path is None:
            self.state = "finished" if self._route.ends else "waiting"
            return
        if self.state == "waiting":
            self._mark, self._moved_at = 0.0, time
        self.state, self._path = "driving", path
        self._pursuit = Pursuit(path.points, path.speed, self.config.pursuit)


SPEED_SHARE, TURN_SHARE, ACCELERATION_SHARE = 0.8, 0.6, 0.2
"""Of the robot's largest; the rest is left to its own control."""


def driver_config(robot: Robot) -> DriverConfig:
    """Return the driver's usual speeds, less where the robot is slower, and patience to match."""
    usual, driver = PursuitConfig(), DriverConfig()
    pursuit = PursuitConfig(
        speed=min(usual.speed, SPEED_SHARE * robot.max_speed),
        turn_rate=min(usual.turn_rate, TURN_SHARE * robot.max_turn_rate),
        acceleration=min(usual.acceleration, ACCELERATION_SHARE * robot.max_acceleration),
    )
    slower = usual.speed / pursuit.speed
    return DriverConfig(
        pursuit=pursuit,
        patience=driver.patience * slower,
        back_off=driver.back_off * slower,
        back_speed=driver.back_speed / slower,
    )
