"""Tables on the screen: as wide as it allows, no name broken, what is left out is said."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from lirs_validation.report.tables.run_tables import failure_lines, method_tables, summary_table
from lirs_validation.report.tables.table import FittedTable, ReportTable
from tests.lirs_validation.records import entry

ENTRIES = [
    entry(world, seed, mapper=mapper, ate=ate + 0.01 * seed)
    for world in ("simple", "advanced")
    for mapper, ate in (("cartographer", 0.02), ("cartographer_original", 0.5))
    for seed in (1, 2, 3)
]


def shown(table: FittedTable, width: int) -> str:
    console = Console(width=width, record=True, file=io.StringIO())
    console.print(table)
    return console.export_text()


@pytest.mark.parametrize("width", [60, 80, 100, 200])
def test_no_name_is_broken_and_what_is_left_out_is_said(width: int) -> None:
    table = summary_table(ENTRIES)
    text = shown(FittedTable(table), width)
    lines = text.splitlines()
    assert max(map(len, lines)) <= width
    assert [line.split()[:2] for line in lines if line.startswith((" simple", " advanced"))] == [
        ["simple", "cartographer"],
        ["simple", "cartographer_original"],
        ["advanced", "cartographer"],
        ["advanced", "cartographer_original"],
    ]
    head = " ".join(text.split("─")[0].split())
    said = " ".join(text.split())
    for heading in table.headings[2:]:
        last = heading.split()[-1]
        assert last in head or f"{heading}" in said, heading
    assert ("Columns hidden (widen the terminal):" in text) == (width < 200)
    assert ("±" in text.split("Mean over")[0]) == (width == 200)


def test_metrics_that_the_table_of_runs_leaves_out_go_first() -> None:
    text = shown(FittedTable(summary_table(ENTRIES)), 80)
    note = " ".join(text.split("Columns hidden (widen the terminal): ")[1].split())
    assert note.startswith("intervals (±), false occupied, aligned, IoU, F1 aligned")
    assert "ATE" in text.split("─")[0]
    assert "odometry" in text.split("─")[0]


def test_remarks_stand_below_with_the_names_of_their_rows() -> None:
    (table,) = method_tables(ENTRIES)
    text = " ".join(shown(FittedTable(table), 80).split())
    assert "simple, cartographer: As published it loses its way here; with attitude it holds." in text
    assert "what follows" not in text


def test_a_screen_too_narrow_for_names_breaks_them_and_shows_two_columns_of_numbers() -> None:
    table = ReportTable(
        "t", "", "", ("world", "a", "b", "c"), (("a_name_of_30_letters_0123456789", "1", "2", "3"),)
    )
    text = shown(FittedTable(table), 20)
    assert max(map(len, text.splitlines())) <= 20
    assert "Columns hidden (widen the terminal): c." in " ".join(text.split())


def test_headings_stand_in_lines_that_keep_a_unit_whole() -> None:
    table = ReportTable(
        "t", "", "", ("world", "99.9 % [mm]", "b - a", "odom. ATE [m]"), (("w", "1", "2", "3"),)
    )
    lines = [
        line.split() for line in shown(FittedTable(table), 80).split("─")[0].splitlines() if line.strip()
    ]
    assert lines == [["odom."], ["99.9", "%", "ATE"], ["world", "[mm]", "b", "-", "a", "[m]"]]


def test_failures_are_lines_that_name_the_run() -> None:
    assert failure_lines(ENTRIES) == []
    lines = failure_lines([*ENTRIES, entry("medium", 4, mapper="my[1]:Slam", status="error")])
    assert lines == [
        "medium, husky, my[1]:Slam, seed 4 failed: error: ValueError: broken",
        "1 of 13 runs failed; they are in no mean below.",
    ]
