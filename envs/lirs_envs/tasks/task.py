"""Task interface: start of an episode, reward of a step, end."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from lirs_envs.batch.simulation import BatchSimulation
from lirs_envs.tasks.seen_ground import SeenGround
from lirs_envs.tasks.site import SeenFrame, Site
from lirs_wct import ConfigError, Pose2
from lirs_wct.arrays import BoolArray, FloatArray, IntArray
from lirs_wct.checks import Checked, limited

DRAWS = 100
"""Number of draws of start and goal before a reset fails."""


@dataclass(frozen=True, kw_only=True)
class Rewards(Checked, of="the rewards"):
    """Weights of the rewards that all tasks share; costs are negative.

    Tipping over and leaving the world never cost less than a collision.

    Attributes:
        success: reward at the goal.
        crossing: reward of the whole distance to the goal in traverse; a part of it earns its share.
        collision: reward at the collision that ends an episode of navigation.
        contact: reward of a second in which the robot collides, in the other tasks; `collision` is the limit
            of an episode's sum.
        tipped: reward at tipping over, or where the simulation diverges.
        left: reward at leaving the world.
        effort: reward of a second of full action.

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
    """State on which tasks act: N robots, their sites and seen ground, in rows.

    Attributes:
        simulation: the robots.
        site: free ground in the initial world.
        seen: the ground that they have seen; None = not needed.
        rewards: weights of the rewards.
        difficulty: difficulty of each robot's next episode, 0 to 1.
        randomize_start: whether starts are drawn.
        randomize_terrain: whether terrains are drawn.
    """

    simulation: BatchSimulation
    site: Site
    seen: SeenGround | None
    rewards: Rewards
    difficulty: FloatArray
    randomize_start: bool
    randomize_terrain: bool

    @property
    def count(self) -> int:
        """Number of robots, N."""
        return self.simulation.count

    def start(self, rng: np.random.Generator, options: Mapping[str, Any]) -> Pose2:
        """Return the start that the options ask for, or one drawn, or the world's first."""
        given = options.get("start")
        if given is not None:
            return given if isinstance(given, Pose2) else Pose2(*point(given, 3, "start"))
        spawn_poses = self.site.world.spawn_poses
        return self.site.draw_start(rng) if self.randomize_start or not spawn_poses else spawn_poses[0]


class Task(ABC):
    """A task for each of N robots; row i of every array is robot i's.

    Attributes:
        observe: groups of observations where the user names none.
        time_limit: seconds, where the user gives none.
        option_names: names of the options of `reset(options=...)`.
        needs_seen: whether the task reads the ground that the robots have seen (`stage.seen`).
        admits_flight: whether a robot that flies may do the task.
        ends_at_contact: whether a collision ends the episode; else each second of contact costs.
        stage: state on which the task acts.
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
        """Draw the episode of robot `i`; return the start, or None to draw again.

        An episode is start, goal and terrain.

        Raises:
            ConfigError: an option has a value that is not legal.
            SimulationError: the start or goal of the options cannot be reached.
        """

    def ground(self, i: int) -> tuple[SeenFrame, BoolArray]:
        """Return the ground that robot `i` may see, and which of its cells are wanted."""
        frame = self.stage.site.seen
        return frame, np.isfinite(frame.height)

    @abstractmethod
    def begin(self, i: int) -> None:
        """Begin the episode that was drawn: robot `i` stands at its start."""

    @abstractmethod
    def step(self, ids: IntArray) -> FloatArray:
        """Return the task's rewards (n,) of a step of robots `ids`.

        The costs of contact, effort and accidents are not included.
        """

    @abstractmethod
    def end(self, i: int) -> str:
        """Return why the task ends the episode of robot `i`; empty = it continues."""

    @abstractmethod
    def infos(self) -> dict[str, Any]:
        """Return (N, ...) arrays of the task's entries of `info`."""


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

    def distances(self) -> FloatArray:
        """Return (N,) straight distances to the goals, meters."""
        ways = self.goals - self.stage.simulation.T_world_base[:, :2]
        return np.array([math.hypot(x, y) for x, y in ways.tolist()])


def point(value: Any, size: int, name: str) -> tuple[float, ...]:
    """Return numbers as a tuple.

    Raises:
        ConfigError: they are not `size` finite numbers.
    """
    try:
        numbers = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        numbers = np.empty(0)
    if numbers.shape != (size,) or not np.isfinite(numbers).all():
        raise ConfigError(f"options[{name!r}] must be {size} finite numbers, got {value!r}")
    return tuple(numbers.tolist())
