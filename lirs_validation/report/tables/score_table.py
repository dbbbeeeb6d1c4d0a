"""What a result scored: on the screen beside the run's own mapper, and as JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from lirs_validation.analysis.score import Score
from lirs_validation.record.metric_catalog import metrics_in
from lirs_validation.record.odometry import WORSE, worse_than_odometry
from lirs_validation.report.tables.screen import FittedTable
from lirs_validation.report.tables.table import ReportTable
from lirs_wct.files import atomic_write


def score_table(score: Score, record: Mapping[str, Any]) -> FittedTable:
    """Return the metrics of the score and of the run's own mapper; below, which is worse than odometry."""
    lines = [f"{score.status}: {score.reason}"] if score.reason else []
    lines.append(f"read in the {score.frame} frame")
    if score.trajectory:
        lines.append(f"{score.trajectory['poses']} of {score.given} poses lie at stamps of the run's scans")
    mapper = str(record["config"]["mapper"])
    entries = {"scored": asdict(score), mapper: record}
    worse = [f"{name}: {WORSE}" for name, entry in entries.items() if worse_than_odometry(entry)]
    rows = [
        (metric.heading, *(metric.formatted(metric.of(entry)) for entry in entries.values()))
        for metric in metrics_in("trajectory", "map")
        if metric.of(entries["scored"]) is not None
    ]
    caption = "\n".join(("; ".join(lines), *worse))
    return FittedTable(ReportTable("score", "", caption, ("metric", *entries), tuple(rows)), title=score.run)


def write_score(path: Path, score: Score, trajectory: Path | None, map_yaml: Path | None) -> None:
    """Write the score as JSON: sections and metrics as in record.json.

    Raises:
        OutputError: the file cannot be written.
    """
    given = {"trajectory": trajectory, "map": map_yaml}
    document = {"files": {key: None if p is None else str(p) for key, p in given.items()}} | asdict(score)
    with atomic_write(path) as temporary:
        temporary.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")
