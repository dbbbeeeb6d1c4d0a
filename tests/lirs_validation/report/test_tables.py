"""Tables: as wide as the screen allows, no name broken, failures first, figures as recorded."""

import io
from dataclasses import replace
from typing import Any

import pytest
from rich.console import Console

from lirs_validation.record.metric_catalog import picture_lines
from lirs_validation.record.run_record import SUCCEEDED
from lirs_validation.report.run_tables import ended_lines, results_table, summary_table, verdict_lines
from lirs_validation.report.table import ReportTable
from tests.lirs_validation.records import entry

ENTRIES = [
    entry(world, seed, mapper=mapper, ate=ate + 0.01 * seed)
    for world in ("simple", "advanced")
    for mapper, ate in (("cartographer", 0.02), ("cartographer_original", 0.5))
    for seed in (1, 2, 3)
]


def shown(table: ReportTable, width: int = 80) -> str:
    console = Console(width=width, record=True, file=io.StringIO())
    console.print(table)
    return console.export_text()


def run(world: str = "simple", status: str = "ok", reason: str = "", **more: Any) -> dict[str, Any]:
    figures: dict[str, Any] = {
        "world": {"name": world},
        "config": {"robot": "husky", "mapper": more.get("mapper", "hector"), "seed": more.get("seed", 1)},
        "status": status,
        "reason": reason,
        "rtf": {"mean": more.get("rtf", 42.13)},
        "trajectory": {"length": 81.24, "ate_rmse": more.get("ate", 0.0312), "odometry_ate_rmse": 0.2},
        "map": {
            "f1": more.get("f1", 0.931),
            "f1_input": more.get("f1_input"),
            "iou": 0.6,
            "false_occupied": 0.012,
        },
    }
    return figures | {"verdict": {"class": "works" if status in SUCCEEDED else "not evaluated"}}


@pytest.mark.parametrize("width", [60, 80, 200])
def test_no_name_is_broken_and_hidden_columns_are_listed(width: int) -> None:
    table = replace(summary_table(ENTRIES), title="")
    text = shown(table, width)
    lines = text.splitlines()
    assert max(map(len, lines)) <= width
    names = [line.split()[:2] for line in lines if line.startswith((" simple", " advanced"))]
    assert names == [list(row[:2]) for row in table.texts()]
    head, said = " ".join(text.split("─")[0].split()), " ".join(text.split())
    for heading in table.headings[2:]:
        assert heading.split()[-1] in head or heading in said, heading
    assert ("Columns hidden (widen the terminal):" in text) == (width < 200)


def test_a_narrow_screen_keeps_text_and_two_columns_of_numbers() -> None:
    rows = (("a_name_of_30_letters_0123456789", "1", "2", "3", "works"),)
    text = shown(ReportTable("t", "", "", ("world", "a", "b", "c", "verdict"), rows, remarks=True), 40)
    assert "Columns hidden (widen the terminal): c." in " ".join(text.split())
    assert "works" in text


def test_headings_stand_in_lines_that_keep_a_unit_whole() -> None:
    headings = ("world", "99.9 % [mm]", "b - a", "odom. ATE [m]")
    text = shown(ReportTable("t", "", "", headings, (("w", "1", "2", "3"),)))
    lines = [line.split() for line in text.split("─")[0].splitlines() if line.strip()]
    assert lines == [["odom."], ["99.9", "%", "ATE"], ["world", "[mm]", "b", "-", "a", "[m]"]]


def test_failures_are_lines_that_name_the_run() -> None:
    assert ended_lines(ENTRIES) == []
    lines = ended_lines([*ENTRIES, entry("medium", 4, mapper="my[1]:Slam", status="error")])
    assert lines == ["medium, husky, my[1]:Slam, seed 4 failed: ValueError: broken"]


def test_failed_runs_come_first_with_the_reason_and_stopped_ones_have_not_failed() -> None:
    tipped = run("advanced", "tipped", "the robot tipped over at 12.0 s")
    text = shown(results_table([run(), tipped, run("medium")]))
    assert text.index("advanced") < text.index("simple") < text.index("medium")
    assert "advanced, husky, hector, seed 1 failed: the robot tipped over at 12.0 s" in " ".join(text.split())
    stopped = run("advanced", "wall limit", "stopped at the wall limit", rtf=0.00579)
    text = " ".join(shown(results_table([run(), stopped])).split())
    assert text.index("simple") < text.index("advanced")
    assert "0.00579" in text
    assert "advanced, husky, hector, seed 1: stopped at the wall limit" in text
    assert "failed" not in text


def test_the_figures_are_the_records_and_missing_ones_a_dash() -> None:
    table = results_table([run(), run("medium", f1=None, mapper="gmapping", seed=2)])
    assert table.texts() == [
        ["simple", "hector", "1", "ok", "works", "42.1", "81.2", "0.031", "0.200", "0.931", "0.012"],
        ["medium", "gmapping", "2", "ok", "works", "42.1", "81.2", "0.031", "0.200", "-", "0.012"],
    ]
    empty = {"world": {"name": "x"}, "config": {}, "status": "diverged", "reason": "", "trajectory": {}}
    empty |= {"verdict": {"class": "not evaluated"}}
    row = "| x | - | - | - | diverged | not evaluated | - | - | - | - | - | - |"
    assert row in results_table([empty, run()]).as_markdown()
    assert picture_lines(empty) == [("verdict", "not evaluated"), ("status", "diverged")]


def test_the_rtf_of_concurrent_runs_is_not_shown() -> None:
    alone, beside = run(rtf=42.0), run("medium", rtf=3.21)
    beside["rtf"]["concurrent"] = True
    table = results_table([alone, beside])
    column = table.headings.index("RTF")
    assert [row[column] for row in table.rows] == ["42.0", "-"]
    assert "1 concurrent run has no RTF here." in shown(table)
    assert "concurrent" not in shown(results_table([alone]))


def test_the_table_of_runs_fits_eighty_characters() -> None:
    assert "F1 input" not in results_table([run()]).headings
    entries = [run("simple"), run("advanced", "off world", "gone", mapper="cartographer", f1_input=0.9)]
    text = shown(results_table(entries))
    for heading in ("world", "verdict", "[m]", "ATE", "odom.", "F1", "input"):
        assert heading in text
    for figure in ("works", "not evaluated", "0.031", "0.200", "0.931"):  # those that decide
        assert figure in text
    assert {"simple", "advanced"} <= set(text.split()), "names are whole"
    assert max(len(line) for line in text.splitlines()) <= 80


def test_a_mapper_that_is_worse_than_its_odometry_is_named() -> None:
    worse = "medium, husky, hector, seed 1: worse than its odometry (ATE 0.450 m, odometry 0.200 m)"
    text = " ".join(shown(results_table([run(), run("medium", ate=0.45)])).split())
    assert worse in text
    assert text.count("worse than") == 1
    assert ("", "worse than its odometry") in picture_lines(run(ate=0.45))
    # A difference that no table shows is none.
    for ate in (0.2, 0.2004):
        assert "worse" not in shown(results_table([run(ate=ate)]))


def test_values_that_all_runs_share_stand_in_the_title() -> None:
    assert results_table([run("simple"), run("medium")]).title == "husky, hector, seed 1"
    assert results_table([run(seed=1), run(seed=2)]).title == "husky, hector"


def test_brackets_in_a_name_are_no_markup() -> None:
    assert "map[1]" in shown(results_table([run("map[1]")]))
    assert "| a\\|b |" in results_table([run("a|b")]).as_markdown()


def test_verdicts_are_counted_by_group_and_one_run_has_its_sentence() -> None:
    errors = ((1, 0.02), (2, 0.9))
    runs = [entry(seed=seed, ate=ate, attitude=a) for a in ("imu", "none") for seed, ate in errors]
    assert verdict_lines(runs) == [
        "verdict, simple, husky, hector, attitude: imu: works (1 of 2), loses its way (1 of 2)",
        "verdict, simple, husky, hector, attitude: none: works (1 of 2), loses its way (1 of 2)",
    ]
    alone = verdict_lines([runs[0], entry(mapper="gmapping", ate=0.9)])
    assert alone[0].startswith("verdict: hector on husky works on simple.")
    other = verdict_lines([runs[0], entry(attitude="none")])
    assert other[1].startswith("verdict, attitude: none: hector on husky ")
    assert alone[1].startswith("verdict: gmapping on husky loses its way on simple.")
