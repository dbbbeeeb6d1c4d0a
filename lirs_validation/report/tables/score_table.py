"""What a result scored: on the screen beside the run's own mapper, and as JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.table import Table
from rich.text import Text

from lirs_validation.analysis.score import Score
from lirs_validation.record.formatting import NOTHING
from lirs_validation.record.metric_catalog import metrics_in
from lirs_validation.report.tables.screen import screen_table
from lirs_wct.files import atomic_write


def score_table(score: Score, record: Mapping[str, Any]) -> Table:
    """Return the metrics of the score beside those of the run's own mapper."""
    lines = [f"{score.status}: {score.reason}"] if score.reason else []
    lines.append(f"read in the {score.frame} frame")
    if score.trajectory:
        lines.append(f"{score.trajectory['poses']} of {score.given} poses lie at stamps of the run's scans")
    table = screen_table(score.run, "; ".join(lines))
    table.add_column("metric")
    for heading in ("scored", str(record["config"]["mapper"])):
        table.add_column(Text(heading), justify="right")
    for metric in metrics_in("trajectory", "map"):
        scored = metric.formatted(metric.of(asdict(score)))
        if scored != NOTHING:
            table.add_row(*map(Text, (metric.heading, scored, metric.formatted(metric.of(record)))))
    return table


def write_score(path: Path, score: Score, trajectory: Path | None, map_yaml: Path | None) -> None:
    """Write the score as JSON: sections and metrics as in record.json.

    Raises:
        OutputError: the file cannot be written.
    """
    given = {"trajectory": trajectory, "map": map_yaml}
    document = {"files": {key: None if p is None else str(p) for key, p in given.items()}} | asdict(score)
    with atomic_write(path) as temporary:
        temporary.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")
