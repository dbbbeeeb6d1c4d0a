"""Records of every status fit the shipped schema; damaged ones are named, and skipped."""

import json
import math
from dataclasses import fields
from pathlib import Path
from typing import Any, get_args

import jsonschema
import pytest

from lirs_validation.analysis.results import read_results, read_run
from lirs_validation.collision.validation import CollisionVerdict
from lirs_validation.config import RunConfig
from lirs_validation.record.run_record import Status, record_schema, schema_error
from lirs_wct.errors import SourceError
from tests.lirs_validation.records import entry, saved


def test_the_schema_is_one() -> None:
    jsonschema.Draft202012Validator.check_schema(record_schema())


@pytest.mark.parametrize("status", get_args(Status))
def test_every_status_fits(status: Status) -> None:
    made = entry(status=status)
    assert schema_error(made) is None
    jsonschema.validate(made, record_schema())


def test_the_schema_knows_every_option_of_a_run() -> None:
    held = record_schema()["$defs"]["config"]
    assert set(held["properties"]) == set(vars(RunConfig(source="simple")))
    assert set(held["required"]) == set(held["properties"])


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        ("rtf.mean", "fast", "rtf.mean: 'fast' is not of type 'number'"),
        ("rtf.mean", math.nan, "not finite"),
        ("rtf.series", [1.0, None], "rtf.series.1: None is not of type 'number'"),
        ("map.f1", 1.5, "map.f1: 1.5 is greater than the maximum of 1"),
        ("status", "fine", "status: 'fine' is not one of"),
        ("config.terrain", "sand", "config.terrain: 'sand' is not one of"),
        ("cost", {}, "cost: "),
        ("trajectory.relations", {}, "trajectory.relations"),
        ("world", [], "world: [] is not of type 'object'"),
    ],
)
def test_what_does_not_fit_is_named(place: str, value: Any, message: str) -> None:
    made = entry()
    *path, last = place.split(".")
    at = made
    for part in path:
        at = at[part]
    at[last] = value
    error = schema_error(made)
    assert error is not None
    assert message in error


def test_damaged_folders_are_named_and_skipped(tmp_path: Path) -> None:
    for seed in (1, 2):
        saved(tmp_path, seed=seed)
    saved(tmp_path, seed=3, status="error")
    for name, text in {
        "cut": entry(seed=9).__repr__()[:200],
        "old": json.dumps({"schema": 1}),
        "odd": json.dumps(entry(seed=8) | {"rtf": {"mean": "fast"}}),
        "list": "[]",
    }.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "record.json").write_text(text)
    (tmp_path / ".half").mkdir()
    (tmp_path / ".half" / "record.json").write_text("{")
    (tmp_path / "notes").mkdir()
    (tmp_path / "sweep.json").write_text("{")
    results = read_results(tmp_path)
    assert [run.entry["seed"] for run in results.runs] == [1, 2, 3]
    skipped = dict(results.skipped)
    assert set(skipped) == {"cut", "old", "odd", "list", "sweep.json"}
    assert "schema 1" in skipped["old"]
    assert "rtf" in skipped["odd"]
    assert results.manifest is None


def verdict(**more: Any) -> dict[str, Any]:
    numbers = {f.name: 0.5 for f in fields(CollisionVerdict)}
    words = {"world": "simple", "robot": "husky", "terrain": "hfield", "diverged": ""}
    return numbers | words | more


def test_collision_checks_are_read_or_named(tmp_path: Path) -> None:
    saved(tmp_path)
    for name, held in {"good": [verdict()], "odd": [verdict(force_peak="much")], "none": []}.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "cell.json").write_text(json.dumps({"status": "ok", "reason": ""}))
        (tmp_path / name / "collisions.json").write_text(json.dumps({"collisions": held}))
    (tmp_path / "failed").mkdir()
    (tmp_path / "failed" / "cell.json").write_text(json.dumps({"status": "error", "reason": "it broke"}))
    (tmp_path / "sweep.json").write_text(json.dumps({"cells": 3}))
    results = read_results(tmp_path)
    assert len(results.collisions) == 1
    assert results.broken == (("failed", "it broke"),)
    skipped = dict(results.skipped)
    assert set(skipped) == {"odd", "none", "sweep.json"}
    assert "force_peak is 'much'" in skipped["odd"]


def test_one_run_is_a_result_too(tmp_path: Path) -> None:
    folder = saved(tmp_path)
    assert [run.folder for run in read_results(folder).runs] == [folder]
    assert read_run(folder).entry["seed"] == 1


def test_nothing_to_read_is_said(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match="no such folder"):
        read_results(tmp_path / "none")
    with pytest.raises(SourceError, match="holds no readable record"):
        read_results(tmp_path)
