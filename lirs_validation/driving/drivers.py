"""Who drives in a validation run: it knows the true ground and the true pose; the mapper sees neither."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np

from lirs_envs.robots.command import Twist
from lirs_validation.driving.planning import CoveragePlanner, TourConfig
from lirs_validation.driving.pursuit import Pursuit, PursuitConfig, speed_profile
from lirs_wct.field_validators import require_above
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.geometry.pose import Pose2

DriverState = Literal["driving", "backing off", "stuck"]


class Driver(Protocol):
    """Anything that drives a robot from its true pose."""

    @property
    def stuck(self) -> bool:
        """Whether the driver gave up."""

    def command(self, T_world_base: Pose2, time: float) -> Twist:
        """Return the command for the next tick; `time` in seconds since the start."""


@dataclass(frozen=True, kw_only=True)
class DriverConfig:
    """How the coverage driver drives, and when it gives up.

    Attributes:
        tour: how goals are chosen.
        pursuit: how the path is followed.
        patience: seconds without progress before it backs off.
        step: metres along the path that count as progress.
        back_off: seconds that it drives backwards.
        back_speed: m/s while doing so.
        tries: how often in a row it backs off before it gives up.
        off_path: distance from the path at which it plans anew, metres.
        straight: metres that it drives straight ahead at the very beginning, where they are free.

    Raises:
        ConfigError: a value is not above 0.
    """

    tour: TourConfig = field(default_factory=TourConfig)
    pursuit: PursuitConfig = field(default_factory=PursuitConfig)
    patience: float = 8.0
    step: float = 0.3
    back_off: float = 2.5
    back_speed: float = 0.3
    tries: int = 4
    off_path: float = 1.0
    straight: float = 1.2

    def __post_init__(self) -> None:
        own = ("patience", "step", "back_off", "back_speed", "tries", "off_path", "straight")
        require_above(self, 0, *own, of="a driver")


class CoverageDriver:
    """Drives a planned tour; backs off, plans anew and at last gives up where it cannot move.

    Attributes:
        start: the pose where the tour begins.
        state: what it is doing.

    Args:
        planner: plans tours from any pose.
        start: the pose where the tour begins.
        seconds: how long the tour must last.
        config: how to drive.
        surface: the ground, for slower driving where it is steep.
    """

    def __init__(
        self,
        planner: CoveragePlanner,
        start: Pose2,
        seconds: float,
        config: DriverConfig | None = None,
        surface: HeightField | None = None,
    ) -> None:
        self.start = start
        self.state: DriverState = "driving"
        self.config = config or DriverConfig()
        self._planner, self._surface = planner, surface
        self._seconds = seconds
        self._back_until = 0.0
        self._failures = 0
        self._mark, self._moved_at = 0.0, 0.0
        self._v, self._commanded_at = 0.0, 0.0
        self._follow(start, 0.0)

    @property
    def stuck(self) -> bool:
        """Whether it gave up."""
        return self.state == "stuck"

    @property
    def coverage(self) -> float:
        """Share of the reachable ground that the planned tour passes."""
        return self._planner.coverage

    @property
    def path(self) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
        """(n, 2) points of the present tour, metres, world frame."""
        return self._points

    def command(self, T_world_base: Pose2, time: float) -> Twist:
        """Return the command for the next tick: wheels that start with a jerk would spin."""
        wanted = self._wanted(T_world_base, time)
        gain = self.config.pursuit.acceleration * max(0.0, time - self._commanded_at)
        self._v = min(wanted.v, max(0.0, self._v) + gain)
        self._commanded_at = time
        return Twist(self._v, wanted.omega)

    def _wanted(self, T_world_base: Pose2, time: float) -> Twist:
        if self.state == "stuck":
            return Twist(0.0, 0.0)
        if self.state == "backing off":
            if time < self._back_until:
                return self._backwards()
            self._replan(T_world_base, time)
        twist = self._pursuit.twist(T_world_base)
        if self._pursuit.distance > self.config.off_path or self._pursuit.remaining < self.config.step:
            self._replan(T_world_base, time)
            return self._pursuit.twist(T_world_base)
        if self._pursuit.progress >= self._mark + self.config.step:
            self._mark, self._moved_at = self._pursuit.progress, time
            self._failures = 0 if self._mark > 10 * self.config.step else self._failures
        elif time - self._moved_at > self.config.patience:
            return self._give_way(T_world_base, time)
        return twist

    def _give_way(self, pose: Pose2, time: float) -> Twist:
        """Back off, and keep away from what lies ahead; give up when that was tried often enough."""
        self._failures += 1
        if self._failures > self.config.tries:
            self.state = "stuck"
            return Twist(0.0, 0.0)
        self.state = "backing off"
        self._back_until = time + self.config.back_off
        ahead = pose @ Pose2(0.7, 0.0, 0.0)
        self._planner.avoid((ahead.x, ahead.y), 0.5)
        return self._backwards()

    def _backwards(self) -> Twist:
        """Reverse: straight the first time, then in turn to either side."""
        turn = (0.0, 0.5, -0.5)[(self._failures - 1) % 3]
        return Twist(-self.config.back_speed, turn)

    def _replan(self, pose: Pose2, time: float) -> None:
        self._planner.forget(self._pursuit.remaining)
        self._follow(pose, time)

    def _follow(self, pose: Pose2, time: float) -> None:
        """Plan what the rest of the time can need at full speed, and begin to follow it."""
        self.state = "driving"
        # Smoothing shortens the tour, and planning again in the middle of a run would cost a tick.
        length = 10.0 + 1.3 * max(0.0, self._seconds - time) * self.config.pursuit.speed
        # From rest straight ahead: turning wheels slip most while a mapper knows least.
        straight = self.config.straight if time == 0.0 else 0.0
        self._points = self._planner.tour(pose, length, straight=straight)
        room = self._planner.room_at(self._points)
        speed = speed_profile(self._points, room, self.config.pursuit, self._surface)
        self._pursuit = Pursuit(self._points, speed, self.config.pursuit)
        self._mark, self._moved_at = 0.0, time


def plan_coverage(
    free: OccupancyGrid,
    start: Pose2,
    *,
    seconds: float,
    rng: np.random.Generator,
    config: DriverConfig | None = None,
    surface: HeightField | None = None,
) -> CoverageDriver:
    """Return a driver whose tour covers the free ground, planned beforehand.

    Args:
        free: free cells = where the robot's centre may be, world frame.
        start: pose where the robot is set down.
        seconds: how long it will drive.
        rng: chooses among goals.
        config: how to drive.
        surface: the ground, for slower driving where it is steep.

    Raises:
        ConfigError: no cell is free.
    """
    config = config or DriverConfig()
    planner = CoveragePlanner(free, start, rng, config.tour)
    return CoverageDriver(planner, start, seconds, config, surface)
