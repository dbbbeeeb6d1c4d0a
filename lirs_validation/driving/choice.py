"""The driver that a config names, set down in its world."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from lirs_envs.lidar.presets import make_lidar_preset
from lirs_envs.placement import can_stand
from lirs_envs.policies import PolicyContext
from lirs_envs.pretrained import Pretrained
from lirs_envs.robots.robot import ROBOTS, Robot
from lirs_validation.config import CLIENT, MANUAL, PRETRAINED, TOUR, RunConfig, driver_parts
from lirs_validation.driving.coverage import TourRoute
from lirs_validation.driving.driver import Driver, ReversingDriver
from lirs_validation.driving.frontier_route import FrontierRoute
from lirs_validation.driving.path_driver import DriverConfig, PathDriver, driver_config
from lirs_validation.driving.paths import area_round
from lirs_validation.driving.policy_driver import PolicyDriver
from lirs_validation.driving.replay import COMMANDS, read_replay, replay
from lirs_validation.driving.waypoint_route import WaypointRoute, check_waypoints
from lirs_wct import ConfigError, OccupancyGrid, Pose2, World
from lirs_wct.formats.waypoints import RoutePoint, read_waypoints
from lirs_wct.sources.source import read_point

MARGIN = 0.15
"""Meters that a plan keeps beyond the robot's radius."""
PLAN_STREAM = 2
"""Which of the seed's random streams the tour is drawn from; the simulation has others."""


def make_driver(
    world: World, robot: Robot, config: RunConfig, mapper_map: Callable[[], OccupancyGrid]
) -> Driver:
    """Return the config's driver.

    Tour and waypoints are planned over the true ground; the mapper sees none of it. The explorer is given the
    mapper's map, and nothing of the world but where the robot is set down. The policy that ships is given
    scans, odometry, and the direction to its goal.

    Raises:
        ConfigError: the robot fits nowhere in this world, or a replay is of another world, robot or lidar.
        SourceError: waypoints or recorded commands cannot be used.
    """
    kind, argument = driver_parts(config.driver)
    if kind == "replay":
        return replay(Path(argument), config, world.name)
    if kind == PRETRAINED:
        return _policy_driver(world, robot, config, argument)
    driver = _path_driver(world, robot, config, mapper_map)
    return ReversingDriver(driver, config.reversing) if config.reversing else driver


def _path_driver(
    world: World, robot: Robot, config: RunConfig, mapper_map: Callable[[], OccupancyGrid]
) -> PathDriver:
    """Return the config's driver along paths, always forwards."""
    kind, path = _automatic(config)
    if kind == TOUR:
        return plan_tour(world, robot, config)
    free, pace = _drivable(world, robot), _pace(robot, config)
    waypoints: tuple[RoutePoint, ...] = ()
    if kind == "waypoints":
        waypoints = read_waypoints(Path(path))
        first, second = waypoints[:2]
        ahead = math.atan2(second.y - first.y, second.x - first.x)
        start = Pose2(first.x, first.y, ahead if first.yaw is None else first.yaw)
    else:
        start = _start(world, free, robot, config)
    if kind == "goal":
        waypoints = RoutePoint(start.x, start.y), _goal(config.driver)
    if waypoints:
        named = Path(path if kind == "waypoints" else config.driver)
        _check_reachable(named, waypoints, free, world, robot)
        return PathDriver(WaypointRoute(waypoints[1:], free, pace, world.surface), start, pace)
    route = FrontierRoute(mapper_map, robot.radius, robot.radius + MARGIN, pace)
    return PathDriver(route, start, pace)


def _policy_driver(world: World, robot: Robot, config: RunConfig, goal: str) -> PolicyDriver:
    """Return the driver of the policy that ships, to a goal or to seeded places one after the other."""
    free = _drivable(world, robot)
    start = _start(world, free, robot, config)
    lidar = make_lidar_preset(config.lidar or robot.lidar)
    policy = Pretrained(PolicyContext(robot=robot, lidar=lidar, period=lidar.period, seed=config.seed))
    if goal:
        place = _goal(config.driver)
        _check_reachable(Path(config.driver), (RoutePoint(start.x, start.y), place), free, world, robot)
        goals = np.array([(place.x, place.y)])
    else:
        rng = np.random.default_rng((config.seed, PLAN_STREAM))
        goals = rng.permutation(free.centers(np.argwhere(area_round(free, start))))
    return PolicyDriver(policy, robot, start, goals, (config.speed, config.turn_rate))


def _check_reachable(
    named: Path, waypoints: tuple[RoutePoint, ...], free: OccupancyGrid, world: World, robot: Robot
) -> None:
    check_waypoints(named, waypoints, free, robot.name, lambda place: _cause(world, robot, place)[0])


def plan_tour(world: World, robot: Robot, config: RunConfig) -> PathDriver:
    """Return the driver of the seed's tour over the drivable ground.

    Raises:
        ConfigError: the robot fits nowhere in this world.
    """
    free, pace = _drivable(world, robot), _pace(robot, config)
    start = _start(world, free, robot, config)
    rng = np.random.default_rng((config.seed, PLAN_STREAM))
    return PathDriver(TourRoute(free, start, rng, config.seconds, pace, world.surface), start, pace)


def start_pose(world: World, robot: Robot, config: RunConfig) -> Pose2:
    """Return the requested start, or else the seed's spawn pose, world frame.

    Raises:
        ConfigError: the robot fits nowhere in this world, or cannot drive from the requested start.
    """
    return _start(world, _drivable(world, robot), robot, config)


def _pace(robot: Robot, config: RunConfig) -> DriverConfig:
    """Return the driver's speeds for a robot, with the factors of the config."""
    usual = driver_config(robot)
    pursuit = replace(
        usual.pursuit,
        speed=config.speed * usual.pursuit.speed,
        turn_rate=config.turn_rate * usual.pursuit.turn_rate,
    )
    return replace(usual, pursuit=pursuit, patience=usual.patience / min(config.speed, config.turn_rate, 1.0))


def _drivable(world: World, robot: Robot) -> OccupancyGrid:
    """Return the grid whose free cells a plan may use."""
    return world.traversable(clearance=robot.radius + MARGIN, max_slope=robot.max_slope)


def check_driver(config: RunConfig) -> None:
    """Look at the file that a driver needs before the world is built.

    Raises:
        ConfigError: a replay is of another robot, a person drove, a goal is no place, or a policy would drive
            backwards.
        SourceError: waypoints or recorded commands cannot be read.
    """
    kind, path = _automatic(config)
    if kind == "goal" or (kind == PRETRAINED and path):
        _goal(config.driver)
    if kind == PRETRAINED and config.reversing:
        raise ConfigError(f"driver {PRETRAINED}: reversing must be 0, got {config.reversing:g}")
    if kind == "waypoints":
        read_waypoints(Path(path))
    if kind == "replay":
        read_replay(Path(path), config.robot)


def driver_files(config: RunConfig) -> list[Path]:
    """Return the files that a driver reads."""
    kind, path = driver_parts(config.driver)
    return {"waypoints": [Path(path)], "replay": [Path(path) / COMMANDS]}.get(kind, [])


def _automatic(config: RunConfig) -> tuple[str, str]:
    """Return kind and path of a driver that drives by itself."""
    kind, path = driver_parts(config.driver)
    if kind in (MANUAL, CLIENT):
        raise ConfigError(f"driver {kind}: a person or client drove; replay:RUN drives the same again")
    return kind, path


def _goal(driver: str) -> RoutePoint:
    """Return the goal of a driver such as `goal:X,Y`."""
    kind, text = driver_parts(driver)
    x, y = read_point(text, f"driver {kind}:X,Y")
    if not (math.isfinite(x) and math.isfinite(y)):
        raise ConfigError(f"driver must be {kind}:X,Y in finite meters, got {text!r}")
    return RoutePoint(x, y)


def _start(world: World, free: OccupancyGrid, robot: Robot, config: RunConfig) -> Pose2:
    """Return the requested start, or else the seed's spawn pose."""
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
    starts = [start for start in world.starts(free) if can_stand(world, robot, start)]
    if not starts:
        raise no_room(config.source, world, robot, MARGIN)
    return starts[(config.seed - 1) % len(starts)]


def _cause(world: World, robot: Robot, place: tuple[float, float]) -> tuple[str, str | None]:
    """Return why a place is unreachable, and the nearest reachable `x,y`."""
    return world.refusal(place, clearance=robot.radius + MARGIN, max_slope=robot.max_slope)


CELLS = 500
"""Cells along the longer side, at most, of the grid on which room is looked for."""


def no_room(source: str, world: World, robot: Robot, margin: float) -> ConfigError:
    """Return the error for a world without space for a robot, with robots that fit."""
    needed = (
        f"{source}: no place for {robot.name}: it needs {2 * (robot.radius + margin):.1f} m of free "
        f"ground no steeper than {math.degrees(robot.max_slope):.0f} deg"
    )
    others = [name for name, other in ROBOTS.items() if _fits(world, other, margin)]
    hint = f"{', '.join(others)} would fit" if others else "no other robot fits"
    return ConfigError(f"{needed}; {hint}")


def _fits(world: World, robot: Robot, margin: float) -> bool:
    resolution = max(0.1, max(world.surface.size) / CELLS)
    free = world.traversable(
        clearance=robot.radius + margin, max_slope=robot.max_slope, resolution=resolution
    )
    return bool(world.driven(free).free.any())
