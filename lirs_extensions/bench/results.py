"""Results of the benchmark: mean scores of policies with intervals, lines and a table of them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
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
    """A mean over tasks.

    Attributes:
        low: lower end of its 95 % interval, by the percentile bootstrap over tasks; None of one task.
        high: upper end.
    """

    mean: float
    low: float | None
    high: float | None
    count: int


def score_of(values: Sequence[float]) -> PolicyScore | None:
    """Return the mean of tasks' scores with its interval; None of no score."""
    if not values:
        return None
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
    """A policy over the chosen tasks.

    Attributes:
        score: score over its tasks.
        episodes: records by the task's name.
    """

    policy: PolicyChoice
    score: PolicyScore
    episodes: dict[str, dict[str, Any]]

    @property
    def failed(self) -> int:
        """Number of episodes in which the policy failed or that could not run."""
        return sum(entry["status"] != "ok" for entry in self.episodes.values())

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
    common = result.episodes.keys() & bound.episodes.keys()
    best = sum(bound.episodes[name]["metrics"]["score"] for name in common)
    own = sum(result.episodes[name]["metrics"]["score"] for name in common)
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
    results = []
    for policy, episodes in found.items():
        score = score_of([float(entry["metrics"]["score"]) for entry in episodes.values()])
        assert score is not None, "there is an episode"
        results.append(PolicyResult(policy=policy, score=score, episodes=episodes))
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
    pairs = [(result.episodes[name], other.episodes[name]) for name in common]
    found = score_of([a["metrics"]["score"] - b["metrics"]["score"] for a, b in pairs])
    names = f"{result.policy.label} - {other.policy.label}"
    if found is None:
        return f"{names}: no common tasks"
    return f"{names}: {found.mean:+.3f} [{interval(found)}], paired over {found.count} tasks"


def interval(score: PolicyScore) -> str:
    """Return the ends of a score's interval."""
    return NOTHING if score.low is None else f"{score.low:.3f}, {score.high:.3f}"


def bench_table(results: Sequence[PolicyResult], task: str) -> ReportTable:
    """Return the table of policies, the best first."""
    rows = tuple(_row(result, results) for result in results)
    caption = (
        f"Score: {MEASURES[task]}, mean over tasks; 95 % by bootstrap over tasks. "
        "of astar: share of the upper bound's score on the same tasks."
    )
    if any(result.privileged for result in results):
        caption += " *: gets simulator-only data."
    if len({result.score.count for result in results}) > 1:
        caption += " Not every policy has run on every task: their scores do not compare."
    return ReportTable("bench", "", caption, HEADINGS, rows)


def _row(result: PolicyResult, results: Sequence[PolicyResult]) -> tuple[str, ...]:
    share = share_of_bound(result, results)
    return (
        result.policy.label + ("*" if result.privileged else ""),
        f"{result.score.mean:.3f}",
        interval(result.score),
        *(f"{result.share(name):.2f}" for name in ("success", "collision")),
        str(result.failed),
        NOTHING if share is None else f"{share:.2f}",
        str(result.score.count),
    )


def write_scores(path: Path, results: Sequence[PolicyResult], about: dict[str, object]) -> None:
    """Write the table as JSON, each policy with its tasks' scores."""
    policies = [
        {"policy": result.policy.name, "arguments": dict(result.policy.arguments)}
        | {"score": vars(result.score)}
        | {name: result.share(name) for name in ("success", "collision")}
        | {"failed": result.failed, "of_astar": share_of_bound(result, results)}
        | {"tasks": {name: entry["metrics"]["score"] for name, entry in sorted(result.episodes.items())}}
        for result in results
    ]
    write_json(path, about | {"interval": "percentile bootstrap over tasks", "policies": policies})
