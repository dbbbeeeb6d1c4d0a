"""Traverse: cross rough ground, a new course in each episode."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np

from lirs_envs.generators.terrain import KINDS, GeneratedTerrain, generate
from lirs_envs.robots.robot import Robot
from lirs_envs.tasks.site import SeenFrame, seen_frame
from lirs_envs.tasks.task import GoalTask, Stage
from lirs_wct import Pose2, SimulationError, unknown_name
from lirs_wct.arrays import BoolArray, FloatArray, IntArray

HUSKY_RADIUS, HUSKY_FRICTION = 0.58, 0.7
"""Reference robot of courses: radius, meters, and tangent of the slope on which it slides."""
MIXED = "mixed"
"""Name of the kind that draws any of the kinds for each episode."""


class CourseScale(NamedTuple):
    """Lengths and slopes of courses relative to those for a Husky (see `generators.terrain.generate`)."""

    scale: float
    steepness: float


def course_scale(robot: Robot) -> CourseScale:
    """Return the scale at which a course is as hard as for a Husky."""
    return CourseScale(robot.radius / HUSKY_RADIUS, robot.friction / HUSKY_FRICTION)


class TraverseTask(GoalTask):
    """Traverse task: reward per share of the straight distance to the goal that is gained.

    Shares, as in the benchmark's score, weigh the same on a small robot's short course. The goal ends the
    episode.

    Attributes:
        courses: present course of each robot.
    """

    observe: ClassVar = ("scan", "goal", "attitude", "height_map")
    time_limit: ClassVar = 90.0
    option_names: ClassVar = ("difficulty", "kind")

    def __init__(self, stage: Stage, kind: str, scale: CourseScale) -> None:
        super().__init__(stage)
        self._kind, self._scale = check_kind(kind), scale
        self.courses: dict[int, GeneratedTerrain] = {}
        self._kinds, self._difficulties = [""] * stage.count, np.zeros(stage.count)
        self._distances = np.zeros((stage.count, 2))
        """To the goal at the start, and now."""
        self._radius = max(0.5 * scale.scale, stage.simulation.config.robot.radius)

    def draw(self, i: int, rng: np.random.Generator, options: Mapping[str, Any]) -> Pose2 | None:
        """Draw a course (see `Task.draw`)."""
        kind = check_kind(options.get("kind", self._kind))
        if kind == MIXED:
            kind = KINDS[int(rng.integers(len(KINDS)))]
        drawn = rng if self.stage.randomize_terrain else np.random.default_rng(0)
        course = generate(kind, float(self.stage.difficulty[i]), drawn, **self._scale._asdict())
        try:
            self.stage.simulation.replace_terrain(i, course.world())
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

    def begin(self, i: int) -> None:
        """Begin at the start."""
        self._distances[i], self.success[i] = self.distances()[i], False

    def step(self, ids: IntArray) -> FloatArray:
        """Return the reward of the share gained, plus that of success."""
        weights, distances = self.stage.rewards, self.distances()[ids]
        self.success[ids] = distances <= self._radius
        gained = (self._distances[ids, 1] - distances) / self._distances[ids, 0]
        self._distances[ids, 1] = distances
        rewards: FloatArray = weights.crossing * gained + weights.success * self.success[ids]
        return rewards

    def end(self, i: int) -> str:
        """Return "success"."""
        return "success" if self.success[i] else ""

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
    """Return a kind of course.

    Raises:
        ConfigError: there is none of this name.
    """
    if not isinstance(kind, str) or kind not in (*KINDS, MIXED):
        raise unknown_name("kind of terrain", kind, (*KINDS, MIXED))
    return kind
