"""Drivers, and the one that follows paths by pure pursuit, backs off, replans and finally gives up.

Pure pursuit: Coulter, CMU-RI-TR-92-01, 1992.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal, Protocol

from lirs_envs.robots.robot import Robot, Twist
from lirs_validation.driving.paths import SPACING, Path, PursuitConfig
from lirs_wct.errors import Checked, limited
from lirs_wct.geometry import FloatArray, LaserScan, Pose2

Frame = Literal["world", "map"]
"""Frame of a driver's poses: `T_world_base`, the truth, or `T_map_base`, the mapper's latest answer."""


class Driver(Protocol):
    """Anything that drives a robot, one command a scan."""

    @property
    def start(self) -> Pose2:
        """Start pose of the robot, world frame."""
        ...

    @property
    def frame(self) -> Frame:
        """Frame of the poses that `command` receives."""
        ...

    @property
    def stuck(self) -> bool:
        """Whether the driver gave up."""
        ...

    @property
    def finished(self) -> str:
        """Reason why nothing is left to drive; empty while there is."""
        ...

    def command(self, pose: Pose2, time: float, scan: LaserScan, odometry: Pose2) -> Twist:
        """Return the command for the next tick.

        Args:
            pose: Pose of the robot, in the driver's frame.
            time: Seconds since the start.
            scan: Latest scan.
            odometry: `T_odom_base` at the scan.
        """
        ...


class Pursuit:
    """Follows one path; remembers how far it got."""

    WINDOW = 1.5
    """Meters ahead in which the nearest point of the path is looked for: it never jumps a loop."""

    def __init__(self, path: Path, config: PursuitConfig) -> None:
        self.config = config
        self._x: list[float] = path.points[:, 0].tolist()
        self._y: list[float] = path.points[:, 1].tolist()
        self._speed: list[float] = path.speed.tolist()
        self._at = 0
        self._turning = False
        self.distance = 0.0
        """Meters between the robot and the path, at the last command."""

    @property
    def progress(self) -> float:
        """Meters of path behind the robot."""
        return self._at * SPACING

    @property
    def remaining(self) -> float:
        """Meters of path ahead of the robot."""
        return (len(self._x) - 1 - self._at) * SPACING

    def twist(self, pose: Pose2) -> Twist:
        """Return the command at a pose."""
        c = self.config
        self._advance(pose)
        planned = self._speed[self._at]
        target = self._target(pose, c.lookahead + c.lookahead_time * planned)
        dx, dy = self._x[target] - pose.x, self._y[target] - pose.y
        error = math.remainder(math.atan2(dy, dx) - pose.yaw, math.tau)
        # Once it turns in place it goes on until it nearly faces the target.
        self._turning = abs(error) > (0.2 if self._turning else c.turn_in_place)
        if self._turning:
            return Twist(0.0, max(-c.turn_rate, min(c.turn_rate, 2.0 * error)))
        bend = 2 * math.sin(error) / max(math.hypot(dx, dy), 0.5 * c.lookahead)
        v = planned * max(0.3, math.cos(error))
        if abs(v * bend) > c.turn_rate:
            v = c.turn_rate / abs(bend)
        return Twist(v, v * bend)

    def _advance(self, pose: Pose2) -> None:
        """Move on to the nearest point within the window."""
        last = min(len(self._x), self._at + int(self.WINDOW / SPACING) + 1)
        x, y, xs, ys = pose.x, pose.y, self._x, self._y
        best = math.inf
        for k in range(self._at, last):
            dx, dy = xs[k] - x, ys[k] - y
            d = dx * dx + dy * dy
            if d < best - 1e-12:
                best, self._at = d, k
        self.distance = math.sqrt(best)

    def _target(self, pose: Pose2, distance: float) -> int:
        """Return the first point ahead at a distance or more.

        It is at most twice as far along the path.
        """
        last = min(len(self._x) - 1, self._at + max(1, int(2 * distance / SPACING)))
        x, y, xs, ys = pose.x, pose.y, self._x, self._y
        for k in range(self._at, last):
            if math.hypot(xs[k] - x, ys[k] - y) >= distance:
                return k
        return last


DriverState = Literal["driving", "turning", "backing off", "waiting"]


@dataclass(frozen=True, kw_only=True)
class DriverConfig(Checked, of="a driver"):
    """Parameters of a path driver.

    Attributes:
        pursuit: Parameters of the path following.
        patience: Seconds without progress before it backs off.
        step: Meters along the path that count as progress; a path's end is reached within them.
        back_off: Seconds that it drives backwards.
        back_speed: Speed while backing off, m/s.
        tries: Times in a row that it backs off before it gives up.
        off_path: Distance from the path at which it replans, meters.
        facing: Heading error that is left after a turn to a wanted yaw, radians.
    """

    pursuit: PursuitConfig = field(default_factory=PursuitConfig)
    patience: float = limited(8.0, "(0, inf]")
    step: float = limited(0.3, "(0, inf]")
    back_off: float = limited(2.5, "(0, inf]")
    back_speed: float = limited(0.3, "(0, inf]")
    tries: int = limited(4, "(0, inf]")
    off_path: float = limited(1.0, "(0, inf]")
    facing: float = limited(math.radians(5), "(0, inf]")


class Route(Protocol):
    """Interface of a route: the source of a driver's paths.

    Attributes:
        frame: Frame of the poses and the paths.
        refresh: Seconds after which a valid path is planned again; inf = never.
        ends: Reason for the end of the drive once no path is left; empty = there may be one later.
    """

    frame: Frame
    refresh: float
    ends: str

    def path(self, pose: Pose2, time: float, undriven: float | None) -> Path | None:
        """Return the path from a pose; None if there is none.

        `ends` says whether there may be one later.

        Args:
            pose: Pose of the robot.
            time: Seconds since the start.
            undriven: Rest of the former path, meters; None = this is the first one.
        """
        ...

    def avoid(self, point: tuple[float, float], radius: float) -> None:
        """Avoid a place where the robot got stuck, meters in the driver's frame."""
        ...


class PathDriver:
    """Follower of the paths of a route (see `Driver`).

    Attributes:
        state: Present activity.
        config: Parameters.
    """

    def __init__(self, route: Route, start: Pose2, config: DriverConfig) -> None:
        self.start, self.frame = start, route.frame
        self.stuck, self.finished = False, ""
        self.state: DriverState = "waiting"
        self.config = config
        self._route = route
        self._back_until, self._failures = 0.0, 0
        self._mark, self._moved_at, self._planned_at = 0.0, 0.0, -math.inf
        self._v, self._commanded_at = 0.0, 0.0
        if self.frame == "world":  # a mapper has no map yet
            self._follow(start, 0.0, None)

    @property
    def path(self) -> FloatArray:
        """(n, 2) points of the present path, meters."""
        return self._path.points

    def command(self, pose: Pose2, time: float, *_: object) -> Twist:
        """Return the command for the next tick: wheels that start with a jerk would spin."""
        wanted = self._choose_command(pose, time)
        gain = self.config.pursuit.acceleration * max(0.0, time - self._commanded_at)
        self._v = min(wanted.v, max(0.0, self._v) + gain)
        self._commanded_at = time
        return Twist(self._v, wanted.omega)

    def _choose_command(self, pose: Pose2, time: float) -> Twist:
        if self.stuck or self.finished:
            return Twist()
        if self.state == "backing off":
            if time < self._back_until:
                return self._backwards()
            self._replan(pose, time)
        elif time - self._planned_at >= self._route.refresh:
            self._refresh(pose, time)
        if self.state == "waiting":
            self.stuck = not self.finished and time - self._moved_at > self.config.patience
            return Twist()
        if self.state == "turning":
            return self._turn(pose, time)
        return self._pursue(pose, time)

    def _pursue(self, pose: Pose2, time: float) -> Twist:
        """Follow the path; replan at its end or far from it; back off without progress."""
        twist = self._pursuit.twist(pose)
        if self._pursuit.distance > self.config.off_path or self._pursuit.remaining < self.config.step:
            if self._path.yaw is not None and self._pursuit.distance <= self.config.off_path:
                self.state, self._moved_at = "turning", time
                return self._turn(pose, time)
            self._replan(pose, time)
            return self._pursuit.twist(pose) if self.state == "driving" else Twist()
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
        error = math.remainder((self._path.yaw or 0.0) - pose.yaw, math.tau)
        if abs(error) <= self.config.facing or time - self._moved_at > self.config.patience:
            self._replan(pose, time)
            return Twist()
        limit = self.config.pursuit.turn_rate
        return Twist(0.0, max(-limit, min(limit, 2.0 * error)))

    def _give_way(self, pose: Pose2, time: float) -> Twist:
        """Back off and avoid the place ahead; give up after too many tries."""
        self._failures += 1
        if self._failures > self.config.tries:
            self.stuck = True
            return Twist()
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
            self.state, self.finished = "waiting", self._route.ends
            return
        if self.state == "waiting":
            self._mark, self._moved_at = 0.0, time
        self.state, self._path = "driving", path
        self._pursuit = Pursuit(path, self.config.pursuit)


SPEED_SHARE, TURN_SHARE, ACCELERATION_SHARE = 0.8, 0.6, 0.2
"""Shares of the robot's limits; the rest is left to its own control."""


def driver_config(robot: Robot) -> DriverConfig:
    """Return the driver's default speeds, less where the robot is slower, and patience to match."""
    default, driver = PursuitConfig(), DriverConfig()
    pursuit = PursuitConfig(
        speed=min(default.speed, SPEED_SHARE * robot.max_speed),
        turn_rate=min(default.turn_rate, TURN_SHARE * robot.max_turn_rate),
        acceleration=min(default.acceleration, ACCELERATION_SHARE * robot.max_acceleration),
    )
    slower = default.speed / pursuit.speed
    return DriverConfig(
        pursuit=pursuit,
        patience=driver.patience * slower,
        back_off=driver.back_off * slower,
        back_speed=driver.back_speed / slower,
    )
