"""The benchmark's scores: one line per policy, and a table of all policies."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from lirs_extensions.bench.experiment import PolicyResult, share_of_bound
from lirs_extensions.bench.scores import PolicyScore, score_of
from lirs_validation.record.metric_catalog import NOTHING
from lirs_validation.report.table import ReportTable
from lirs_wct.files import write_json

MEASURES = {
    "navigation": "success weighted by path length (SPL)",
    "mapping": "area under newly covered ground over path length",
    "traverse": "share of the distance gained",
}
"""Definition of the score by task."""
HEADINGS = ("policy", "score", "95 %", "success", "collision", "failed", "of astar", "tasks")


def score_line(result: PolicyResult, tasks: str) -> str:
    """Return a policy's score in one line that ends with `tasks`."""
    score = result.score
    ends = "" if score.low is None else f" [{interval(score)}]"
    return f"{result.policy.label}: {score.mean:.3f}{ends}, {tasks}"


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
        f"{result.successes:.2f}",
        f"{result.collisions:.2f}",
        str(result.failed),
        NOTHING if share is None else f"{share:.2f}",
        str(result.score.count),
    )


def write_scores(path: Path, results: Sequence[PolicyResult], about: dict[str, object]) -> None:
    """Write the table as JSON, each policy with its tasks' scores."""
    policies = [
        {"policy": result.policy.name, "arguments": dict(result.policy.arguments)}
        | {"score": vars(result.score), "success": result.successes, "collision": result.collisions}
        | {"failed": result.failed, "of_astar": share_of_bound(result, results)}
        | {"tasks": {name: entry["metrics"]["score"] for name, entry in sorted(result.episodes.items())}}
        for result in results
    ]
    write_json(path, about | {"interval": "percentile bootstrap over tasks", "policies": policies})
