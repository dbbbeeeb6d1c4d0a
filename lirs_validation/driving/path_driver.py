"""Driver that follows paths by pure pursuit, backs off, replans and finally gives up.

Pure pursuit: Coulter, CMU-RI-TR-92-01, 1992.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal, Protocol

from lirs_envs.robots.robot import Twist
from lirs_validation.driving.paths import SPACING, Path, PursuitConfig
from lirs_wct.errors import Checked, limited
from lirs_wct.geometry import FloatArray, Pose2

Frame = Literal["world", "map"]
"""Frame of a driver's poses: `T_world_base`, the truth, or `T_map_base`, the mapper's latest answer."""


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
        c, xs, ys = self.config, self._x, self._y
        # Move on to the nearest point within the window.
        best = math.inf
        for k in range(self._at, min(len(xs), self._at + int(self.WINDOW / SPACING) + 1)):
            dx, dy = xs[k] - pose.x, ys[k] - pose.y
            d = dx * dx + dy * dy
            if d < best - 1e-12:
                best, self._at = d, k
        self.distance = math.sqrt(best)
        planned = self._speed[self._at]
        # The target is the first point ahead at the lookahead or more, at most twice as far along the path.
        lookahead = c.lookahead + c.lookahead_time * planned
        target, last = self._at, min(len(xs) - 1, self._at + max(1, int(2 * lookahead / SPACING)))
        while target < last and math.hypot(xs[target] - pose.x, ys[target] - pose.y) < lookahead:
            target += 1
        dx, dy = xs[target] - pose.x, ys[target] - pose.y
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
        reversing: Share of each 20 s in which it follows its path backwards.
        facing: Heading error that is left after a turn to a wanted yaw, radians.
    """

    pursuit: PursuitConfig = field(default_factory=PursuitConfig)
    patience: float = limited(8.0, "(0, inf]")
    step: float = limited(0.3, "(0, inf]")
    back_off: float = limited(2.5, "(0, inf]")
    back_speed: float = limited(0.3, "(0, inf]")
    tries: int = limited(4, "(0, inf]")
    off_path: float = limited(1.0, "(0, inf]")
    reversing: float = limited(0.0, "[0, 1]")
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
        """Return the path from the robot's pose; None if there is none now.

        The time is that since the start; `undriven`, meters, the rest of the former path, None without one.
        """

    def avoid(self, point: tuple[float, float], radius: float) -> None:
        """Avoid a place where the robot got stuck, meters in the driver's frame."""


CYCLE = 20.0
"""Seconds of one turn of forward and backward driving."""
BACK = Pose2(0.0, 0.0, math.pi)


class PathDriver:
    """Follower of the paths of a route (see `Driver`)."""

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
        backwards = time % CYCLE >= (1.0 - self.config.reversing) * CYCLE
        wanted = self._choose_command(pose @ BACK if backwards else pose, time)
        gain = self.config.pursuit.acceleration * max(0.0, time - self._commanded_at)
        self._v = min(wanted.v, max(0.0, self._v) + gain)
        self._commanded_at = time
        return Twist(-self._v if backwards else self._v, wanted.omega)

    def _choose_command(self, pose: Pose2, time: float) -> Twist:
        if self.stuck or self.finished:
            return Twist()
        if self.state == "backing off":
            if time < self._back_until:
                return self._backwards()
            self._replan(pose, time)
        elif time - self._planned_at >= self._route.refresh:
            waits = self.state == "waiting"
            undriven, driven = (None, 0.0) if waits else (self._pursuit.remaining, self._pursuit.progress)
            self._follow(pose, time, undriven)
            # Progress counts on, so that a standing robot is noticed.
            self._mark -= driven
        if self.state == "waiting":
            self.stuck = not self.finished and time - self._moved_at > self.config.patience
            return Twist()
        if self.state == "turning":
            return self._turn(pose, time)
        return self._pursue(pose, time)

    def _pursue(self, pose: Pose2, time: float) -> Twist:
        """Follow the path; replan at its end or far from it; back off without progress."""
        config, pursuit = self.config, self._pursuit
        twist = pursuit.twist(pose)
        astray = pursuit.distance > config.off_path
        if astray or pursuit.remaining < config.step:
            if self._path.yaw is not None and not astray:
                self.state, self._moved_at = "turning", time
                return self._turn(pose, time)
            self._replan(pose, time)
            return self._pursuit.twist(pose) if self.state == "driving" else Twist()
        if pursuit.progress >= self._mark + config.step:
            self._mark, self._moved_at = pursuit.progress, time
            self._failures = 0 if self._mark > 10 * config.step else self._failures
        elif time - self._moved_at > config.patience:
            return self._give_way(pose, time)
        return twist

    def _turn(self, pose: Pose2, time: float) -> Twist:
        """Turn in place to the yaw at the path's end as far as possible."""
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
