"""The driver that a config names, set down in its world; replay, policy."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np

from lirs_envs.episodes.observations import make_finite
from lirs_envs.lidar.presets import make_lidar_preset
from lirs_envs.policies import Policy, PolicyContext
from lirs_envs.pretrained import Pretrained
from lirs_envs.robots.robot import ROBOTS, Robot, Twist, clip, make_robot
from lirs_envs.simulation_config import can_stand
from lirs_validation.config import CLIENT, MANUAL, PRETRAINED, TOUR, RunConfig, driver_parts
from lirs_validation.driving.frontier_route import FrontierRoute
from lirs_validation.driving.path_driver import DriverConfig, Frame, PathDriver
from lirs_validation.driving.paths import PursuitConfig, area_round
from lirs_validation.driving.routes import TourRoute, WaypointRoute, check_waypoints
from lirs_validation.record.run_record import read_record
from lirs_wct import ConfigError, FloatArray, LaserScan, OccupancyGrid, Pose2, SourceError, World
from lirs_wct.formats.drive_files import Commands, RoutePoint, read_commands, read_waypoints
from lirs_wct.sources.source import read_point

CLEARANCE = 0.15
"""Meters that a plan keeps beyond the robot's radius."""
PLAN_STREAM = 2
"""Random stream of the seed for the tour; the simulation has others."""
COMMANDS = "commands.csv"
"""File of the driver's commands in a run's folder."""


def make_driver(
    world: World, robot: Robot, config: RunConfig, mapper_map: Callable[[], OccupancyGrid]
) -> PathDriver | ReplayDriver | PolicyDriver:
    """Return the config's driver.

    Tour and waypoints are planned over the true ground; the mapper sees none of it. The explorer is given the
    mapper's map, and nothing of the world but where the robot is set down. The policy that ships is given
    scans, odometry, and the direction to its goal.
    """
    kind, argument = _automatic(config)
    if kind == "replay":
        return replay(Path(argument), config, world.name)
    if kind == PRETRAINED:
        return _policy_driver(world, robot, config, argument)
    if kind == TOUR:
        return plan_tour(world, robot, config)
    if kind in ("waypoints", "goal"):
        return _waypoint_driver(world, robot, config)
    pace, start = _pace(robot, config), start_pose(world, robot, config)
    route = FrontierRoute(mapper_map, robot.radius, robot.radius + CLEARANCE, pace)
    return PathDriver(route, start, pace)


def plan_tour(world: World, robot: Robot, config: RunConfig) -> PathDriver:
    """Return the driver of the seed's tour over the drivable ground."""
    free, pace = drivable_ground(world, robot), _pace(robot, config)
    start = start_pose(world, robot, config, free)
    rng = np.random.default_rng((config.seed, PLAN_STREAM))
    return PathDriver(TourRoute(free, start, rng, config.seconds, pace, world.surface), start, pace)


def _waypoint_driver(world: World, robot: Robot, config: RunConfig) -> PathDriver:
    """Return the driver through the waypoints of a file, or to a goal."""
    kind, argument = driver_parts(config.driver)
    free, pace = drivable_ground(world, robot), _pace(robot, config)
    if kind == "waypoints":
        named, waypoints = Path(argument), read_waypoints(Path(argument))
        first, second = waypoints[:2]
        ahead = math.atan2(second.y - first.y, second.x - first.x)
        start = Pose2(first.x, first.y, ahead if first.yaw is None else first.yaw)
    else:
        start = start_pose(world, robot, config, free)
        named, waypoints = Path(config.driver), (RoutePoint(start.x, start.y), _goal(config.driver))
    _check_reachable(named, waypoints, free, world, robot)
    return PathDriver(WaypointRoute(waypoints[1:], free, pace, world.surface), start, pace)


def _policy_driver(world: World, robot: Robot, config: RunConfig, goal: str) -> PolicyDriver:
    """Return the driver of the policy that ships, to a goal or to seeded places."""
    free = drivable_ground(world, robot)
    start = start_pose(world, robot, config, free)
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


def check_driver(config: RunConfig) -> None:
    """Look at the file that a driver needs before the world is built."""
    kind, argument = _automatic(config)
    if kind == "goal" or (kind == PRETRAINED and argument):
        _goal(config.driver)
    if kind == PRETRAINED and config.reversing:
        raise ConfigError(f"driver {PRETRAINED}: reversing must be 0, got {config.reversing:g}")
    if kind == "waypoints":
        read_waypoints(Path(argument))
    if kind == "replay":
        _read_replay(Path(argument), config.robot)


def driver_files(config: RunConfig) -> list[Path]:
    """Return the files that a driver reads."""
    kind, path = driver_parts(config.driver)
    return {"waypoints": [Path(path)], "replay": [Path(path) / COMMANDS]}.get(kind, [])


def start_pose(world: World, robot: Robot, config: RunConfig, free: OccupancyGrid | None = None) -> Pose2:
    """Return the requested start, or else the seed's spawn pose, world frame."""
    free = drivable_ground(world, robot) if free is None else free
    if world.start is None:
        starts = [start for start in world.starts(free) if can_stand(world, robot, start)]
        if not starts:
            raise no_room(config.source, world, robot, CLEARANCE)
        return starts[(config.seed - 1) % len(starts)]
    x, y = world.start.x, world.start.y
    if not free.free_at(x, y):
        cause, nearest = _refusal(world, robot, (x, y))
        if nearest is None:
            raise no_room(config.source, world, robot, CLEARANCE)
        raise ConfigError(
            f"{config.source}: {robot.name} cannot drive from {x:g},{y:g} (--start): {cause}; "
            f"nearest place: {nearest}"
        )
    return world.start


def drivable_ground(world: World, robot: Robot) -> OccupancyGrid:
    """Return the grid whose free cells a plan may use."""
    return world.traversable(clearance=robot.radius + CLEARANCE, max_slope=robot.max_slope)


SPEED_SHARE, TURN_SHARE, ACCELERATION_SHARE = 0.8, 0.6, 0.2
"""Shares of the robot's limits; the rest is left to its own control."""


def driver_config(
    robot: Robot, *, speed: float = 1.0, turn_rate: float = 1.0, reversing: float = 0.0
) -> DriverConfig:
    """Return a robot's speeds, times factors; less where it is slower, with patience to match."""
    default, driver = PursuitConfig(), DriverConfig()
    full_speed = min(default.speed, SPEED_SHARE * robot.max_speed)
    pursuit = PursuitConfig(
        speed=speed * full_speed,
        turn_rate=turn_rate * min(default.turn_rate, TURN_SHARE * robot.max_turn_rate),
        acceleration=min(default.acceleration, ACCELERATION_SHARE * robot.max_acceleration),
    )
    slower = default.speed / full_speed
    return DriverConfig(
        pursuit=pursuit,
        patience=driver.patience * slower / min(speed, turn_rate, 1.0),
        back_off=driver.back_off * slower,
        back_speed=driver.back_speed / slower,
        reversing=reversing,
    )


def _pace(robot: Robot, config: RunConfig) -> DriverConfig:
    return driver_config(robot, speed=config.speed, turn_rate=config.turn_rate, reversing=config.reversing)


def _check_reachable(
    named: Path, waypoints: tuple[RoutePoint, ...], free: OccupancyGrid, world: World, robot: Robot
) -> None:
    check_waypoints(named, waypoints, free, robot.name, lambda place: _refusal(world, robot, place)[0])


def _automatic(config: RunConfig) -> tuple[str, str]:
    """Return kind and argument of a driver that drives by itself."""
    kind, argument = driver_parts(config.driver)
    if kind in (MANUAL, CLIENT):
        raise ConfigError(f"driver {kind}: a person or client drove; replay:RUN drives the same again")
    return kind, argument


def _goal(driver: str) -> RoutePoint:
    """Return the goal of a driver such as `goal:X,Y`."""
    kind, text = driver_parts(driver)
    x, y = read_point(text, f"driver {kind}:X,Y")
    if not (math.isfinite(x) and math.isfinite(y)):
        raise ConfigError(f"driver must be {kind}:X,Y in finite meters, got {text!r}")
    return RoutePoint(x, y)


def _refusal(world: World, robot: Robot, place: tuple[float, float]) -> tuple[str, str | None]:
    """Return the reason why a place is unreachable, and the nearest reachable `x,y`."""
    return world.refusal(place, clearance=robot.radius + CLEARANCE, max_slope=robot.max_slope)


MAX_CELLS = 500
"""Cells along the longer side of the grid on which room is looked for."""


def no_room(source: str, world: World, robot: Robot, clearance: float) -> ConfigError:
    """Return the error for a world without space for a robot, with robots that fit."""

    def fits(other: Robot) -> bool:
        reach, resolution = other.radius + clearance, max(0.1, max(world.surface.size) / MAX_CELLS)
        free = world.traversable(clearance=reach, max_slope=other.max_slope, resolution=resolution)
        return bool(world.driven(free).free.any())

    others = [name for name, other in ROBOTS.items() if fits(other)]
    hint = f"{', '.join(others)} would fit" if others else "no other robot fits"
    return ConfigError(
        f"{source}: no place for {robot.name}: it needs {2 * (robot.radius + clearance):.1f} m of free "
        f"ground no steeper than {math.degrees(robot.max_slope):.0f} deg; {hint}"
    )


class ReplayDriver:
    """Driver that repeats a run's commands, whatever comes of them (see `Driver`)."""

    frame: Frame = "world"
    stuck = False

    def __init__(self, commands: Commands, period: float, name: str) -> None:
        self.start, self.finished = commands.start, ""
        self._rows, self._period, self._name = commands.rows, period, name

    def command(self, pose: Pose2, time: float, *_: object) -> Twist:
        """Return the command that was given at this time; at rest after the last one."""
        tick = round(time / self._period)
        if tick + 1 >= len(self._rows):
            self.finished = f"the commands of {self._name} end"
        return Twist(*self._rows[tick, 1:].tolist()) if tick < len(self._rows) else Twist()


def replay(folder: Path, config: RunConfig, world: str) -> ReplayDriver:
    """Return the driver that repeats a run, for other mappers on the same path."""
    commands = _read_replay(folder, config.robot)
    named = str(read_record(folder)["world"]["name"])
    if named != world:
        raise ConfigError(f"{folder}: drives through {named!r}, this run is in {world!r}: the same is needed")
    period = make_lidar_preset(config.lidar or make_robot(config.robot).lidar).period
    stamps = commands.rows[:, 0]
    if len(stamps) and np.abs(stamps - period * np.arange(len(stamps))).max() > period / 4:
        apart = stamps[-1] / max(1, len(stamps) - 1)
        raise ConfigError(
            f"{folder}: commands are {apart:g} s apart, this run's lidar scans each {period:g} s: "
            "the same lidar is needed"
        )
    return ReplayDriver(commands, period, folder.name)


def _read_replay(folder: Path, robot: str) -> Commands:
    """Read the commands of a finished run of a robot."""
    recorded = read_record(folder)["config"]["robot"]
    if recorded != robot:
        raise ConfigError(f"{folder}: drives {recorded!r}, this run {robot!r}: the same robot is needed")
    path = folder / COMMANDS
    if not path.exists():
        raise SourceError(f"{path}: no such file: runs that came to nothing have none, nor have older ones")
    return read_commands(path)


REACHED = 0.5
"""Distance at which a goal counts as reached, meters."""
STEP, PATIENCE = 0.5, 30.0
"""The policy gives up after PATIENCE seconds within STEP meters of a place."""


class PolicyDriver:
    """Driver that lets a policy drive to goals one after the other (see `Driver`).

    As in the environments, the policy sees distance and bearing of the goal from the true pose.

    Args:
        policy: Policy that reads the observations `scan`, `goal` and `odometry`.
        goals: (n, 2) places in their order, world frame, meters; at least one.
        factors: Factors of the policy's speed and turn rate.
    """

    frame: Frame = "world"

    def __init__(
        self, policy: Policy, robot: Robot, start: Pose2, goals: FloatArray, factors: tuple[float, float]
    ) -> None:
        self.start, self.stuck, self.finished = start, False, ""
        self._policy, self._robot, self._factors = policy, robot, factors
        self._goals = goals.tolist()
        self._place, self._moved_at = start, 0.0
        policy.reset({})

    def command(self, pose: Pose2, time: float, scan: LaserScan, odometry: Pose2) -> Twist:
        """Return the policy's command; at rest after the last goal, and after it gave up."""
        if not self.finished and self._polar(pose)[0] < REACHED:
            self._goals.pop(0)
            self.finished = "" if self._goals else "the last goal is reached"
            self._policy.reset({})
        if math.hypot(pose.x - self._place.x, pose.y - self._place.y) > STEP:
            self._place, self._moved_at = pose, time
        self.stuck = not self.finished and time - self._moved_at > PATIENCE
        if self.finished or self.stuck:
            return Twist()
        ranges = scan.ranges[None].copy()
        make_finite(ranges, np.float32(scan.range_max))
        seen = {"scan": ranges[0], "goal": self._polar(pose), "odometry": odometry.as_array()}
        v, omega = (self._policy.act(seen)[:2] * self._factors).tolist()
        return Twist(clip(v, 1.0) * self._robot.max_speed, clip(omega, 1.0) * self._robot.max_turn_rate)

    def _polar(self, pose: Pose2) -> tuple[float, float]:
        """Return distance and bearing of the present goal."""
        x, y = self._goals[0]
        dx, dy = x - pose.x, y - pose.y
        return math.hypot(dx, dy), math.remainder(math.atan2(dy, dx) - pose.yaw, math.tau)
