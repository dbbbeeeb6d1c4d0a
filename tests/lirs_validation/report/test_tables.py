"""Tables: as wide as the screen allows, no name broken, failures first, figures as recorded."""

import io
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings, strategies as st
from rich.console import Console

from lirs_validation.record.metric_catalog import metric_lines, picture_lines
from lirs_validation.record.run_record import SUCCEEDED
from lirs_validation.record.verdict import judge
from lirs_validation.report.run_tables import (
    ended_lines,
    results_table,
    summary_table,
    verdict_lines,
    verdicts_by_method,
)
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
            "f1": 0.5,
            "f1_aligned": more.get("f1", 0.931),
            "f1_input": 0.4,
            "iou": 0.6,
            "false_occupied": 0.3,
            "false_occupied_aligned": 0.012,
        },
    }
    return figures | {"verdict": {"class": "works" if status in SUCCEEDED else "not evaluated"}}


@pytest.mark.parametrize("width", [64, 80, 200])
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


@pytest.mark.parametrize("width", [70, 95, 120])
def test_no_cell_is_broken_at_any_width(width: int) -> None:
    table = replace(summary_table(ENTRIES), title="", caption="")
    lines = shown(table, width).splitlines()
    assert [line.split()[:2] for line in lines if line.startswith((" simple", " advanced"))] == [
        list(row[:2]) for row in table.texts()
    ]


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
        ["simple", "hector", "1", "ok", "works", "81.2", "0.031", "0.200", "93", "1", "42.1"],
        ["medium", "gmapping", "2", "ok", "works", "81.2", "0.031", "0.200", "-", "1", "42.1"],
    ]
    empty = {"world": {"name": "x"}, "config": {}, "status": "diverged", "reason": "", "trajectory": {}}
    empty |= {"verdict": {"class": "not evaluated"}}
    row = "| x | - | - | - | diverged | not evaluated | - | - | - | - | - | - |"
    assert row in results_table([empty, run()]).as_markdown()
    assert picture_lines(empty) == [("verdict", "not evaluated"), ("status", "diverged")]


def test_the_rtf_of_concurrent_runs_is_not_shown() -> None:
    alone, beside = run(rtf=42.0), run("medium", rtf=3.21)
    beside["rtf"] |= {"concurrent": True, "load_average": 1.2}
    table = results_table([alone, beside])
    column = table.headings.index("RTF")
    assert [row[column] for row in table.rows] == ["42.0", "-"]
    assert table.caption == "RTF of 1 run not given: other runs used the processor."
    none = results_table([beside] * 2)
    assert none.caption == "RTF not given: other runs used the processor."
    assert "RTF" not in none.headings
    loaded = run("medium") | {"machine": {"cores": 4}}
    loaded["rtf"]["load_average"] = 4.1
    assert results_table([loaded]).caption == "RTF not given: other programs used the processor."
    mixed = "RTF of 3 runs not given: other programs and other runs used the processor."
    assert results_table([beside, alone, loaded, loaded]).caption == mixed
    assert results_table([alone]).caption == ""
    assert results_table([loaded | {"machine": {"cores": 5}}]).caption == ""


def test_the_table_of_runs_fits_eighty_characters() -> None:
    entries = [run("simple"), run("advanced", "off world", "gone", mapper="cartographer")]
    text = shown(results_table(entries))
    for heading in ("world", "verdict", "[m]", "ATE", "odom.", "walls", "agree", "false"):
        assert heading in text
    for figure in ("works", "not evaluated", "0.031", "0.200", "93"):  # those that decide
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
    assert results_table([run(seed=1), run(seed=2)]).title == "simple, husky, hector"


def test_brackets_in_a_name_are_no_markup() -> None:
    assert "map[1]" in shown(results_table([run("map[1]")]))
    assert "| a\\|b |" in results_table([run("a|b"), run()]).as_markdown()


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


def test_the_sentence_of_several_runs_names_its_seed_and_their_spread() -> None:
    runs = [entry(seed=seed, ate=ate) for seed, ate in ((1, 0.02), (2, 0.03), (3, 0.9))]
    (row,) = verdicts_by_method([*runs, entry(seed=4, status="error")]).texts()
    assert row[-1].startswith(
        "In 3 of 4 drives the path error is between 0.020 and 0.900 m after 24.0 m. "
        "Seed 3: hector on husky loses its way on simple."
    )
    (row,) = verdicts_by_method(runs[:1]).texts()
    assert row[-1] == judge(runs[0]).sentence


def test_verdicts_of_many_groups_are_counted_by_mapper() -> None:
    worlds = [f"world{i}" for i in range(7)]
    runs = [entry(world, mapper=mapper) for world in worlds for mapper in ("hector", "gmapping")]
    lost = entry("maze", mapper="gmapping", ate=0.9)
    assert verdict_lines([*runs, lost]) == [
        "verdict, hector: works (7 of 7)",
        "verdict, gmapping: works (7 of 8), loses its way (1 of 8)",
    ]


STATED = {
    "driven [m]": r"(?: after|it drove) (\S+) m",
    "ATE [m]": r"path error is (\S+) m",
    "odom. ATE [m]": r"the odometry's (\S+) m",
    "walls agree [%]": r"(\S+) % of the walls agree",
    "walls false [%]": r"(\S+) % are false",
    "elevation error [m]": r"its error is (\S+) m",
    "ground seen [%]": r"(\S+) % of the visible ground",
    "delay, own [s]": r"said so after (\S+) s",
    "false alarms, own": r"reported itself lost (\S+) times",
}
"""Headings of figures in a sentence."""
share, meters = st.none() | st.floats(0, 1), st.floats(0, 2)


def assert_table_has_the_figures_of_the_sentence(made: dict[str, Any]) -> None:
    """Compare the numbers of a sentence with table, summary, picture and page."""
    table, summary, sentence = results_table([made]), summary_table([made]), judge(made).sentence
    cells = dict(zip(table.headings, table.texts()[0], strict=True))
    means = dict(zip(summary.headings, summary.texts()[0], strict=True))
    listed, paged = (dict(metric_lines(made, place)) for place in ("picture", "headline"))
    rest = re.sub(r"at least \S+ m are needed", "", sentence)  # a limit
    for heading, pattern in STATED.items():
        for text in re.findall(pattern, sentence):
            name, _, unit = heading.removesuffix("]").partition(" [")
            assert cells[heading] == text
            if made["status"] == "ok" and not name.endswith("own"):
                assert means[heading.replace("odom. ATE", "ATE of odometry")].rstrip("‡") == text
            if name.startswith(("walls", "elevation", "ground")):
                assert listed[name] == paged[name] == f"{text} {unit}"
        rest = re.sub(pattern, "", rest)
    assert not re.search(r"\d", rest), rest


@settings(max_examples=25, deadline=None)
@given(
    st.fixed_dictionaries({"ate_rmse": meters, "odometry_ate_rmse": st.none() | meters}),
    st.floats(0, 5000),
    st.fixed_dictionaries(
        dict.fromkeys(("f1_aligned", "false_occupied_aligned", "reference_false_occupied"), share)
    )
    | st.fixed_dictionaries(
        {"f1_aligned": st.none(), "elevation_rmse_aligned": st.none() | meters, "elevation_seen": share}
    ),
    st.sampled_from(("ok", "lost", "wall limit")),
)
def test_every_number_of_the_sentence_stands_in_the_table(
    errors: dict[str, Any], length: float, scores: dict[str, Any], status: Any
) -> None:
    made = entry(status=status)
    made["trajectory"] |= errors | {"length": length}
    made["map"] = {"occupied_cells": 9} | scores
    made["reason"] = ""
    assert_table_has_the_figures_of_the_sentence(made)


def test_every_number_of_recorded_sentences_stands_in_the_table(recorded_results: Path) -> None:
    records = [json.loads(path.read_text()) for path in recorded_results.rglob("record.json")]
    runs = [record for record in records if "rtf" in record]
    assert len(runs) >= 3
    for run in runs:
        assert_table_has_the_figures_of_the_sentence(run)
