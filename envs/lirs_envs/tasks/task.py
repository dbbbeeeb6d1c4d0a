"""Tasks of N robots: map the ground, reach a goal, cross rough ground."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from lirs_envs.generators.terrain import KINDS, GeneratedTerrain, generate
from lirs_envs.robots.robot import ROBOTS, Robot
from lirs_envs.simulation import Simulation
from lirs_envs.tasks.seen_ground import SeenGround
from lirs_envs.tasks.site import SEEN_CELL, SeenFrame, Site, draw_goal, seen_frame
from lirs_wct import BoolArray, ConfigError, FloatArray, IntArray, Pose2, SimulationError, require_known
from lirs_wct.errors import Checked, limited

DRAWS = 100
"""Number of draws of start and goal before a reset fails."""


@dataclass(frozen=True, kw_only=True)
class Rewards(Checked, of="the rewards"):
    """Weights of the rewards that all tasks share; costs are negative.

    Tipping over and leaving the world never cost less than a collision.

    Attributes:
        success: Reward at the goal.
        crossing: Reward of the whole distance to the goal in traverse; a part of it earns its share.
        collision: Reward at the collision that ends an episode of navigation.
        contact: Reward of a second in which the robot collides, in the other tasks; `collision` is the limit
            of an episode's sum.
        tipped: Reward at tipping over, or where the simulation diverges.
        left: Reward at leaving the world.
        effort: Reward of a second of full action.

    Raises:
        ConfigError: a weight has the wrong sign, or an accident costs less than a collision.
    """

    success: float = limited(10.0, "[0, inf)")
    crossing: float = limited(100.0, "[0, inf)")
    collision: float = limited(-5.0, "(-inf, 0]")
    contact: float = limited(-5.0, "(-inf, 0]")
    tipped: float = limited(-10.0, "(-inf, 0]")
    left: float = limited(-10.0, "(-inf, 0]")
    effort: float = limited(-0.1, "(-inf, 0]")

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("tipped", "left"):
            if getattr(self, name) > self.collision:
                raise ConfigError(
                    f"{name} of the rewards must be at most that of a collision, {self.collision:g}, "
                    f"got {getattr(self, name):g}"
                )


@dataclass
class Stage:
    """State on which tasks act: N robots, their site and seen ground, in rows.

    Attributes:
        site: Free ground in the initial world.
        seen: Ground that the robots have seen; None = not needed.
        difficulty: Difficulty of each robot's next episode, 0 to 1.
        randomize_start: Whether starts are drawn.
        randomize_terrain: Whether terrains are drawn.
        poses: (N, 4) x, y, z, yaw of base_link, meters and radians, up to date.
    """

    simulation: Simulation
    site: Site
    seen: SeenGround | None
    rewards: Rewards
    difficulty: FloatArray
    randomize_start: bool
    randomize_terrain: bool
    poses: FloatArray

    @property
    def count(self) -> int:
        """Number of robots, N."""
        return len(self.poses)

    def start(self, rng: np.random.Generator, options: Mapping[str, Any]) -> Pose2:
        """Return the start that the options ask for, or one drawn, or the world's first."""
        start = options.get("start")
        if start is not None:
            return start if isinstance(start, Pose2) else Pose2(*point(start, 3, "start"))
        spawn_poses = self.site.world.spawn_poses
        return self.site.draw_start(rng) if self.randomize_start or not spawn_poses else spawn_poses[0]


class Task(ABC):
    """A task for each of N robots; row i of every array is robot i's.

    Attributes:
        observe: Groups of observations where the user names none.
        time_limit: Seconds, where the user gives none.
        option_names: Names of the options of `reset(options=...)`.
        needs_seen: Whether the task reads the ground that the robots have seen (`stage.seen`).
        admits_flight: Whether a robot that flies may do the task.
        ends_at_contact: Whether a collision ends the episode; else each second of contact costs.
        goals: (N, 2) x, y of the goals, meters; None = there are none to observe.
    """

    observe: ClassVar[tuple[str, ...]]
    time_limit: ClassVar[float]
    option_names: ClassVar[tuple[str, ...]]
    needs_seen: ClassVar[bool] = False
    admits_flight: ClassVar[bool] = True
    ends_at_contact: ClassVar[bool] = False
    goals: FloatArray | None = None

    def __init__(self, stage: Stage) -> None:
        self.stage = stage

    @abstractmethod
    def draw(self, i: int, rng: np.random.Generator, options: Mapping[str, Any]) -> Pose2 | None:
        """Draw start, goal and terrain of robot `i`; return the start, or None to draw again.

        Raises:
            ConfigError: an option has a value that is not legal.
            SimulationError: the start or goal of the options cannot be reached.
        """

    def ground(self, i: int) -> tuple[SeenFrame, BoolArray]:
        """Return the ground that robot `i` may see, and which of its cells are wanted."""
        frame = self.stage.site.seen
        return frame, np.isfinite(frame.height)

    @abstractmethod
    def begin(self, i: int, poses: FloatArray) -> None:
        """Begin the episode that was drawn: robot `i` stands at its start.

        Poses (N, 4) are x, y, z, yaw of base_link, meters and radians.
        """

    @abstractmethod
    def step(self, ids: IntArray, poses: FloatArray, touched: BoolArray) -> tuple[FloatArray, Sequence[str]]:
        """Return rewards (n,), and why each episode of robots `ids` ends; empty = it goes on.

        The costs of contact, effort and accidents are not included. Poses (N, 4) are x, y, z, yaw of
        base_link, meters and radians; `touched` (N,) tells whether each robot collided in the step.
        """

    @abstractmethod
    def infos(self) -> dict[str, Any]:
        """Return (N, ...) arrays of the task's entries of `info`."""


STANDING = 0.02
"""Shares of the robot's largest speed and turn rate below which it stands; on slopes it creeps by less."""
COVERED = 0.95
"""Share of the reachable ground at which a world counts as mapped."""


class MappingTask(Task):
    """Mapping task: reward per square meter of ground newly seen in motion.

    A robot that stands earns nothing by the noise of its lidar.

    The episode ends at 95 % of the reachable ground.
    """

    observe: ClassVar = ("scan", "odometry", "attitude")
    time_limit: ClassVar = 120.0
    option_names: ClassVar = ("start",)
    needs_seen: ClassVar = True

    def __init__(self, stage: Stage) -> None:
        super().__init__(stage)
        if stage.seen is None:
            raise ConfigError("the mapping task needs the seen ground")
        self._seen = stage.seen
        self._area = [0] * stage.count
        self._reachable = np.ones(stage.count, np.int64)
        self._before, self._poses = np.zeros(stage.count, np.int64), np.zeros((stage.count, 4))

    def draw(self, i: int, rng: np.random.Generator, options: Mapping[str, Any]) -> Pose2 | None:
        """Draw a start (see `Task.draw`)."""
        start = self.stage.start(rng, options)
        self._area[i] = self.stage.site.area(start.x, start.y)
        if not self._area[i]:
            if "start" in options or not self.stage.randomize_start:
                raise SimulationError(f"the start ({start.x:.2f}, {start.y:.2f}) is not on free ground")
            return None
        return start

    def ground(self, i: int) -> tuple[SeenFrame, BoolArray]:
        """Return the whole ground; wanted is its reachable part."""
        site = self.stage.site
        return site.seen, site.reachable(self._area[i])

    def begin(self, i: int, poses: FloatArray) -> None:
        """Begin after the first scan, whose ground earns nothing."""
        self._reachable[i] = max(int(self.ground(i)[1].sum()), 1)
        self._before[i], self._poses[i] = self._seen.cells[i], poses[i]

    def step(self, ids: IntArray, poses: FloatArray, touched: BoolArray) -> tuple[FloatArray, Sequence[str]]:
        """Return the square meters newly seen, 0 for robots that stand; the end is "covered"."""
        robot, share = self.stage.simulation.robot, STANDING * self.stage.simulation.period
        moved = poses[ids] - self._poses[ids]
        turned = np.abs(moved[:, 3] - math.tau * np.rint(moved[:, 3] / math.tau))
        moves = np.sqrt((moved[:, :3] ** 2).sum(axis=1)) > share * robot.max_speed
        moves |= turned > share * robot.max_turn_rate
        new = (self._seen.cells[ids] - self._before[ids]) * SEEN_CELL**2
        self._before[ids], self._poses[ids] = self._seen.cells[ids], poses[ids]
        covered = self._seen.wanted_cells[ids] / self._reachable[ids] >= COVERED
        return np.where(moves, new, 0.0), ["covered" if end else "" for end in covered.tolist()]

    def infos(self) -> dict[str, Any]:
        """Return the coverage of the reachable ground, 0 to 1, and the seen area, m^2."""
        coverage = self._seen.wanted_cells / self._reachable
        return {"coverage": coverage, "seen_area": self._seen.cells * SEEN_CELL**2}


class GoalTask(Task):
    """Task that ends at a goal.

    Attributes:
        goals: (N, 2) x, y, meters.
        success: (N,) whether the goal is reached.
    """

    goals: FloatArray
    admits_flight: ClassVar = False

    def __init__(self, stage: Stage) -> None:
        super().__init__(stage)
        self.goals, self.success = np.zeros((stage.count, 2)), np.zeros(stage.count, np.bool_)

    def distances(self, poses: FloatArray) -> FloatArray:
        """Return (N,) straight distances to the goals, meters."""
        return np.array([math.hypot(x, y) for x, y in (self.goals - poses[:, :2]).tolist()])


class NavigationTask(GoalTask):
    """Navigation task: reward per meter gained on the shortest path to the goal.

    Goal and collision end the episode.

    The way is the shortest over ground that the robot can drive. The goal is reached where way and straight
    distance are at most 0.5 m, or the robot's radius if that is more, and no obstacle is between. Difficulty
    sets how long the way is, and how rough and how much blocked the straight line to the goal is.
    """

    observe: ClassVar = ("scan", "goal", "attitude")
    time_limit: ClassVar = 90.0
    option_names: ClassVar = ("start", "goal", "difficulty")
    ends_at_contact: ClassVar = True

    def __init__(self, stage: Stage) -> None:
        super().__init__(stage)
        robot, grid = stage.simulation.robot, stage.site.grid
        self._radius = max(0.5, robot.radius)
        self._open = stage.site.world.traversable(
            clearance=0.0, max_slope=robot.max_slope, resolution=grid.resolution
        ).free
        self._costs: list[FloatArray] = [np.zeros((0, 0))] * stage.count
        # Way to the goal at the start, and now.
        self._ways = np.zeros((stage.count, 2))
        self._collision = np.zeros(stage.count, np.bool_)
        self._distances = np.zeros(stage.count)

    def draw(self, i: int, rng: np.random.Generator, options: Mapping[str, Any]) -> Pose2 | None:
        """Draw start and goal (see `Task.draw`)."""
        site, start = self.stage.site, self.stage.start(rng, options)
        if "goal" in options:
            x, y = point(options["goal"], 2, "goal")
        else:
            goal = draw_goal(site, start, float(self.stage.difficulty[i]), rng)
            if goal is None:
                return None
            x, y = goal
        cost = site.distances(x, y) if site.area(x, y) else np.full(site.areas.shape, np.inf)
        way = site.way(cost, start.x, start.y)
        if not np.isfinite(way):
            if "goal" in options:
                raise SimulationError(
                    f"no way leads from ({start.x:.2f}, {start.y:.2f}) to the goal ({x:.2f}, {y:.2f})"
                )
            return None
        self.goals[i], self._costs[i], self._ways[i] = (x, y), cost, way
        return start

    def begin(self, i: int, poses: FloatArray) -> None:
        """Begin with neither success nor collision."""
        self.success[i] = self._collision[i] = False
        self._distances[i] = self.distances(poses)[i]

    def step(self, ids: IntArray, poses: FloatArray, touched: BoolArray) -> tuple[FloatArray, Sequence[str]]:
        """Return the meters gained, plus the rewards of success and collision, which end the episode."""
        site, weights, places = self.stage.site, self.stage.rewards, poses[ids, :2].tolist()
        ways = np.array([site.way(self._costs[i], *place) for i, place in zip(ids, places, strict=True)])
        # Off the drivable ground the robot gains nothing until it returns.
        present = np.where(np.isfinite(ways), ways, self._ways[ids, 1])
        gained = self._ways[ids, 1] - present
        self._ways[ids, 1], self._distances = present, self.distances(poses)
        # Within the radius, but not through an obstacle.
        near = np.maximum(self._distances[ids], ways) <= self._radius
        seen = [near[k] and self._sees_goal(i, poses[i, :2]) for k, i in enumerate(ids)]
        success = np.array(seen, np.bool_)
        collision = touched[ids] & ~success
        self.success[ids], self._collision[ids] = success, collision
        rewards: FloatArray = gained + (weights.success * success + weights.collision * collision)
        return rewards, np.where(success, "success", np.where(collision, "collision", "")).tolist()

    def infos(self) -> dict[str, Any]:
        """Return outcome, goal, straight distance to it and the shortest way from the start, meters."""
        return {
            "success": self.success.copy(),
            "collision": self._collision.copy(),
            "goal": self.goals.copy(),
            "distance": self._distances.copy(),
            "shortest_path": self._ways[:, 0].copy(),
        }

    def _sees_goal(self, i: int, place: FloatArray) -> bool:
        """Return whether the straight line to the goal is free: a short path may lead around a wall."""
        share = np.linspace(0.0, 1.0, 32)[:, None]
        cells = self.stage.site.grid.cells((1 - share) * place + share * self.goals[i])
        row, col = np.clip(cells, 0, np.array(self._open.shape) - 1).T
        return bool(self._open[row, col].all())


MIXED = "mixed"
"""Name of the kind that draws any of the kinds for each episode."""


class CourseScale(NamedTuple):
    """Lengths and slopes of courses relative to those for a Husky (see `generators.terrain.generate`)."""

    scale: float
    steepness: float


def course_scale(robot: Robot) -> CourseScale:
    """Return the scale at which a course is as hard as for a Husky."""
    husky = ROBOTS["husky"]
    return CourseScale(robot.radius / husky.radius, robot.friction / husky.friction)


class TraverseTask(GoalTask):
    """Traverse task: reward per share of the straight distance to the goal that is gained.

    Shares, as in the benchmark's score, weigh the same on a small robot's short course. The goal ends the
    episode.

    Attributes:
        courses: Present course of each robot.
    """

    observe: ClassVar = ("scan", "goal", "attitude", "height_map")
    time_limit: ClassVar = 90.0
    option_names: ClassVar = ("difficulty", "kind")

    def __init__(self, stage: Stage, kind: str, scale: CourseScale) -> None:
        super().__init__(stage)
        self._kind, self._scale = check_kind(kind), scale
        self.courses: dict[int, GeneratedTerrain] = {}
        self._kinds, self._difficulties = [""] * stage.count, np.zeros(stage.count)
        # Distance to the goal at the start, and now.
        self._distances = np.zeros((stage.count, 2))
        self._radius = max(0.5 * scale.scale, stage.simulation.robot.radius)

    def draw(self, i: int, rng: np.random.Generator, options: Mapping[str, Any]) -> Pose2 | None:
        """Draw a course (see `Task.draw`)."""
        kind = check_kind(options.get("kind", self._kind))
        if kind == MIXED:
            kind = KINDS[int(rng.integers(len(KINDS)))]
        drawn = rng if self.stage.randomize_terrain else np.random.default_rng(0)
        course = generate(kind, float(self.stage.difficulty[i]), drawn, **self._scale._asdict())
        try:
            self.stage.simulation.replace_terrain(course.world(), i)
        except SimulationError:
            # The steepest courses have no ground for walkers.
            if not self.stage.randomize_terrain:
                raise
            return None
        self.courses[i], self._kinds[i], self._difficulties[i] = course, kind, course.difficulty
        self.goals[i] = course.goal.x, course.goal.y
        return course.start

    def ground(self, i: int) -> tuple[SeenFrame, BoolArray]:
        """Return the whole course."""
        frame = seen_frame(self.stage.simulation.worlds[i])
        return frame, np.isfinite(frame.height)

    def begin(self, i: int, poses: FloatArray) -> None:
        """Begin at the start."""
        self._distances[i], self.success[i] = self.distances(poses)[i], False

    def step(self, ids: IntArray, poses: FloatArray, touched: BoolArray) -> tuple[FloatArray, Sequence[str]]:
        """Return the reward of the share gained, plus that of success, which ends the episode."""
        weights, distances = self.stage.rewards, self.distances(poses)[ids]
        success = distances <= self._radius
        gained = (self._distances[ids, 1] - distances) / self._distances[ids, 0]
        self._distances[ids, 1], self.success[ids] = distances, success
        rewards: FloatArray = weights.crossing * gained + weights.success * success
        return rewards, np.where(success, "success", "").tolist()

    def infos(self) -> dict[str, Any]:
        """Return success, kind, difficulty, distance to the goal and meters gained."""
        return {
            "success": self.success.copy(),
            "kind": np.array(self._kinds, dtype=object),
            "difficulty": self._difficulties.copy(),
            "distance": self._distances[:, 1].copy(),
            "progress": self._distances[:, 0] - self._distances[:, 1],
        }


def check_kind(kind: Any) -> str:
    """Return a kind of course."""
    require_known("kind of terrain", kind, (*KINDS, MIXED))
    return str(kind)


def point(value: Any, size: int, name: str) -> tuple[float, ...]:
    """Return numbers as a tuple."""
    try:
        numbers = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        numbers = np.empty(0)
    if numbers.shape != (size,) or not np.isfinite(numbers).all():
        raise ConfigError(f"options[{name!r}] must be {size} finite numbers, got {value!r}")
    return tuple(numbers.tolist())


TASKS: dict[str, type[Task]] = {
    "mapping": MappingTask,
    "navigation": NavigationTask,
    "traverse": TraverseTask,
}
"""Tasks by name (see `register_task`)."""


def register_task(name: str, task: type[Task]) -> None:
    """Register a task under a name, which environments then take as `task`.

    Raises:
        ConfigError: it is no task, or the name belongs to another one.
    """
    if not (isinstance(task, type) and issubclass(task, Task)):
        raise ConfigError(f"a task must be a subclass of lirs_envs.tasks.task.Task, got {task!r}")
    if TASKS.setdefault(name, task) is not task:
        raise ConfigError(f"the name {name!r} belongs to another task, {TASKS[name].__qualname__}")
