"""The driver that a config names, set down in its world."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np

from lirs_envs.robots.robot import Robot
from lirs_validation.config import MANUAL, RunConfig, driver_parts
from lirs_validation.driving.coverage import plan_coverage
from lirs_validation.driving.driver import Driver
from lirs_validation.driving.frontier_route import FrontierRoute
from lirs_validation.driving.path_driver import PathDriver, driver_config
from lirs_validation.driving.replay import COMMANDS, read_replay, replay
from lirs_validation.driving.room import no_room
from lirs_validation.driving.waypoint_route import WaypointRoute, check_waypoints
from lirs_wct.errors import ConfigError
from lirs_wct.formats.waypoints import read_waypoints
from lirs_wct.geometry import OccupancyGrid, Pose2
from lirs_wct.world import World

MARGIN = 0.15
"""Meters that a plan keeps beyond the robot's radius."""
PLAN_STREAM = 2
"""Which of the seed's random streams the tour is drawn from; the simulation has others."""


def make_driver(
    world: World, robot: Robot, config: RunConfig, mapper_map: Callable[[], OccupancyGrid]
) -> Driver:
    """Return the config's driver.

    Tour and waypoints are planned over the true ground; the mapper sees none of it. The explorer is given the
    mapper's map, and nothing of the world but where the robot is set down.

    Args:
        world: where it drives.
        robot: that is driven.
        config: driver, seed and seconds.
        mapper_map: returns the mapper's present map, map frame.

    Raises:
        ConfigError: the robot fits nowhere in this world, or a replay is of another world, robot or lidar.
        SourceError: waypoints or recorded commands cannot be used.
    """
    kind, path = _automatic(config)
    if kind == "replay":
        return replay(Path(path), config, world.name)
    free = world.traversable(clearance=robot.radius + MARGIN, max_slope=robot.max_slope)
    pace = driver_config(robot)
    if kind == "waypoints":
        waypoints = read_waypoints(Path(path))
        check_waypoints(Path(path), waypoints, free, robot.name, lambda place: _cause(world, robot, place)[0])
        first, second = waypoints[:2]
        ahead = math.atan2(second.y - first.y, second.x - first.x)
        start = Pose2(first.x, first.y, ahead if first.yaw is None else first.yaw)
        return PathDriver(WaypointRoute(waypoints[1:], free, pace, world.surface), start, pace)
    start = _start(world, free, robot, config)
    if kind == "frontier":
        route = FrontierRoute(mapper_map, robot.radius, robot.radius + MARGIN, pace)
        return PathDriver(route, start, pace)
    rng = np.random.default_rng((config.seed, PLAN_STREAM))
    return plan_coverage(free, start, seconds=config.seconds, rng=rng, config=pace, surface=world.surface)


def check_driver(config: RunConfig) -> None:
    """Look at the file that a driver needs before the world is built.

    Raises:
        ConfigError: a replay is of another robot, or a person drove.
        SourceError: waypoints or recorded commands cannot be read.
    """
    kind, path = _automatic(config)
    if kind == "waypoints":
        read_waypoints(Path(path))
    if kind == "replay":
        read_replay(Path(path), config.robot)


def driver_files(config: RunConfig) -> list[Path]:
    """Return the files that a driver reads."""
    kind, path = driver_parts(config.driver)
    return {"waypoints": [Path(path)], "replay": [Path(path) / COMMANDS]}.get(kind, [])


def _automatic(config: RunConfig) -> tuple[str, str]:
    """Return kind and path of a driver that drives by itself.

    Raises:
        ConfigError: it is `manual`.
    """
    kind, path = driver_parts(config.driver)
    if kind == MANUAL:
        raise ConfigError("manual: a person drove in the live page; replay:RUN drives the same again")
    return kind, path


def _start(world: World, free: OccupancyGrid, robot: Robot, config: RunConfig) -> Pose2:
    """Return the requested start, or else the seed's spawn pose.

    Raises:
        ConfigError: the robot fits nowhere in this world, or cannot drive from the start that was asked for.
    """
    if world.start is not None:
        if not free.free_at(world.start.x, world.start.y):
            cause, nearest = _cause(world, robot, (world.start.x, world.start.y))
            if nearest is None:
                raise no_room(config.source, world, robot, MARGIN)
            raise ConfigError(
                f"{config.source}: {robot.name} cannot drive from {world.start.x:g},{world.start.y:g} "
                f"(--start): {cause}; nearest place: {nearest}"
            )
        return world.start
    starts = world.starts(free)
    if not starts:
        raise no_room(config.source, world, robot, MARGIN)
    return starts[(config.seed - 1) % len(starts)]


def _cause(world: World, robot: Robot, place: tuple[float, float]) -> tuple[str, str | None]:
    """Return why a place is unreachable, and the nearest reachable `x,y`."""
    return world.refusal(place, clearance=robot.radius + MARGIN, max_slope=robot.max_slope)
