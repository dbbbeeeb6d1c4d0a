"""One episode: a policy on a task, its score, and its record as a task of a sweep."""

from __future__ import annotations

import hashlib
import json
import math
import traceback
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import Any, ClassVar

import cv2
import numpy as np

from lirs_envs.env import Observed, RobotEnv
from lirs_envs.episodes.observations import GROUPS
from lirs_envs.policies import Policy
from lirs_envs.tasks.task import COVERED, TASKS as ENVIRONMENT_TASKS
from lirs_extensions.bench.policies import PolicyChoice
from lirs_extensions.bench.tasks import BenchTask
from lirs_validation.experiment.loading import own_source_file
from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.processes import is_interrupt
from lirs_validation.record.run_record import plain, versions
from lirs_validation.sweep.sweep import Outcome, SweepTask, read_status
from lirs_wct import ConfigError, Float32Array, FloatArray, Progress, SourceError, no_progress
from lirs_wct.files import atomic_folder

SPENT = "path driven"
"""Reason for the end of a mapping episode with a used-up path budget."""
REPORTED = 20
"""Steps between two reports of progress."""


@dataclass
class EpisodeLog:
    """Log of an episode; each step adds one entry.

    Attributes:
        poses: true x, y, yaw, meters and radians, beginning with the start.
        driven: meters of path until each pose.
        first: info of the environment after the reset.
        coverage: share of the reachable ground seen, one per pose; empty except in mapping tasks.
        reason: reason for the end.
        trace: traceback of the policy's failure; empty without a failure.
        picture: map with the path, (rows, cols, 3); None = not wanted.
    """

    poses: list[FloatArray] = field(default_factory=list)
    driven: list[float] = field(default_factory=lambda: [0.0])
    first: Mapping[str, Any] = field(default_factory=dict)
    last: Mapping[str, Any] = field(default_factory=dict)
    coverage: list[float] = field(default_factory=list)
    reason: str = ""
    trace: str = ""
    picture: Any = None

    def add(self, info: Mapping[str, Any]) -> None:
        """Add the environment's info after the reset or a step."""
        self.first = self.first or info
        self.last = info
        pose = np.array(info["T_world_base"])
        if self.poses:
            step = np.hypot(*(pose - self.poses[-1])[:2])
            self.driven.append(self.driven[-1] + float(step))
        self.poses.append(pose)
        if "coverage" in info:
            self.coverage.append(float(info["coverage"]))


class PolicyError(Exception):
    """A policy raised or returned an invalid action; the cause, if any, is chained."""


def make_task_env(
    task: BenchTask, data: Path | None, observe: tuple[str, ...] | None, render_mode: str | None = None
) -> RobotEnv:
    """Return the environment of a task, with other groups of observations if given."""
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
    picture: bool = False,
) -> EpisodeLog:
    """Run a policy on a task. A policy's error ends the episode and is logged."""
    log = EpisodeLog()
    with closing(make_task_env(task, data, choice.observe, "map" if picture else None)) as env:
        observation, info = env.reset(seed=task.seed, options=reset_options(task))
        log.add(info)
        try:
            _drive(env, task, choice, observation, log, progress)
        except PolicyError as error:
            log.reason = str(error)
            log.trace = "".join(traceback.format_exception(error.__cause__ or error))
        if picture:
            log.picture = env.render()
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
    budget = math.inf if task.path_budget is None else task.path_budget
    while not log.reason:
        action = _action(env, policy, observation)
        observation, _, terminated, truncated, info = env.step(action)
        log.add(info)
        if terminated or truncated:
            log.reason = str(info["reason"])
        elif log.driven[-1] >= budget:
            log.reason = SPENT
        if (len(log.poses) - 1) % REPORTED == 0:
            progress("drive", min(1.0, float(info["time"]) / task.time_limit))
            if env.render_mode is not None:
                env.render()


def _call_policy(ask: Callable[[], Any], what: str) -> Any:
    """Call a method of a policy and return its result."""
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
    """Return the policy's action."""
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
    driven, last = log.driven[-1], log.last
    entry: dict[str, Any] = {
        "score": 0.0,
        "success": bool(last.get("success", last.get("reason") == "covered")),
        "collision": bool(last.get("collision", False)),
        "path_length": driven,
        "time": float(last["time"]),
    }
    if task.task == "navigation":
        shortest = float(log.first["shortest_path"])
        entry["shortest_path"] = shortest
        score = success_by_path_length(entry["success"], shortest, driven)
    elif task.task == "mapping":
        assert task.path_budget is not None, "checked with the task"
        entry |= {"first_coverage": log.coverage[0], "coverage": log.coverage[-1]}
        score = coverage_area(log.driven, log.coverage, task.path_budget)
    else:
        whole = float(log.first["distance"])
        entry |= {"distance": whole, "progress": float(last["progress"])}
        score = 1.0 if entry["success"] else distance_share(entry["progress"], whole)
    return entry | ({} if log.trace else {"score": score})


def success_by_path_length(success: bool, shortest: float, driven: float) -> float:
    """Return an episode's term of success weighted by path length (SPL).

    See Anderson et al., "On evaluation of embodied navigation agents" (2018). The shortest path leads over
    drivable ground; lengths are in meters.
    """
    return shortest / max(shortest, driven) if success else 0.0


def coverage_area(driven: Sequence[float], coverage: Sequence[float], budget: float) -> float:
    """Return the area under newly covered ground over path length, 0 to 1.

    Ground in the first scan counts as 0, the share that completes the task as 1. After the episode's end the
    coverage stays constant.

    Args:
        driven: (n,) meters of path at each step, from 0 at the first scan.
        coverage: (n,) share of the reachable ground that was seen by then.
        budget: meters of path over which the area is taken.
    """
    first = coverage[0]
    if first >= COVERED:
        return 0.0
    gained: FloatArray = np.clip((np.array(coverage) - first) / (COVERED - first), 0.0, 1.0)
    at = np.minimum(np.append(np.array(driven, dtype=np.float64), budget), budget)
    return float(np.trapezoid(np.append(gained, gained[-1]), at) / budget)


def distance_share(gained: float, whole: float) -> float:
    """Return the gained share, 0 to 1, of the distance to the goal."""
    return float(np.clip(gained / whole, 0.0, 1.0))


RECORD, PICTURE = "episode.json", "episode.png"
SCHEMA = 1
"""Of an episode's record."""
NO_METRICS = {"score": 0.0, "success": False, "collision": False, "path_length": 0.0, "time": 0.0}
"""Metrics of an episode that failed."""
SPACING = 1.0
"""Seconds between the poses that a record keeps."""


@dataclass(frozen=True, kw_only=True)
class EpisodeTask(SweepTask):
    """A policy on a task; the files that do not ship are in the folder `data`."""

    set_name: str
    set_version: int
    task: BenchTask
    policy: PolicyChoice
    data: Path | None = None
    pictures: bool = False
    marker: ClassVar[str] = RECORD

    @cached_property
    def name(self) -> str:
        """Name of its folder."""
        text = json.dumps(self._identity(), sort_keys=True)
        digest = hashlib.sha256(text.encode()).hexdigest()[:8]
        policy = self.policy.name.rpartition(":")[2].replace(".", "_")
        return f"{self.set_name}-{self.task.name}-{policy}-{digest}"

    def check(self) -> None:
        """Check the policy and the files of the world."""
        _check_policy(self.policy, self.task.task)
        if self.task.world is not None:
            self.task.world.places(self.data)

    def run(self, out: Path, scenarios: ScenarioCache, progress: Progress, *, concurrent: bool) -> Outcome:
        """Run the episode and write its record; a failed policy fails only this episode."""
        progress("build", 0.0)
        log = run_episode(self.task, self.policy, self.data, progress=progress, picture=self.pictures)
        outcome = Outcome(
            task=self.name,
            status="error" if log.trace else "ok",
            reason=log.reason,
            trace=log.trace,
            written=True,
        )
        with atomic_folder(out / self.name) as folder:
            if log.picture is not None:
                cv2.imwrite(str(folder / PICTURE), log.picture[..., ::-1])
            text = self._record(outcome, episode_metrics(self.task, log), _sample_series(log))
            (folder / RECORD).write_text(text, encoding="utf-8")
            if outcome.trace:
                (folder / "error.txt").write_text(outcome.trace, encoding="utf-8")
        return outcome

    def failure(self, outcome: Outcome) -> str:
        """Return a record with score 0 and the traceback."""
        return self._record(outcome, NO_METRICS, {})

    def inputs(self) -> list[Path | None]:
        """Return the files of the policy: its module, and files among its arguments."""
        given = (Path(value) for _, value in self.policy.arguments)
        return [own_source_file(self.policy.name), *filter(Path.is_file, given)]

    def is_result(self, folder: Path, entry: Mapping[str, Any]) -> bool:
        """Whether the picture is there, if one is wanted and the policy did not fail."""
        drawn = not self.pictures or bool(entry.get("trace")) or (folder / PICTURE).is_file()
        return drawn and _is_episode(entry)

    def describe(self) -> dict[str, Any]:
        """Return name, task and policy."""
        return {"name": self.name} | self._identity()

    def _identity(self) -> dict[str, Any]:
        return {
            "set": self.set_name,
            "set_version": self.set_version,
            "task": self.task.describe(),
            "policy": self.policy.name,
            "arguments": dict(self.policy.arguments),
        }

    def _record(self, outcome: Outcome, metrics: dict[str, Any], series: dict[str, Any]) -> str:
        entry = {"schema": SCHEMA} | self._identity()
        observe = self.policy.observe or ENVIRONMENT_TASKS[self.task.task].observe
        privileged = any(GROUPS[name].privileged for name in observe if name in GROUPS)
        entry |= {"observe": observe, "privileged": privileged}
        entry |= {"status": outcome.status, "reason": outcome.reason}
        entry |= {"metrics": metrics, "trace": outcome.trace, "versions": versions()} | series
        return json.dumps(entry, indent=1, default=plain) + "\n"


@cache
def _check_policy(policy: PolicyChoice, task: str) -> None:
    policy.check(task)
    _ = policy.observe


def _sample_series(log: EpisodeLog) -> dict[str, Any]:
    """Return one pose per second, with the coverage in mapping tasks."""
    step = max(1, round(SPACING * (len(log.poses) - 1) / max(float(log.last["time"]), 1e-9)))
    kept = sorted({*range(0, len(log.poses), step), len(log.poses) - 1})
    series: dict[str, Any] = {"path": [[round(float(v), 3) for v in log.poses[k]] for k in kept]}
    if log.coverage:
        series["coverage"] = [[round(log.driven[k], 2), round(log.coverage[k], 4)] for k in kept]
    return series


def read_episode(folder: Path) -> dict[str, Any]:
    """Read the record of an episode."""
    entry = read_status(folder / RECORD)
    if not _is_episode(entry):
        raise SourceError(f"{folder / RECORD}: not an episode's record of schema {SCHEMA}")
    return entry


def _is_episode(entry: Mapping[str, Any]) -> bool:
    names = ("set", "set_version", "task", "policy", "arguments", "trace", "versions", "metrics")
    whole = entry.get("schema") == SCHEMA and all(name in entry for name in names)
    return whole and isinstance(entry["metrics"], dict) and isinstance(entry["metrics"].get("score"), float)
