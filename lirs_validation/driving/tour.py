"""The tour: an endless drive over the free ground, planned beforehand and followed by the true pose."""

from __future__ import annotations

import math

import numpy as np

from lirs_validation.driving.driver import Frame
from lirs_validation.driving.path_driver import DriverConfig, Path, PathDriver
from lirs_validation.driving.planning.coverage_planner import CoveragePlanner
from lirs_validation.driving.pursuit import speed_profile
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.geometry.pose import Pose2


class TourRoute:
    """Tours that cover free ground for a time.

    Args:
        planner: plans tours from any pose.
        seconds: how long they must last.
        config: how they are driven.
        surface: the ground, for slower driving where it is steep.
    """

    frame: Frame = "world"
    refresh = math.inf
    ends = "the tour is over"

    def __init__(
        self, planner: CoveragePlanner, seconds: float, config: DriverConfig, surface: HeightField | None
    ) -> None:
        self.planner = planner
        self._seconds, self._config, self._surface = seconds, config, surface

    def path(self, pose: Pose2, time: float, undriven: float | None) -> Path:
        """Plan what the rest of the time can need at full speed."""
        if undriven is not None:
            self.planner.forget(undriven)
        # Smoothing shortens the tour, and planning again in the middle of a run would cost a tick.
        length = 10.0 + 1.3 * max(0.0, self._seconds - time) * self._config.pursuit.speed
        # From rest straight ahead: turning wheels slip most while a mapper knows least.
        straight = self.planner.config.straight if time == 0.0 else 0.0
        points = self.planner.tour(pose, length, straight=straight)
        height = None if self._surface is None else ground_height(self._surface, points)
        return Path(points, speed_profile(points, self.planner.room_at(points), self._config.pursuit, height))

    def avoid(self, point: tuple[float, float], radius: float) -> None:
        """Penalize the ground round a place: only the last resort leads there."""
        self.planner.avoid(point, radius)


class CoverageDriver(PathDriver):
    """Drives a planned tour (see `plan_coverage`)."""

    def __init__(self, route: TourRoute, start: Pose2, config: DriverConfig) -> None:
        super().__init__(route, start, config)
        self._planner = route.planner

    @property
    def coverage(self) -> float:
        """Share of the reachable ground that the planned tour passes."""
        return self._planner.coverage


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
        free: free cells = where the robot's center may be, world frame.
        start: pose where the robot is set down.
        seconds: how long it will drive.
        rng: chooses among goals.
        config: how to drive.
        surface: the ground, for slower driving where it is steep.

    Raises:
        ConfigError: no cell is free.
    """
    config = config or DriverConfig()
    planner = CoveragePlanner(free, start, rng)
    return CoverageDriver(TourRoute(planner, seconds, config, surface), start, config)


def ground_height(surface: HeightField, points: np.ndarray) -> np.ndarray:
    """Return (n,) meters of the ground at points (n, 2); 0 where there is none."""
    height: np.ndarray = np.nan_to_num(surface.height_at(points[:, 0], points[:, 1]))
    return height
