"""An episode as an experiment of a sweep, and the results in a folder."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any, ClassVar

import cv2

from lirs_envs.episodes.episodes import TASKS as ENVIRONMENT_TASKS
from lirs_envs.episodes.observations import GROUPS
from lirs_extensions.bench import UPPER_BOUND
from lirs_extensions.bench.episode import EpisodeLog, episode_metrics, run_episode
from lirs_extensions.bench.policies import PolicyChoice
from lirs_extensions.bench.scores import PolicyScore, score_of
from lirs_extensions.bench.tasks import BenchTask, TaskSet
from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.record.provenance import same_code, versions
from lirs_validation.record.run_record import plain
from lirs_validation.sweep.experiment import Experiment, Outcome, read_status
from lirs_wct.errors import SourceError
from lirs_wct.files import atomic_folder
from lirs_wct.progress import Progress

RECORD, PICTURE = "episode.json", "episode.png"
SCHEMA = 1
"""Of an episode's record."""
NO_METRICS = {"score": 0.0, "success": False, "collision": False, "path_length": 0.0, "time": 0.0}
"""Metrics of an episode that failed."""
SPACING = 1.0
"""Seconds between the poses that a record keeps."""


@dataclass(frozen=True, kw_only=True)
class BenchExperiment(Experiment):
    """A policy on a task.

    Attributes:
        set_name: name of the task's set.
        set_version: version of that set.
        task: task of the episode.
        policy: policy that is scored.
        data: folder with the files that do not ship.
        pictures: whether a picture of the map with the path is written.
    """

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
        return f"{self.set_name}-{self.task.name}-{self.policy.short}-{digest}"

    def check(self) -> None:
        """Check the policy and the files of the world."""
        _check_policy(self.policy, self.task.task)
        if self.task.world is not None:
            self.task.world.places(self.data)

    def perform(
        self, out: Path, scenarios: ScenarioCache, progress: Progress, *, concurrent: bool
    ) -> Outcome:
        """Run the episode and write its record; a failed policy fails only this episode."""
        progress("build", 0.0)
        pictures: list[Any] = []
        log = run_episode(
            self.task,
            self.policy,
            self.data,
            progress=progress,
            picture=pictures.append if self.pictures else None,
        )
        outcome = Outcome(
            experiment=self.name,
            status="error" if log.trace else "ok",
            reason=log.reason,
            trace=log.trace,
            written=True,
        )
        with atomic_folder(out / self.name) as folder:
            if pictures:
                cv2.imwrite(str(folder / PICTURE), pictures[0][..., ::-1])
            text = self._record(outcome, episode_metrics(self.task, log), _sample_series(log))
            (folder / RECORD).write_text(text, encoding="utf-8")
            if outcome.trace:
                (folder / "error.txt").write_text(outcome.trace, encoding="utf-8")
        return outcome

    def failure(self, outcome: Outcome) -> str:
        """Return a record with score 0 and the traceback."""
        return self._record(outcome, NO_METRICS, {})

    def inputs(self) -> list[Path | None]:
        """Return the files of the policy."""
        return [*self.policy.files]

    def is_result(self, folder: Path, entry: Mapping[str, Any]) -> bool:
        """Whether the picture is there, if one is wanted and the policy did not fail."""
        drawn = not self.pictures or bool(entry.get("trace")) or (folder / PICTURE).is_file()
        return drawn and _is_episode(entry)

    @property
    def observe(self) -> tuple[str, ...]:
        """Groups of observations that the policy is given."""
        return self.policy.observe or ENVIRONMENT_TASKS[self.task.task].observe

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
        groups = [GROUPS[name] for name in self.observe if name in GROUPS]
        entry |= {"observe": self.observe, "privileged": any(group.privileged for group in groups)}
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
        driven = log.driven
        series["coverage"] = [[round(float(driven[k]), 2), round(log.coverage[k], 4)] for k in kept]
    return series


def read_episode(folder: Path) -> dict[str, Any]:
    """Read the record of an episode.

    Raises:
        SourceError: it is missing or damaged, or of another schema.
    """
    entry = read_status(folder / RECORD)
    if not _is_episode(entry):
        raise SourceError(f"{folder / RECORD}: not an episode's record of schema {SCHEMA}")
    return entry


def _is_episode(entry: Mapping[str, Any]) -> bool:
    names = ("set", "set_version", "task", "policy", "arguments", "trace", "versions", "metrics")
    whole = entry.get("schema") == SCHEMA and all(name in entry for name in names)
    return whole and isinstance(entry["metrics"], dict) and isinstance(entry["metrics"].get("score"), float)


@dataclass(frozen=True, kw_only=True)
class PolicyResult:
    """A policy over the chosen tasks.

    Attributes:
        policy: policy that was scored.
        score: score over its tasks.
        episodes: records by the task's name.
    """

    policy: PolicyChoice
    score: PolicyScore
    episodes: dict[str, dict[str, Any]]

    @property
    def successes(self) -> float:
        """Share of the episodes that succeeded."""
        return self._share("success")

    @property
    def collisions(self) -> float:
        """Share of the episodes that ended by a collision."""
        return self._share("collision")

    @property
    def failed(self) -> int:
        """Number of episodes in which the policy failed or that could not run."""
        return sum(entry["status"] != "ok" for entry in self.episodes.values())

    @property
    def privileged(self) -> bool:
        """Whether the policy gets simulator-only data."""
        return self.policy.name == UPPER_BOUND or any(e["privileged"] for e in self.episodes.values())

    def _share(self, name: str) -> float:
        return sum(bool(entry["metrics"][name]) for entry in self.episodes.values()) / len(self.episodes)


def share_of_bound(result: PolicyResult, results: Sequence[PolicyResult]) -> float | None:
    """Return a policy's share of the upper bound's score over common tasks; None without the bound."""
    bound = next((each for each in results if each.policy.name == UPPER_BOUND), None)
    if bound is None:
        return None
    common = result.episodes.keys() & bound.episodes.keys()
    best = sum(bound.episodes[name]["metrics"]["score"] for name in common)
    own = sum(result.episodes[name]["metrics"]["score"] for name in common)
    return own / best if best > 0 else None


def read_results(out: Path, tasks: TaskSet, chosen: Sequence[BenchTask]) -> list[PolicyResult]:
    """Return the results of every policy in a folder over some tasks, the best first.

    Episodes of other code, of another version of the set, or of a task that has changed are left out.
    """
    described = {task.name: task.describe() for task in chosen}
    found: dict[PolicyChoice, dict[str, dict[str, Any]]] = {}
    for path in sorted(out.glob(f"{tasks.name}-*/{RECORD}")):
        try:
            entry = read_episode(path.parent)
        except SourceError:
            continue
        name = entry["task"]["name"]
        same_set = (entry["set"], entry["set_version"]) == (tasks.name, tasks.version)
        if same_set and same_code(entry["versions"]) and described.get(name) == as_read(entry["task"]):
            policy = PolicyChoice(entry["policy"], tuple(sorted(entry["arguments"].items())))
            found.setdefault(policy, {})[name] = entry
    results = [_result(policy, episodes) for policy, episodes in found.items()]
    return sorted(results, key=lambda result: -result.score.mean)


def as_read(task: dict[str, Any]) -> dict[str, Any]:
    """Return a described task of a record, whose tuples JSON made lists."""
    return {key: tuple(value) if key in ("start", "goal") else value for key, value in task.items()}


def _result(policy: PolicyChoice, episodes: dict[str, dict[str, Any]]) -> PolicyResult:
    score = score_of([float(entry["metrics"]["score"]) for entry in episodes.values()])
    assert score is not None, "there is an episode"
    return PolicyResult(policy=policy, score=score, episodes=episodes)
