"""The table of runs: failures first, figures as recorded, fit for a narrow terminal."""

from __future__ import annotations

import io
from typing import Any

import pytest
from rich.console import Console

from lirs_validation.record.metric_catalog import picture_lines
from lirs_validation.report.tables.run_tables import markdown_table, results_table


def entry(world: str = "simple", status: str = "ok", reason: str = "", **more: Any) -> dict[str, Any]:
    return {
        "world": {"name": world},
        "config": {"robot": "husky", "mapper": more.get("mapper", "hector"), "seed": more.get("seed", 1)},
        "status": status,
        "reason": reason,
        "rtf": {"mean": 42.13},
        "trajectory": {"length": 81.24, "ate_rmse": more.get("ate", 0.0312), "odometry_ate_rmse": 0.2},
        "map": {
            "f1": more.get("f1", 0.931),
            "f1_input": more.get("f1_input"),
            "iou": 0.6,
            "false_occupied": 0.012,
        },
    }


def shown(*entries: dict[str, Any], width: int = 80) -> str:
    console = Console(width=width, record=True, file=io.StringIO())
    console.print(results_table(entries))
    return console.export_text()


def test_failures_come_first_and_say_why() -> None:
    text = shown(entry(), entry("advanced", "tipped", "the robot tipped over at 12.0 s"), entry("medium"))
    assert text.index("advanced") < text.index("simple") < text.index("medium")
    assert "advanced, husky, hector, seed 1 failed: the robot tipped over at 12.0 s" in " ".join(text.split())
    markdown = markdown_table([entry(), entry("advanced", "tipped", "it fell")])
    assert markdown.index("| advanced") < markdown.index("| simple")
    assert "failed: it fell" in markdown


def test_a_drive_that_its_wall_limit_stopped_has_not_failed() -> None:
    stopped = entry("advanced", "wall limit", "stopped at the wall limit") | {"rtf": {"mean": 0.00579}}
    text = " ".join(shown(entry(), stopped).split())
    assert text.index("simple") < text.index("advanced")
    assert "0.00579" in text
    assert "advanced, husky, hector, seed 1: stopped at the wall limit" in text
    assert "failed" not in text


def test_the_figures_are_the_records() -> None:
    line = next(k for k in markdown_table([entry()]).splitlines() if "simple" in k)
    assert [c.strip() for c in line.strip("|").split("|")] == [
        "simple", "husky", "hector", "1", "ok", "42.1", "81.2", "0.031", "0.200", "0.931", "0.012",
    ]  # fmt: skip


def test_what_does_not_exist_is_a_dash_and_never_a_number() -> None:
    line = next(k for k in markdown_table([entry(f1=None)]).splitlines() if "simple" in k)
    assert line.split("|")[10].strip() == "-"
    empty = {"world": {"name": "x"}, "config": {}, "status": "diverged", "reason": "", "trajectory": {}}
    assert "| x | - | - | - | diverged | - | - | - | - | - | - |" in markdown_table([empty])
    assert picture_lines(empty) == [("status", "diverged")]


def test_an_input_map_adds_its_column() -> None:
    assert "F1 input" not in markdown_table([entry()])
    assert "F1 input" in markdown_table([entry(), entry("depot", f1_input=0.87)])


@pytest.mark.parametrize("mapper", ["hector", "cartographer"])
def test_it_fits_eighty_characters(mapper: str) -> None:
    text = shown(entry("simple"), entry("advanced", "off world", "gone", mapper=mapper, f1_input=0.9))
    for heading in ("world", "RTF", "driven", "[m]", "ATE", "odom.", "F1", "occ."):
        assert heading in text
    assert "0.012" in text  # the last column is still there
    assert {"simple", "advanced"} <= set(text.split()), "names are whole"
    assert max(len(line) for line in text.splitlines()) <= 80


def test_a_mapper_that_is_worse_than_its_odometry_is_told() -> None:
    worse = "medium, husky, hector, seed 1: worse than its odometry (ATE 0.450 m, odometry 0.200 m)"
    text = " ".join(shown(entry(), entry("medium", ate=0.45)).split())
    assert worse in text
    assert text.count("worse than") == 1
    assert worse in markdown_table([entry("medium", ate=0.45)])
    assert ("", "worse than its odometry") in picture_lines(entry(ate=0.45))
    # What no table shows is no difference.
    for ate in (0.2, 0.2004):
        assert "worse" not in shown(entry(ate=ate))


def test_what_all_runs_share_stands_above() -> None:
    same = shown(entry("simple"), entry("medium"))
    assert "husky, hector, seed 1" in same
    seeds = shown(entry(seed=1), entry(seed=2))
    assert "husky, hector" in seeds
    assert "seed 1" not in seeds


def test_brackets_in_a_name_are_no_markup() -> None:
    assert "map[1]" in shown(entry("map[1]"))
    assert "| a\\|b |" in markdown_table([entry("a|b")])
