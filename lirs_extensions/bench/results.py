"""Results of the benchmark: mean scores of policies with intervals, lines and a table of them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import scipy  # its modules load on first use

from lirs_extensions.bench import UPPER_BOUND
from lirs_extensions.bench.episode import RECORD, read_episode
from lirs_extensions.bench.policies import PolicyChoice
from lirs_extensions.bench.tasks import BenchTask, TaskSet
from lirs_validation.record.metric_catalog import NOTHING
from lirs_validation.record.run_record import same_code
from lirs_validation.report.table import ReportTable
from lirs_wct.errors import SourceError
from lirs_wct.files import write_json

CONFIDENCE = 0.95
RESAMPLES = 10_000
SEED = 1
"""Of the resamples: the same scores have the same interval."""


@dataclass(frozen=True, kw_only=True)
class PolicyScore:
    """A mean over tasks, with its 95 % interval by the percentile bootstrap; None of one task."""

    mean: float
    low: float | None
    high: float | None
    count: int


def score_of(values: Sequence[float]) -> PolicyScore:
    """Return the mean of tasks' scores with its interval."""
    scores, mean = np.array(values, dtype=np.float64), float(np.mean(values))
    if len(scores) == 1:
        return PolicyScore(mean=mean, low=None, high=None, count=1)
    if np.ptp(scores) == 0:
        return PolicyScore(mean=mean, low=mean, high=mean, count=len(scores))
    found = scipy.stats.bootstrap(
        (scores,),
        np.mean,
        confidence_level=CONFIDENCE,
        n_resamples=RESAMPLES,
        method="percentile",
        rng=np.random.default_rng(SEED),
    ).confidence_interval
    return PolicyScore(mean=mean, low=float(found.low), high=float(found.high), count=len(scores))


@dataclass(frozen=True, kw_only=True)
class PolicyResult:
    """A policy over the chosen tasks; its episodes are records by the task's name."""

    policy: PolicyChoice
    episodes: dict[str, dict[str, Any]]

    @cached_property
    def scores(self) -> dict[str, float]:
        """Score of each task."""
        return {name: float(entry["metrics"]["score"]) for name, entry in self.episodes.items()}

    @cached_property
    def score(self) -> PolicyScore:
        """Score over all tasks."""
        return score_of(list(self.scores.values()))

    @property
    def failed(self) -> dict[str, str]:
        """Reason of each episode in which the policy failed or that could not run."""
        return {name: e["reason"] for name, e in self.episodes.items() if e["status"] != "ok"}

    @property
    def privileged(self) -> bool:
        """Whether the policy gets simulator-only data."""
        return self.policy.name == UPPER_BOUND or any(e["privileged"] for e in self.episodes.values())

    def share(self, metric: str) -> float:
        """Return the share of the episodes in which a metric is true."""
        return sum(bool(entry["metrics"][metric]) for entry in self.episodes.values()) / len(self.episodes)


def share_of_bound(result: PolicyResult, results: Sequence[PolicyResult]) -> float | None:
    """Return a policy's share of the upper bound's score over common tasks; None without the bound."""
    bound = next((each for each in results if each.policy.name == UPPER_BOUND), None)
    if bound is None:
        return None
    common = sorted(result.episodes.keys() & bound.episodes.keys())
    own, best = (sum(each.scores[name] for name in common) for each in (result, bound))
    return own / best if best > 0 else None


def read_results(out: Path, tasks: TaskSet, chosen: Sequence[BenchTask]) -> list[PolicyResult]:
    """Return the results of every policy in a folder over some tasks, the best first.

    Episodes of other code, of another version of the set, or of a task that has changed are left out.
    """
    described = {task.name: json.loads(json.dumps(task.describe())) for task in chosen}
    found: dict[PolicyChoice, dict[str, dict[str, Any]]] = {}
    for path in sorted(out.glob(f"{tasks.name}-*/{RECORD}")):
        try:
            entry = read_episode(path.parent)
        except SourceError:
            continue
        name = entry["task"]["name"]
        same_set = (entry["set"], entry["set_version"]) == (tasks.name, tasks.version)
        if same_set and same_code(entry["versions"]) and described.get(name) == entry["task"]:
            policy = PolicyChoice(entry["policy"], tuple(sorted(entry["arguments"].items())))
            found.setdefault(policy, {})[name] = entry
    results = [PolicyResult(policy=policy, episodes=episodes) for policy, episodes in found.items()]
    return sorted(results, key=lambda result: -result.score.mean)


MEASURES = {
    "navigation": "success weighted by path length (SPL)",
    "mapping": "area under newly covered ground over path length",
    "traverse": "share of the distance gained",
}
"""Definition of the score by task."""
HEADINGS = ("policy", "score", "95 %", "success", "collision", "failed", "of astar", "tasks")


def answer_line(results: Sequence[PolicyResult], tasks: Sequence[BenchTask], where: str) -> str:
    """Return in one sentence each policy's reached goals or coverage in some tasks."""
    names, parts = {task.name for task in tasks}, list[str]()
    for result in results:
        metrics = [entry["metrics"] for name, entry in result.episodes.items() if name in names]
        if tasks[0].task == "mapping":
            covered = sum(each.get("coverage", 0.0) for each in metrics) / max(len(metrics), 1)
            value = f"{100 * covered:.0f} %"
            text = f"covers {value} of the ground in {where};"
        else:
            value, count = str(sum(each["success"] for each in metrics)), len(metrics)
            text = f"reaches {value} of {count} goals in {where};"
            value += "" if count == len(tasks) else f" of {count}"
        parts.append(f"{result.policy.label} {value if parts else text}")
    return f"{parts[0]} {', '.join(parts[1:])}".rstrip("; ") + "."


def difference_line(result: PolicyResult, other: PolicyResult) -> str:
    """Return the mean difference of two policies' scores over their common tasks in one line.

    The interval is the paired bootstrap: it resamples the tasks' differences.
    """
    common = sorted(result.episodes.keys() & other.episodes.keys())
    names = f"{result.policy.label} - {other.policy.label}"
    if not common:
        return f"{names}: no common tasks"
    found = score_of([result.scores[name] - other.scores[name] for name in common])
    return f"{names}: {found.mean:+.3f} [{interval(found)}], paired over {found.count} tasks"


def interval(score: PolicyScore) -> str:
    """Return the ends of a score's interval."""
    return NOTHING if score.low is None else f"{score.low:.3f}, {score.high:.3f}"


def bench_table(results: Sequence[PolicyResult], task: str) -> ReportTable:
    """Return the table of policies, the best first."""
    shares = (share_of_bound(result, results) for result in results)
    rows = tuple(
        (
            result.policy.label + ("*" if result.privileged else ""),
            f"{result.score.mean:.3f}",
            interval(result.score),
            f"{result.share('success'):.2f}",
            f"{result.share('collision'):.2f}",
            str(len(result.failed)),
            NOTHING if share is None else f"{share:.2f}",
            str(result.score.count),
        )
        for result, share in zip(results, shares, strict=True)
    )
    caption = (
        f"Score: {MEASURES[task]}, mean over tasks; 95 % by bootstrap over tasks. "
        "of astar: share of the upper bound's score on the same tasks."
    )
    if any(result.privileged for result in results):
        caption += " *: gets simulator-only data."
    if len({result.score.count for result in results}) > 1:
        caption += " Not every policy has run on every task: their scores do not compare."
    return ReportTable("bench", "", caption, HEADINGS, rows)


def write_scores(path: Path, results: Sequence[PolicyResult], about: dict[str, object]) -> None:
    """Write the table as JSON, each policy with its tasks' scores."""
    policies = [
        {"policy": result.policy.name, "arguments": dict(result.policy.arguments)}
        | {"score": vars(result.score)}
        | {name: result.share(name) for name in ("success", "collision")}
        | {"failed": len(result.failed), "of_astar": share_of_bound(result, results)}
        | {"tasks": dict(sorted(result.scores.items()))}
        for result in results
    ]
    write_json(path, about | {"interval": "percentile bootstrap over tasks", "policies": policies})
