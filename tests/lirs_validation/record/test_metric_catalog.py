"""One catalog of metrics: what it holds, records hold; what is added to it, every table shows."""

import csv
import io
import json
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console
from rich.table import Table

from lirs_validation.analysis.compare import compare
from lirs_validation.analysis.results import read_results
from lirs_validation.record import metric_catalog
from lirs_validation.record.metric_catalog import (
    METRICS,
    Metric,
    metrics_named,
    metrics_selected,
    picture_lines,
)
from lirs_validation.record.run_record import record_schema
from lirs_validation.report.compare_tables import compare_table, write_comparison
from lirs_validation.report.run_report import report_of, report_page
from lirs_validation.report.run_tables import results_table
from slam_baselines.mapper import MapperStats
from tests.lirs_validation.records import entry

COUNTS = {
    "trajectory.robot_lengths",
    "rtf.simulated_seconds", "rtf.timestep", "rtf.wall_seconds", "trajectory.poses",
    "trajectory.rpe_metre.pairs", "trajectory.rpe_second.pairs", "trajectory.relations.relations",
    "map.occupied_cells", "collisions.samples", "rtf.concurrent", "rtf.extrapolated",
    "trajectory.failure.onset",
    "trajectory.failure.mapper.healthy", "trajectory.failure.watch.healthy",
}  # fmt: skip
"""Numbers of a record that are no metrics: over how much the metrics were taken."""


def numbers(node: dict[str, Any], place: str) -> Iterator[str]:
    """Yield the places of the numbers that a part of the schema describes."""
    if "$ref" in node:
        node = record_schema()["$defs"][node["$ref"].rpartition("/")[2]]
    for choice in node.get("anyOf", ()):
        yield from numbers(choice, place)
    for name, held in node.get("properties", {}).items():
        yield from numbers(held, f"{place}.{name}")
    types = node.get("type")
    if {"number", "integer", "boolean"} & set(types if isinstance(types, list) else [types]):
        yield place


def test_the_schema_describes_the_metrics_and_no_others() -> None:
    described = {
        place
        for part in ("rtf", "trajectory", "map", "collisions", "cost")
        for place in numbers(record_schema()["properties"][part], part)
    }
    described |= {f"mapper.{field.name}" for field in fields(MapperStats)}
    keys = [metric.key for metric in METRICS]
    assert len(keys) == len(set(keys))
    assert set(keys) <= described
    assert {place for place in described if not place.startswith("mapper.")} - set(keys) == COUNTS


def test_records_hold_the_metrics() -> None:
    run = entry()
    missing = {m.key for m in METRICS if m.of(run) is None}
    without_input_map = {"map.f1_input", "map.precision_input", "map.recall_input"}
    of_clouds = {m.key for m in METRICS if "_3d" in m.key or "elevation" in m.key}
    assert missing == without_input_map | of_clouds


def shown(table: Table) -> str:
    console = Console(width=160, record=True, file=io.StringIO())
    console.print(table)
    return console.export_text()


def runs_with(**values: float) -> list[dict[str, Any]]:
    runs = [entry(seed=seed) for seed in (1, 2)]
    for run in runs:
        run["map"] |= values
    return runs


def test_a_path_that_diverges_has_a_short_error() -> None:
    metric = next(m for m in METRICS if m.key == "trajectory.ate_rmse")
    assert (metric.text(6107672361173.148), metric.text(0.125)) == ("6.11e+12 m", "0.125 m")


def test_a_metric_is_added_in_one_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The table on the screen, Markdown, CSV, the report's page, comparison and picture all have it."""
    selections = ("picture", "runs", "summary", "compared", "distribution", "headline")
    new = Metric("map.blur", "blur", "map", "cm", 2, 100.0, "less", selections)
    monkeypatch.setattr(metric_catalog, "METRICS", (*METRICS, new))
    runs = runs_with(blur=0.0123)
    for run in runs:
        (tmp_path / run["name"]).mkdir()
        (tmp_path / run["name"] / "record.json").write_text(json.dumps(run))
    assert "1.23" in shown(results_table(runs))
    assert "| blur [cm] |" in results_table(runs).as_markdown()
    assert ("blur", "1.23 cm") in picture_lines(runs[0])
    report = report_of(read_results(tmp_path))
    for key in ("summary", "map", "map-runs"):
        row = next(csv.DictReader(io.StringIO(report.tables[key].as_csv())))
        assert float(row["blur [cm]"]) == pytest.approx(1.23)
        assert "blur [cm]" in report.tables[key].as_markdown()
    html = report_page(report, "lirs-wct report out")
    assert "median blur [cm]" in html
    assert html.count("blur [cm]") >= 5  # tile, summary, section by group and by run, distributions
    comparison = compare(runs, runs_with(blur=0.0100), metrics_selected("compared"))
    assert "blur [cm]" in shown(compare_table(comparison, ("a", "b")))
    write_comparison(tmp_path / "d.csv", comparison, ("a", "b"))
    write_comparison(tmp_path / "d.json", comparison, ("a", "b"))
    assert "map.blur" in (tmp_path / "d.csv").read_text()
    assert "map.blur" in (tmp_path / "d.json").read_text()
    assert metrics_named(["map.blur"]) == (new,)
