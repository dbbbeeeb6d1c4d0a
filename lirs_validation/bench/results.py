"""Results of the benchmark in a folder: scores of policies over the same tasks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lirs_validation.bench.experiment import RECORD, read_episode
from lirs_validation.bench.policies import UPPER_BOUND, PolicyChoice
from lirs_validation.bench.scores import PolicyScore, score_of
from lirs_validation.bench.tasks import BenchTask, TaskSet
from lirs_validation.record.provenance import same_code
from lirs_wct.errors import SourceError


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


def share_of_bound(result: PolicyResult, bound: PolicyResult | None) -> float | None:
    """Return a policy's share of the upper bound's score over common tasks."""
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
