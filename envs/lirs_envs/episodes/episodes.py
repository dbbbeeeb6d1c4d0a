"""Episodes of N robots, shared by the single and the vector environment."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
from gymnasium import spaces

from lirs_envs.episodes.config import EnvConfig
from lirs_envs.episodes.observations import Observations
from lirs_envs.episodes.world_cache import cached_world
from lirs_envs.generators.terrain import generate, scaled_height_range
from lirs_envs.sensing.sensors import Observation
from lirs_envs.simulation import Simulation
from lirs_envs.tasks.seen_ground import SeenGround
from lirs_envs.tasks.site import make_site
from lirs_envs.tasks.task import DRAWS, MIXED, TASKS, CourseScale, Stage, TraverseTask, course_scale
from lirs_wct import ConfigError, Pose3, SimulationError, World, require_known
from lirs_wct.arrays import BoolArray, FloatArray, IntArray, njit
from lirs_wct.errors import within

Factors = dict[str, tuple[float, float] | None]
"""Randomized quantities with their ranges."""
INTERVAL = 5.0
"""Mean time between two pushes, and between two changes of the slip, seconds."""
PUSH, SLIP = "pushes", "slip"
ERROR, TIPPED, LEFT = "error", "tipped over", "left the world"
"""Accidents: reasons for the end of an episode of any task."""
CLIMB_RATE = 1.0
"""Climb rate of a flying robot at full action, m/s."""
GROUND_REACH, FLYING_REACH = 1.0, 3.0
"""Greatest height of a beam above the ground that it sees, meters."""


class Episodes:
    """N episodes of one task; array row i is robot i and depends on no other.

    Attributes:
        action_space: Action space of one robot.
        terminated: (N,) whether the last step ended the episode by the task's rules, or by an accident.
        truncated: (N,) whether the time was up.
        max_steps: Number of steps until an episode is truncated.

    Args:
        task: Name of the task (see `TASKS`).
        kind: Kind of course, for the traverse task only; None = `mixed`.
        max_steps: Number of steps until an episode is truncated; None = by the time limit alone.
    """

    def __init__(
        self,
        task: str,
        config: EnvConfig,
        count: int,
        *,
        threads: int = 1,
        kind: str | None = None,
        max_steps: int | None = None,
    ) -> None:
        _check_task(task, config, kind)
        crossing, robot = task == "traverse", config.simulation.robot
        scale = course_scale(robot)
        factors = config.factors
        if factors is None:
            factors = {"terrain": None} if crossing else {"start": None}
        if "terrain" in factors and not crossing:
            raise ConfigError("randomize 'terrain' is for the task to cross generated terrain")
        self.config, self.count = config, count
        self.simulation = Simulation(
            _world(config, crossing, scale),
            replace(config.simulation, height_range=scaled_height_range(*scale) if crossing else None),
            count=count,
            period=1 / config.control_hz,
            threads=threads,
            own_models=bool(factors.keys() & {"friction", "mass"}),
        )
        names = TASKS[task].observe if config.observe is None else config.observe
        self.stage = self._make_stage(factors, sees=TASKS[task].needs_seen or "seen_map" in names)
        self.task = (
            TraverseTask(self.stage, MIXED if kind is None else kind, scale)
            if crossing
            else TASKS[task](self.stage)
        )
        if {"goal", "goal_direction"} & set(names) and self.task.goals is None:
            raise ConfigError(f"the {task} task has no goal to observe")
        self.observations = Observations(names, self.stage, self.task)
        self._randomization = Randomization(self.simulation, factors)
        self.action_space = spaces.Box(-1.0, 1.0, (3 if robot.flies else 2,), np.float32)
        self._scale = np.array((robot.max_speed, robot.max_turn_rate, CLIMB_RATE))
        self.limit_steps(max_steps)
        weights = config.weights
        self._accidents = {ERROR: weights.tipped, TIPPED: weights.tipped, LEFT: weights.left}
        self._make_rows(count)

    def limit_steps(self, steps: int | None) -> None:
        """Limit episodes to a number of steps in place of the task's time limit; None = the task's.

        Of this number and a `time_limit` of the user's, the shorter holds.
        """
        seconds = self.config.time_limit or (math.inf if steps else self.task.time_limit)
        self.max_steps = int(min(steps or math.inf, max(1.0, np.rint(seconds * self.config.control_hz))))

    def _make_stage(self, factors: Factors, *, sees: bool) -> Stage:
        robot = self.config.simulation.robot
        site, mount = make_site(self.simulation.worlds[0], robot), robot.T_base_laser
        beams = self.simulation.preset.directions @ mount.rotation.T
        reach = FLYING_REACH if robot.flies else GROUND_REACH
        shape = site.seen.height.shape
        seen = SeenGround(self.count, shape, beams, mount.position, reach) if sees else None
        return Stage(
            simulation=self.simulation,
            site=site,
            seen=seen,
            rewards=self.config.weights,
            difficulty=np.full(self.count, float(self.config.difficulty)),
            randomize_start="start" in factors,
            randomize_terrain="terrain" in factors,
            poses=np.zeros((self.count, 4)),
        )

    def _make_rows(self, count: int) -> None:
        self.terminated: BoolArray = np.zeros(count, np.bool_)
        self.truncated: BoolArray = np.zeros(count, np.bool_)
        self._steps, self._redrawn = np.zeros(count, np.int64), np.zeros(count, np.int64)
        # Cost of contact in this episode, at most 0.
        self._contact = np.zeros(count)
        self._touched: BoolArray = np.zeros(count, np.bool_)
        self._ready: BoolArray = np.zeros(count, np.bool_)
        self._reasons = [""] * count

    def reset(self, i: int, rng: np.random.Generator, options: Mapping[str, Any] | None = None) -> None:
        """Begin an episode of robot `i`.

        Raises:
            ConfigError: an option is unknown or has a value that is not legal.
            SimulationError: the given start or goal is impossible, or none could be drawn.
        """
        options, reason = check_options(options), ""
        for name in options:
            require_known("option of reset", name, self.task.option_names)
        if "difficulty" in options:
            self.set_difficulty(i, options["difficulty"])
        self._ready[i] = False
        self._randomization.draw(i, rng)
        seed = int(rng.integers(2**31))
        for draw in range(DRAWS):
            start = self.task.draw(i, rng, options)
            if start is None:
                continue
            try:
                self.simulation.place(i, start, seed)
            except SimulationError as error:
                reason = f"; of the last one, {error}"
                if "start" in options or not (self.stage.randomize_start or self.stage.randomize_terrain):
                    raise
                continue
            self._begin(i, draw)
            return
        raise SimulationError(
            f"{self.simulation.worlds[i].name}: none of {DRAWS} starts and goals that were drawn can be used"
            + reason
        )

    def _begin(self, i: int, redrawn: int) -> None:
        self._redrawn[i], self._steps[i], self._reasons[i] = redrawn, 0, ""
        self.terminated[i] = self.truncated[i] = False
        self._contact[i], self._touched[i] = 0.0, False
        _find_poses(self.simulation.T_world_base, self.stage.poses)
        if self.stage.seen is not None:
            self.stage.seen.begin(i, *self.task.ground(i))
            self._see(np.array((i,)))
        self._randomization.begin(i)
        self.task.begin(i, self.stage.poses)
        self.observations.begin(i)
        self._ready[i] = True

    def set_difficulty(self, i: int, difficulty: float) -> None:
        """Set the difficulty of the next episodes of robot `i`.

        Raises:
            ConfigError: it is not 0 to 1.
        """
        within("[0, 1]")(difficulty, "a difficulty")
        self.stage.difficulty[i] = difficulty

    def step(self, ids: IntArray, actions: Any) -> FloatArray:
        """Apply actions for one period; return the rewards (n,).

        Args:
            ids: Rows of the robots, sorted.
            actions: (n, 2 or 3) shares in [-1, 1] of the largest speed, turn rate, climb; clipped.

        Raises:
            ConfigError: the actions have a wrong shape, or one is not finite.
            SimulationError: an episode has not begun or has ended.
        """
        self._check_ready(ids)
        taken = action_array(actions, (len(ids), *self.action_space.shape))
        if not np.isfinite(taken).all():
            raise ConfigError("an action must be finite")
        taken = np.clip(taken, -1.0, 1.0)
        commands = np.zeros((self.count, 3))
        commands[ids, : taken.shape[1]] = taken * self._scale[: taken.shape[1]]
        self._randomization.disturb(ids)
        simulation, stage = self.simulation, self.stage
        simulation.drive(ids, commands, self._see if stage.seen else None)
        self._touched = simulation.touched
        _find_poses(simulation.T_world_base, stage.poses)
        going = np.array([i for i in ids.tolist() if not simulation.errors[i]], np.int64)
        rewards = np.zeros(self.count)
        rewards[going], ends = self.task.step(going, stage.poses, self._touched)
        self.observations.step(ids)
        self._steps[ids] += 1
        self._end(ids, dict(zip(going.tolist(), ends, strict=True)))
        for i in ids[self.terminated[ids]].tolist():
            if self._reasons[i] in self._accidents:
                # A falling robot earns nothing by the ground that its lidar sweeps.
                rewards[i] = min(rewards[i], 0.0) + self._accidents[self._reasons[i]]
        effort = stage.rewards.effort * simulation.period
        cost: FloatArray = self._charge_contact(ids) + effort * (taken**2).mean(axis=1)
        return rewards[ids] + cost

    def _charge_contact(self, ids: IntArray) -> FloatArray:
        """Return the cost of contact in this step (n,), at most 0.

        All of an episode cost no more than a collision: else a policy that gets somewhere on rough ground
        would earn less than one that stands still.
        """
        if self.task.ends_at_contact:
            return np.zeros(len(ids))
        weights, before = self.stage.rewards, self._contact[ids]
        self._contact[ids] = np.maximum(
            before + weights.contact * self.simulation.period * self._touched[ids],
            np.minimum(weights.collision, before),
        )
        charged: FloatArray = self._contact[ids] - before
        return charged

    def _end(self, ids: IntArray, ends: Mapping[int, str]) -> None:
        """End episodes, by the reason of the task or by an accident."""
        simulation = self.simulation
        tipped, off = simulation.find_tipped().tolist(), simulation.off_world().tolist()
        for i in ids.tolist():
            accident = ERROR if simulation.errors[i] else TIPPED if tipped[i] else LEFT if off[i] else ""
            reason = accident or ends[i]
            late = not reason and self._steps[i] >= self.max_steps
            self.terminated[i], self.truncated[i] = bool(reason), late
            self._reasons[i] = "timeout" if late else reason

    def _see(self, rows: IntArray) -> None:
        simulation, seen = self.simulation, self.stage.seen
        assert seen is not None
        seen.add(rows, simulation.ranges, simulation.preset.range_max, simulation.T_world_base)

    def _check_ready(self, ids: IntArray) -> None:
        if not self._ready[ids].all():
            raise SimulationError("an environment must be reset before its first step")
        over = self.terminated[ids] | self.truncated[ids]
        if over.any():
            reason = self._reasons[int(ids[int(np.argmax(over))])]
            raise SimulationError(f"the episode has ended ({reason}): a reset comes before the next step")

    def infos(self) -> dict[str, Any]:
        """Return (N, ...) arrays of the entries of `info`."""
        figures = self.task.infos()
        if "success" in figures:
            figures["success"] &= ~np.isin(self._reasons, list(self._accidents))
            figures["is_success"] = figures["success"].copy()  # The name that Stable-Baselines3 logs.
        return {
            "T_world_base": self.stage.poses[:, (0, 1, 3)],
            "time": self._steps * self.simulation.period,
            "contact": self._touched.copy(),
            "timeout": self.truncated.copy(),
            "reason": np.array(self._reasons, dtype=object),
            "redrawn": self._redrawn.copy(),
            **figures,
        }


def action_array(actions: Any, shape: tuple[int, ...]) -> FloatArray:
    """Return actions as an array."""
    try:
        taken = np.asarray(actions)
    except (TypeError, ValueError):
        raise ConfigError(
            f"actions must be numbers of shape {shape}, got rows of different lengths"
        ) from None
    if taken.shape != shape:
        raise ConfigError(f"actions must be numbers of shape {shape}, got shape {taken.shape}")
    if taken.dtype.kind not in "fiu":
        raise ConfigError(f"actions must be numbers of shape {shape}, got {actions!r}")
    return np.asarray(taken, np.float64)


def check_options(options: Any) -> Mapping[str, Any]:
    """Return the options of a reset; none where they are None."""
    if options is not None and not isinstance(options, Mapping):
        raise ConfigError(f"options of reset must be a mapping or None, got {options!r}")
    return options or {}


@njit
def _find_poses(T_world_base: FloatArray, poses: FloatArray) -> None:
    """Fill (N, 4) x, y, z, yaw of poses (N, 7), x, y, z, quaternion."""
    for i in range(len(poses)):
        x, y, z, w, a, b, c = T_world_base[i]
        poses[i, 0], poses[i, 1], poses[i, 2] = x, y, z
        poses[i, 3] = math.atan2(2 * (w * c + a * b), 1 - 2 * (b * b + c * c))


class Randomization:
    """Domain randomization: draw friction, mass, lidar noise and latency of each episode.

    During an episode, robots are pushed and the slip of their wheels changes, at random times.
    """

    def __init__(self, simulation: Simulation, factors: Factors) -> None:
        self._simulation, self._factors = simulation, factors
        model = simulation.body.model
        base = model.body("base_link").id
        self._bodies = np.flatnonzero(model.body_rootid == base)
        self._geoms = np.flatnonzero(np.isin(model.geom_bodyid, self._bodies))
        self._nominal = {
            "geom_friction": model.geom_friction[self._geoms].copy(),
            "body_mass": model.body_mass[self._bodies].copy(),
            "body_inertia": model.body_inertia[self._bodies].copy(),
        }
        self._noise = simulation.lidar_noise[0]
        self._during = {name: factors[name] or (0.0, 0.0) for name in (PUSH, SLIP) if name in factors}
        self._rngs = [np.random.default_rng(0) for _ in range(simulation.count)]

    def draw(self, i: int, rng: np.random.Generator) -> None:
        """Draw the factors of robot `i` for its next episode."""
        drawn = {
            name: rng.uniform(*factors)
            for name, factors in self._factors.items()
            if factors is not None and name not in self._during
        }
        if self._during:
            self._rngs[i] = np.random.default_rng(int(rng.integers(2**63)))
        group, k = self._simulation.places[i]
        if "latency" in drawn:
            group.set_latency(k, drawn["latency"])
        if "sensor" in drawn:
            factor, noise = drawn["sensor"], self._noise
            self._simulation.lidar_noise[i] = replace(
                noise, sigma=factor * noise.sigma, sigma_relative=factor * noise.sigma_relative
            )
        if not self._factors.keys() & {"friction", "mass"}:
            return
        model, nominal = group.bodies.models[k], self._nominal
        model.geom_friction[self._geoms] = drawn.get("friction", 1.0) * nominal["geom_friction"]
        mass = drawn.get("mass", 1.0)
        model.body_mass[self._bodies] = mass * nominal["body_mass"]
        model.body_inertia[self._bodies] = mass * nominal["body_inertia"]
        mujoco.mj_setConst(model, mujoco.MjData(model))
        group.bodies.models_changed()

    def begin(self, i: int) -> None:
        """Draw the first slip of robot `i`, which stands at its start."""
        if SLIP in self._during:
            self._set_slip(i)

    def disturb(self, ids: IntArray) -> None:
        """Push some robots before a step, and change the slip of some."""
        chance = self._simulation.period / INTERVAL
        for i in ids.tolist() if self._during else ():
            rng = self._rngs[i]
            if PUSH in self._during and rng.random() < chance:
                speed, angle = rng.uniform(*self._during[PUSH]), rng.uniform(-math.pi, math.pi)
                # An impulse through the center of mass.
                self._simulation.states[i].qvel[:2] += np.array((math.cos(angle), math.sin(angle))) * speed
            if SLIP in self._during and rng.random() < chance:
                self._set_slip(i)

    def _set_slip(self, i: int) -> None:
        """Draw the slip of robot `i`."""
        group, k = self._simulation.places[i]
        group.set_slip(k, self._rngs[i].uniform(*self._during[SLIP]))


class EpisodeView:
    """View of one of N episodes: unobserved state and difficulty.

    Attributes:
        difficulty: Difficulty of the next episode, 0 to 1; settable.
    """

    __slots__ = ("_episodes", "_i")

    def __init__(self, episodes: Episodes, i: int) -> None:
        self._episodes, self._i = episodes, i

    @property
    def difficulty(self) -> float:
        """Difficulty of the next episode, 0 to 1."""
        return float(self._episodes.stage.difficulty[self._i])

    @difficulty.setter
    def difficulty(self, value: float) -> None:
        self._episodes.set_difficulty(self._i, value)

    @property
    def T_world_base(self) -> Pose3:  # noqa: N802  a frame pair
        """True pose of base_link."""
        return self._episodes.simulation.pose(self._i)

    @property
    def world(self) -> World:
        """The world of the episode."""
        return self._episodes.simulation.worlds[self._i]

    @property
    def goal(self) -> tuple[float, float] | None:
        """x, y of the goal, meters; None = the task has none."""
        goals = self._episodes.task.goals
        if goals is None:
            return None
        x, y = goals[self._i].tolist()
        return x, y

    def reading(self) -> Observation:
        """Return the last sensor readings as arguments of a mapper."""
        return self._episodes.simulation.reading(self._i)


def _check_task(task: str, config: EnvConfig, kind: str | None) -> None:
    """Check that a task exists, that it is one for the robot, and that a kind is a traverse's."""
    require_known("task", task, TASKS)
    robot = config.simulation.robot
    if robot.flies and not TASKS[task].admits_flight:
        raise ConfigError(f"the {task} task is for robots that drive, {robot.name} flies over obstacles")
    if kind is not None and task != "traverse":
        raise ConfigError(f"kind is for the traverse task alone, the task is {task}, got kind {kind!r}")


def _world(config: EnvConfig, crossing: bool, scale: CourseScale) -> World:
    if crossing:
        return generate("waves", 0.0, np.random.default_rng(0), **scale._asdict()).world()
    return (config.world if isinstance(config.world, World) else cached_world(config.world)).enclose()
