"""Policies of the benchmark: baselines, drivers of validation runs, and the user's own.

The upper bound plans on the true map. To a goal it drives the shortest comfortable path. To map, it drives
to the place with the most unseen ground around it per path length: the next best view of Gonzalez-Banos and
Latombe ("Navigation strategies for exploring indoor environments", 2002), who estimate the unseen ground.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np

from lirs_envs.env import RobotEnv
from lirs_envs.policies import GoToGoal, Policy, PolicyContext, RandomActions, StraightAhead
from lirs_envs.pretrained import Pretrained
from lirs_envs.tasks.site import SEEN_CELL
from lirs_extensions.bench import UPPER_BOUND
from lirs_extensions.bench.tasks import TASKS, BenchTask
from lirs_validation.driving.choice import CLEARANCE, driver_config
from lirs_validation.driving.frontier_route import ExplorationMap, FrontierRoute
from lirs_validation.driving.path_driver import DriverConfig, Frame, PathDriver
from lirs_validation.driving.paths import Path as DrivenPath, Reach, penalize_behind, search
from lirs_validation.driving.routes import FreeGround, WaypointRoute
from lirs_validation.experiment.loading import check_members, make_own, own_class
from lirs_wct import (
    BoolArray,
    ConfigError,
    Float32Array,
    FloatArray,
    HeightField,
    IntArray,
    OccupancyGrid,
    Pose2,
    unknown_name,
)
from lirs_wct.formats.drive_files import RoutePoint
from slam_baselines.mapper import make_mapper

MAPPER = "hector"
"""SLAM method whose map the explorer plans on."""
MARGINS = (CLEARANCE, 0.1, 0.05, 0.0)
"""Clearances beyond the robot's radius, meters; a plan takes the largest with a path to the goal."""
VIEW = 4.0
"""Half side of the square in which unseen ground counts for a place, meters."""
DECAY = 0.15
"""Decay of a place's value with path length (lambda of the paper), 1/m."""
ARC = 1.0
"""Radius of the robot's turns in open space, meters."""
GOAL_ARC = 0.6
"""Radius in which the robot turns round where there is room, meters."""


class GoalRoute(FrontierRoute):
    """Route to a goal if the map shows a path, else to the best frontier.

    The best frontier has the shortest path to the goal through it.

    Beyond a frontier the way is taken for the straight line to the goal.

    Attributes:
        goal: x, y in the map frame, meters.
    """

    goal: tuple[float, float] = (0.0, 0.0)
    slack = math.inf

    def _ahead(self, chart: ExplorationMap, pose: Pose2) -> IntArray | None:
        """Return None: there is a goal to set off for."""
        return None

    def _to_frontier(self, chart: ExplorationMap, pose: Pose2, first: IntArray) -> IntArray | None:
        """Return the cells (n, 2) to the goal, else to the best frontier."""
        row, col = chart.grid.cells(self.goal).tolist()
        inside = 0 <= row < chart.known.shape[0] and 0 <= col < chart.known.shape[1]
        if inside and chart.room[row, col] > 0:
            local = pose.yaw - chart.grid.origin.yaw
            weight = penalize_behind(chart.weight, first, local, GOAL_ARC / chart.grid.resolution)
            reach = search(weight, first[None], chart.grid.resolution)
            if math.isfinite(reach.cost[row, col]):
                return reach.path((row, col))
        return super()._to_frontier(chart, pose, first)

    def _best(self, chart: ExplorationMap, reach: Reach, cells: IntArray, pose: Pose2) -> tuple[int, int]:
        """Return the cell of the frontier with the shortest way to the goal by it."""
        beyond = np.linalg.norm(chart.grid.centers(cells) - np.array(self.goal), axis=1)
        row, col = cells[int(np.argmin(reach.cost[cells[:, 0], cells[:, 1]] + beyond))].tolist()
        return row, col


class DrivenPolicy(ABC):
    """Policy that takes its actions from a driver; a flying robot keeps its height."""

    def __init__(self, env: RobotEnv, context: PolicyContext) -> None:
        self._env, self.context = env, context
        self._time = 0.0

    @abstractmethod
    def driver(self) -> PathDriver:
        """Return the driver of the episode that begins."""

    @abstractmethod
    def pose(self, observation: Mapping[str, Any]) -> Pose2:
        """Return the robot's pose in the driver's frame."""

    def reset(self, info: Mapping[str, Any]) -> None:
        """Begin an episode."""
        self._time, self._driver = 0.0, self.driver()

    def act(self, observation: Mapping[str, Any]) -> Float32Array:
        """Return the driver's command as an action."""
        twist = self._driver.command(self.pose(observation), self._time)
        self._time += self.context.period
        action = np.zeros(self.context.action_size, np.float32)
        action[0] = np.clip(twist.v / self.context.robot.max_speed, -1, 1)
        action[1] = np.clip(twist.omega / self.context.robot.max_turn_rate, -1, 1)
        return action


class Explorer(DrivenPolicy):
    """Frontier exploration, or drive to a goal, on a mapper's map by the mapper's pose."""

    def driver(self) -> PathDriver:
        """Return the explorer with a new mapper."""
        robot = self.context.robot
        self._mapper = make_mapper(MAPPER, seed=self.context.seed)
        self._pose, self._stamp = Pose2(), -math.inf
        pace = driver_config(robot)
        kind = FrontierRoute if self._env.view.goal is None else GoalRoute
        self._route = kind(self._mapper.map, robot.radius, robot.radius + CLEARANCE, pace)
        return PathDriver(self._route, Pose2(), pace)

    def pose(self, observation: Mapping[str, Any]) -> Pose2:
        """Update the mapper with a new scan and return its pose."""
        reading = self._env.view.reading()
        if reading.scan.stamp > self._stamp:
            self._pose = self._mapper.update(reading.scan, reading.odometry, reading.imu)
            self._stamp = reading.scan.stamp
        if isinstance(self._route, GoalRoute):
            distance, bearing = (float(value) for value in observation["goal"])
            offset = distance * np.array((math.cos(bearing), math.sin(bearing)))
            x, y = self._pose.apply(offset).tolist()
            self._route.goal = x, y
        return self._pose


class OnTrueMap(DrivenPolicy):
    """Upper bound: drive on the true map by the true pose."""

    def pose(self, observation: Mapping[str, Any]) -> Pose2:
        """Return the true pose."""
        return self._env.view.T_world_base.to_pose2()

    def driver(self) -> PathDriver:
        """Return a driver to the goal, or to unseen ground."""
        view, pace = self._env.view, driver_config(self.context.robot)
        start, surface = view.T_world_base.to_pose2(), view.world.surface
        free = self._free(start, view.goal)
        if view.goal is not None:
            return PathDriver(WaypointRoute((RoutePoint(*view.goal),), free, pace, surface), start, pace)
        return PathDriver(UnseenRoute(free, start, self._unseen, pace, surface), start, pace)

    def _free(self, start: Pose2, goal: tuple[float, float] | None) -> OccupancyGrid:
        """Return the free grid of the largest margin that connects start and goal."""
        robot, world = self.context.robot, self._env.view.world
        for margin in MARGINS:
            free = world.traversable(clearance=robot.radius + margin, max_slope=robot.max_slope)
            ends = free.cells([(start.x, start.y), *([goal] if goal else [])])
            _, areas = cv2.connectedComponents(free.free.astype(np.uint8), connectivity=4)
            held = np.clip(ends, 0, np.array(free.shape) - 1)
            found = set(areas[held[:, 0], held[:, 1]].tolist())
            if len(found) == 1 and found != {0}:
                break
        return free

    def _unseen(self) -> FloatArray:
        """Return the (n, 2) centers of reachable unseen cells."""
        seen, (frame, wanted) = self._env.episodes.stage.seen, self._env.episodes.task.ground(0)
        assert seen is not None, "the mapping task has it"
        cells = np.argwhere(wanted & ~seen.seen(0))
        middles: FloatArray = np.array(frame.corner) + (cells[:, ::-1] + 0.5) * SEEN_CELL
        return middles


class UnseenRoute:
    """Next-best-view route: most unseen area per meter of path.

    `unseen` returns (n, 2) centers of unseen cells, meters.
    """

    frame: Frame = "world"
    refresh = 1.0
    ends = ""

    def __init__(
        self,
        free: OccupancyGrid,
        start: Pose2,
        unseen: Callable[[], FloatArray],
        config: DriverConfig,
        surface: HeightField,
    ) -> None:
        self._unseen, self._config = unseen, config
        self._ground = FreeGround(free, start, surface)
        self.avoid = self._ground.avoid
        self._tried = np.zeros_like(self._ground.free)
        self._goal: tuple[int, int] | None = None

    def path(self, pose: Pose2, time: float, undriven: float | None) -> DrivenPath | None:
        """Return the path to the best place; None without reachable unseen ground."""
        ground, grid = self._ground, self._ground.grid
        resolution = grid.resolution
        first = ground.nearest(pose.x, pose.y)
        unseen = np.zeros(ground.free.shape, np.bool_)
        row, col = np.clip(grid.cells(self._unseen()), 0, np.array(unseen.shape) - 1).T
        unseen[row, col] = True
        weight = penalize_behind(ground.weight, first, pose.yaw - grid.origin.yaw, ARC / resolution)
        reach = search(weight, first[None], resolution)
        # A cell that is not seen from close by cannot be seen at all.
        self._tried |= unseen & (reach.cost <= 2 * self._config.step)
        possible = unseen & ground.free & ~self._tried & np.isfinite(reach.cost)
        if not possible.any():
            return None
        if self._goal is None or not possible[self._goal]:
            worth = np.where(possible, _around(unseen, resolution) * np.exp(-DECAY * reach.cost), 0.0)
            self._goal = divmod(int(np.argmax(worth)), worth.shape[1])
        pursuit = self._config.pursuit
        points = ground.smooth(grid.centers(reach.path(self._goal)), pursuit.careful_room)
        return ground.path(points, pursuit)


def _around(unseen: BoolArray, resolution: float) -> FloatArray:
    """Return (rows, cols) the share of unseen cells in the square view around each cell."""
    across = 2 * math.ceil(VIEW / resolution) + 1
    kernel = (across, across)
    share = cv2.boxFilter(unseen.astype(np.float32), -1, kernel, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(share, dtype=np.float64)


class Baseline(NamedTuple):
    """A policy of this package; where `observe` is None, it gets the task's own observations."""

    make: Callable[[RobotEnv, PolicyContext], Policy]
    tasks: tuple[str, ...] = tuple(TASKS)
    observe: tuple[str, ...] | None = None


BASELINES: Mapping[str, Baseline] = {
    "random": Baseline(lambda env, context: RandomActions(context), observe=("attitude",)),
    "straight": Baseline(lambda env, context: StraightAhead(context), observe=("attitude",)),
    "go_to_goal": Baseline(
        lambda env, context: GoToGoal(context), ("navigation", "traverse"), ("scan", "goal")
    ),
    "pretrained": Baseline(lambda env, context: Pretrained(context), ("navigation",), Pretrained.observe),
    "frontier": Baseline(Explorer, ("navigation", "mapping")),
    UPPER_BOUND: Baseline(OnTrueMap),
}
"""Policies of this package by name."""
DEFAULTS: Mapping[str, Sequence[str]] = {
    "navigation": ("pretrained", "go_to_goal", UPPER_BOUND),
    "mapping": ("frontier", "straight", UPPER_BOUND),
    "traverse": ("go_to_goal", "straight", UPPER_BOUND),
}
"""Policies of a command that names none, by task."""


@dataclass(frozen=True)
class PolicyChoice:
    """A policy as a user names it: a key of `BASELINES`, or `module:name` with keywords as text."""

    name: str
    arguments: tuple[tuple[str, str], ...] = ()

    @property
    def label(self) -> str:
        """The name and the arguments, as tables show them."""
        given = ",".join(f"{key}={value}" for key, value in self.arguments)
        return f"{self.name}({given})" if given else self.name

    @property
    def observe(self) -> tuple[str, ...] | None:
        """Groups of observations that the policy requires; None = the task's own."""
        if self.name in BASELINES:
            return BASELINES[self.name].observe
        names = getattr(self._maker(), "observe", None)
        if names is None:
            return None
        if isinstance(names, str) or not all(isinstance(name, str) for name in names):
            raise ConfigError(f"policy {self.name!r}: observe must be a list of groups, got {names!r}")
        return tuple(names)

    def check(self, task: str) -> None:
        """Check that the policy exists and fits the task."""
        if self.name not in BASELINES:
            self._maker()
            return
        if task not in BASELINES[self.name].tasks:
            legal = [name for name, baseline in BASELINES.items() if task in baseline.tasks]
            raise ConfigError(
                f"the policy {self.name} is for other tasks than {task}; legal: {', '.join(legal)}"
            )
        if self.arguments:
            raise ConfigError(f"the policy {self.name} takes no arguments, got {self.label}")

    def make(self, env: RobotEnv, task: BenchTask) -> Policy:
        """Make the policy for an episode of a task.

        A user's class gets the keywords that its signature names: `context` (see `PolicyContext`),
        `observation_space`, `action_space`, `seed`, and its arguments.
        """
        context = PolicyContext.of(env.episodes.config, task.seed)
        if self.name in BASELINES:
            return BASELINES[self.name].make(env, context)
        offered = {
            "context": context,
            "observation_space": env.observation_space,
            "action_space": env.action_space,
            "seed": task.seed,
        }
        policy: Policy = make_own(self.name, "policy", "act", offered, dict(self.arguments))
        check_members(policy, self.name, "policy", ("reset", "act"))
        return policy

    def _maker(self) -> Callable[..., Any]:
        if ":" not in self.name:
            raise unknown_name("policy", self.name, [*BASELINES, "module:name of your own"])
        return own_class(self.name, "policy", "act")
