"""Tables of two compared results, and of a scored one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from itertools import groupby
from pathlib import Path
from typing import Any

from lirs_validation.analysis.compare import LEVEL, Comparison, Difference
from lirs_validation.analysis.score import Score
from lirs_validation.record.metric_catalog import NOTHING, WORSE, metrics_in, worse_than_odometry
from lirs_validation.record.run_record import FIELDS, distinguishing_fields, succeeded
from lirs_validation.record.verdict import Verdict
from lirs_validation.report.table import ReportTable
from lirs_wct.files import write_csv, write_json

HEADINGS = ("metric", "a", "b", "b - a", "95 %", "n", "p", "verdict")
"""Headings of the table on the screen: means, difference, interval, pairs, corrected p."""


def compare_table(comparison: Comparison, names: tuple[str, str]) -> ReportTable:
    """Return the differences by group, significant ones bold, with a caption."""
    differences = comparison.differences
    shown = distinguishing_fields(d.group for d in differences)
    rows: list[tuple[str, ...]] = []
    styles: list[str] = []
    for group, same_group in groupby(differences, key=lambda d: d.group):
        rows.append((group.label(shown), *[""] * (len(HEADINGS) - 1)))
        styles.append("italic")
        for d in same_group:
            text = (replace(d.metric, digits=1) if d.metric.digits == 0 else d.metric).formatted
            interval = NOTHING if d.low is None else f"{text(d.low)} .. {text(d.high)}"
            p = "<0.001" if d.p_corrected is not None else NOTHING
            p = f"{d.p_corrected:.3f}" if (d.p_corrected or 0) >= 0.001 else p
            n = str(d.pairs) if d.pairs == d.seeds else f"{d.pairs} of {d.seeds}"
            means = text(d.a), text(d.b), text(d.difference)
            rows.append((f"  {d.metric.heading}", *means, interval, n, p, verdict(d)))
            styles.append("bold" if d.significant else "")
    title, caption = f"a = {names[0]}, b = {names[1]}", reading(comparison)
    return ReportTable("compare", title, caption, HEADINGS, tuple(rows), remarks=True, styles=tuple(styles))


def verdict(d: Difference) -> str:
    """Return the verdict on a difference in one or two words."""
    if not d.metric.tested:
        return "not tested"
    if d.significant is None:
        return "one seed"
    if not d.significant:
        return "not shown"
    if d.metric.better is None:
        return "significant"
    return "b better" if (d.difference > 0) == (d.metric.better == "more") else "b worse"


def reading(comparison: Comparison) -> str:
    """Return the caption: tests, groups without a partner, failed runs."""
    tests = sum(d.p is not None for d in comparison.differences)
    lines = []
    if any(d.pairs == 1 and d.metric.tested for d in comparison.differences):
        lines.append("One common seed: no confidence interval. Run more seeds: --seed 1-5.")
    if tests:
        significant = sum(d.significant is True for d in comparison.differences)
        lines.append(
            f"{significant} of {tests} tested differences are statistically significant: paired by seed, "
            f"95 % intervals of the mean difference, two-sided p below {LEVEL} after Holm's correction for "
            f"{tests} tests."
        )
    used = sorted({d.test for d in comparison.differences if d.test in ("Wilcoxon", "sign")})
    if used:
        lines.append(f"Tests beside the paired t: {', '.join(used)}.")
    shown = distinguishing_fields((*comparison.common, *comparison.only_a, *comparison.only_b))
    for name, groups in (("a", comparison.only_a), ("b", comparison.only_b)):
        if groups:
            lines.append(f"Only in {name}: {'; '.join(group.label(shown) for group in groups)}.")
    failed, worse = [], []
    for group, (a, b) in comparison.common.items():
        good = [sum(map(succeeded, runs)) for runs in (a, b)]
        if good != [len(a), len(b)]:
            counts = f"{len(a) - good[0]} of {len(a)} runs failed in a, {len(b) - good[1]} of {len(b)} in b"
            failed.append(f"{group.label(shown)}: {counts}; their seeds are left out.")
        bad = [sum(map(worse_than_odometry, runs)) for runs in (a, b)]
        if any(bad):
            counts = f"{bad[0]} of {len(a)} runs of a, {bad[1]} of {len(b)} of b"
            worse.append(f"{group.label(shown)}: {WORSE} in {counts}.")
    return "\n".join((*lines, *failed, *worse))


def write_comparison(path: Path, comparison: Comparison, names: tuple[str, str]) -> None:
    """Write the differences as CSV or as JSON, by the file's suffix."""
    kept = ("a", "b", "difference", "low", "high", "pairs", "seeds", "test", "p", "p_corrected")
    rows = [
        asdict(d.group)
        | {"figure": d.metric.key, "unit": d.metric.unit}
        | {key: getattr(d, key) for key in kept}
        | {"real": d.significant, "verdict": verdict(d)}
        for d in comparison.differences
    ]
    if path.suffix == ".csv":
        write_csv(path, rows, without_rows=FIELDS)
        return
    only = {f"only_{x}": [*map(asdict, getattr(comparison, f"only_{x}"))] for x in "ab"}
    write_json(path, {"a": names[0], "b": names[1], "differences": rows, **only})


def score_table(score: Score, record: Mapping[str, Any]) -> ReportTable:
    """Return the metrics of the score and of the run's own mapper."""
    lines = [f"{score.status}: {score.reason}"] if score.reason else []
    lines.append("moved to the best fit" if score.frame == "align" else f"read in the {score.frame} frame")
    if score.time_offset:
        lines.append(f"time offset {score.time_offset:.3f} s")
    if score.trajectory:
        lines.append(f"{score.trajectory['poses']} scans have a pose, {score.given} poses were given")
    mapper = str(record["config"]["mapper"])
    entries = {"scored": asdict(score), mapper: record}
    worse = [f"{name}: {WORSE}" for name, entry in entries.items() if worse_than_odometry(entry)]
    rows = [
        (metric.heading, *(metric.formatted(metric.of(entry)) for entry in entries.values()))
        for metric in metrics_in("trajectory", "map")
        if metric.of(entries["scored"]) is not None
    ]
    caption = "\n".join(("; ".join(lines), *worse))
    return ReportTable("score", score.run, caption, ("metric", *entries), tuple(rows))


def write_score(
    path: Path, score: Score, verdict: Verdict | None, trajectory: Path | None, map_yaml: Path | None
) -> None:
    """Write the score as JSON: sections, metrics and verdict as in record.json."""
    files = {"trajectory": trajectory and str(trajectory), "map": map_yaml and str(map_yaml)}
    judged = None if verdict is None else verdict.to_dict()
    write_json(path, {"files": files} | asdict(score) | {"verdict": judged})
