"""One episode: a policy on a task, and its score."""

from __future__ import annotations

import math
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from lirs_envs.env import Observed, RobotEnv
from lirs_envs.policies import Policy
from lirs_extensions.bench.policies import PolicyChoice
from lirs_extensions.bench.scores import coverage_area, distance_share, success_by_path_length
from lirs_extensions.bench.tasks import BenchTask
from lirs_validation.processes import is_interrupt
from lirs_wct.arrays import Float32Array, FloatArray
from lirs_wct.errors import ConfigError
from lirs_wct.progress import Progress, no_progress

SPENT = "path driven"
"""Reason for the end of a mapping episode with a used-up path budget."""
REPORTED = 20
"""Steps between two reports of progress."""


class PolicyError(Exception):
    """A policy raised or returned an invalid action; the cause, if any, is chained."""


@dataclass
class EpisodeLog:
    """Log of an episode; each step adds one entry.

    Attributes:
        poses: true x, y, yaw, meters and radians, beginning with the start.
        first: info of the environment after the reset.
        last: latest info of the environment.
        coverage: share of the reachable ground seen, one per pose; empty except in mapping tasks.
        reason: reason for the end.
        trace: traceback of the policy's failure; empty without a failure.
    """

    poses: list[FloatArray] = field(default_factory=list)
    first: Mapping[str, Any] = field(default_factory=dict)
    last: Mapping[str, Any] = field(default_factory=dict)
    coverage: list[float] = field(default_factory=list)
    reason: str = ""
    trace: str = ""

    def add(self, info: Mapping[str, Any]) -> None:
        """Add the environment's info after the reset or a step."""
        self.first = self.first or info
        self.last = info
        self.poses.append(np.array(info["T_world_base"]))
        if "coverage" in info:
            self.coverage.append(float(info["coverage"]))

    @property
    def driven(self) -> FloatArray:
        """(n,) meters of path until each pose."""
        steps = np.diff(np.array(self.poses)[:, :2], axis=0)
        driven: FloatArray = np.concatenate(([0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))))
        return driven


def make_task_env(
    task: BenchTask, data: Path | None, observe: tuple[str, ...] | None, render_mode: str | None = None
) -> RobotEnv:
    """Return the environment of a task, with other groups of observations if given.

    Raises:
        WctError: its world cannot be made, or there is no such group.
    """
    options: dict[str, Any] = {"robot": task.robot, "time_limit": task.time_limit, "observe": observe}
    if task.world is not None:
        options["world"] = task.world.world(data)
    return RobotEnv(task.task, render_mode=render_mode, **options)


def reset_options(task: BenchTask) -> dict[str, Any]:
    """Return the options with which a task's environment is reset."""
    if task.task == "traverse":
        return {"kind": task.course, "difficulty": task.difficulty}
    options: dict[str, Any] = {"start": task.start}
    return options if task.goal is None else options | {"goal": task.goal}


def run_episode(
    task: BenchTask,
    choice: PolicyChoice,
    data: Path | None = None,
    *,
    progress: Progress = no_progress,
    picture: Callable[[Any], None] | None = None,
) -> EpisodeLog:
    """Run a policy on a task. A policy's error ends the episode and is logged.

    Args:
        task: task of the episode.
        choice: the policy.
        data: folder with the files that do not ship.
        progress: of the time limit.
        picture: called at the end with the map and the path.

    Raises:
        WctError: the task's world cannot be made, or its start or goal cannot be.
    """
    env = make_task_env(task, data, choice.observe, "map" if picture else None)
    log = EpisodeLog()
    try:
        observation, info = env.reset(seed=task.seed, options=reset_options(task))
        log.add(info)
        try:
            _drive(env, task, choice, observation, log, progress)
        except PolicyError as error:
            log.reason = str(error)
            log.trace = "".join(traceback.format_exception(error.__cause__ or error))
        if picture:
            picture(env.render())
    finally:
        env.close()
    return log


def _drive(
    env: RobotEnv,
    task: BenchTask,
    choice: PolicyChoice,
    observation: Observed,
    log: EpisodeLog,
    progress: Progress,
) -> None:
    policy = _call_policy(lambda: choice.make(env, task), "cannot be made")
    _call_policy(lambda: policy.reset(dict(log.first)), "reset(info)")
    driven, steps = 0.0, 0
    budget = math.inf if task.path_budget is None else task.path_budget
    while not log.reason:
        action = _action(env, policy, observation)
        observation, _, terminated, truncated, info = env.step(action)
        log.add(info)
        driven += float(np.hypot(*(log.poses[-1] - log.poses[-2])[:2]))
        if terminated or truncated:
            log.reason = str(info["reason"])
        elif driven >= budget:
            log.reason = SPENT
        steps += 1
        if steps % REPORTED == 0:
            progress("drive", min(1.0, float(info["time"]) / task.time_limit))
            if env.render_mode is not None:
                env.render()


def _call_policy(ask: Callable[[], Any], what: str) -> Any:
    """Call a method of a policy and return its result.

    Raises:
        PolicyError: the policy raised, or ended the program.
    """
    try:
        return ask()
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # `sys.exit` too
        if is_interrupt(error):
            raise KeyboardInterrupt from error
        raised = f"{what} raised {type(error).__name__}: {error}"
        message = str(error) if isinstance(error, ConfigError) else raised
        raise PolicyError(" ".join(message.split())) from error


def _action(env: RobotEnv, policy: Policy, observation: Observed) -> Float32Array:
    """Return the policy's action.

    Raises:
        PolicyError: it raised, or the action has a wrong shape or is not finite.
    """
    given = _call_policy(lambda: policy.act(observation), "act(observation)")
    size = env.episodes.action_space.shape[0]
    try:
        action = np.asarray(given, dtype=np.float32)
    except (TypeError, ValueError):
        action = np.empty(0, np.float32)
    if action.shape != (size,) or not np.isfinite(action).all():
        shown = " ".join(repr(given).split())[:80]
        raise PolicyError(f"act(observation) must return {size} finite numbers in [-1, 1], got {shown}")
    return action


def episode_metrics(task: BenchTask, log: EpisodeLog) -> dict[str, Any]:
    """Return score, success and their inputs; a failed policy scores 0."""
    driven, last = log.driven, log.last
    entry: dict[str, Any] = {
        "score": 0.0,
        "success": bool(last.get("success", last.get("reason") == "covered")),
        "collision": bool(last.get("collision", False)),
        "path_length": float(driven[-1]),
        "time": float(last["time"]),
    }
    if task.task == "navigation":
        shortest = float(log.first["shortest_path"])
        entry["shortest_path"] = shortest
        score = success_by_path_length(entry["success"], shortest, float(driven[-1]))
    elif task.task == "mapping":
        assert task.path_budget is not None, "checked with the task"
        entry |= {"first_coverage": log.coverage[0], "coverage": log.coverage[-1]}
        score = coverage_area(driven.tolist(), log.coverage, task.path_budget)
    else:
        whole = float(log.first["distance"])
        entry |= {"distance": whole, "progress": float(last["progress"])}
        score = 1.0 if entry["success"] else distance_share(entry["progress"], whole)
    return entry | ({} if log.trace else {"score": score})
