"""Sentence of a verdict, counts of several, and the file of limits."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from lirs_validation.metrics.verdict import VerdictFigures, VerdictLimits, classify
from lirs_validation.record.verdict import judge, judge_log, read_limits
from lirs_wct.errors import ConfigError

ENTRY: dict[str, Any] = {
    "config": {"mapper": "gmapping", "robot": "jackal", "driver": "tour"},
    "world": {
        "name": "quarry",
        "robot_length": 0.64,
        "window": [0, 0, 50.0],
        "whole_size": [16000, 16000],
        "sample_spacing": 62.0,
    },
    "status": "ok",
    "reason": "",
    "trajectory": {"ate_rmse": 0.205, "odometry_ate_rmse": 0.205, "length": 31.0, "robot_lengths": 48.0},
    "map": {"occupied_cells": 0, "f1_aligned": None},
    "scans": {"beams": 541, "range_max": 20.0, "returns_median": 0.0, "walls_median": 0.0},
}


def test_the_sentence_names_cause_errors_map_and_evaluated_part() -> None:
    verdict = judge(ENTRY)
    assert verdict.kind == "adds nothing"
    assert verdict.sentence == (
        "gmapping on jackal adds nothing to the odometry on quarry: "
        "at least half of its scans see nothing within 20 m. "
        "Its path error is 0.205 m after 31 m, the odometry's 0.205 m. Its map has no occupied cells. "
        "Evaluated on a window of 50 m of 16 km. "
        "The source's samples are 62 m apart: they do not resolve a robot of 0.64 m."
    )
    assert [reason.figure for reason in verdict.reasons] == ["occupied cells", "trajectory error"]


def test_an_error_above_the_odometrys_is_said() -> None:
    trajectory = ENTRY["trajectory"] | {"ate_rmse": 0.22}
    assert "worse than the odometry's 0.205 m" in judge(ENTRY | {"trajectory": trajectory}).sentence


def test_the_figures_of_the_map_are_those_after_alignment() -> None:
    map_figures = {"f1": 0.67, "f1_aligned": 0.94, "false_occupied_aligned": 0.13, "occupied_cells": 9}
    sentence = judge(ENTRY | {"map": map_figures | {"reference_false_occupied": 0.01}}).sentence
    assert (
        "After alignment, its map agrees with the true one by F1 0.94; "
        "13 % of its occupied cells are false (1 % at the true poses)."
    ) in sentence


def test_a_short_drive_says_what_is_needed() -> None:
    trajectory = ENTRY["trajectory"] | {"robot_lengths": 3.0, "length": 1.9}
    verdict = judge(ENTRY | {"trajectory": trajectory})
    assert verdict.kind == "not evaluated"
    assert "drove 1.9 m, at least 6.4 m are needed" in verdict.sentence


def test_the_end_of_an_ok_drive_is_no_cause() -> None:
    trajectory = ENTRY["trajectory"] | {"robot_lengths": 3.0, "length": 1.9}
    ended = ENTRY | {"reason": "the last waypoint is reached at 13.5 s", "trajectory": trajectory}
    assert judge(ended).sentence.startswith("gmapping on jackal was not evaluated on quarry: it drove 1.9 m")
    lost = judge(ended | {"status": "lost", "trajectory": ENTRY["trajectory"]})
    assert lost.sentence.startswith("gmapping on jackal loses its way on quarry: the last waypoint is")


def test_a_log_without_truth_has_no_reference_but_says_that_it_is_lost() -> None:
    accuracy = {"relations": None, "reference": None}
    config = {"mapper": "hector"}
    entry = {"config": config, "name": "hall", "status": "lost", "reason": "contradicts itself"}
    entry |= {"accuracy": accuracy, "map": {"occupied": 3}, "trajectory": {"length": 9.0}, "log": {}}
    verdict = judge_log(entry)
    assert verdict.kind == "no reference"
    assert "The mapper is lost: contradicts itself." in verdict.sentence


def test_a_short_drive_uses_the_given_limit() -> None:
    trajectory = ENTRY["trajectory"] | {"robot_lengths": 48.0, "length": 31.0}
    verdict = judge(ENTRY | {"trajectory": trajectory}, VerdictLimits(robot_lengths=100))
    assert "drove 31.0 m, at least 64.0 m are needed" in verdict.sentence


def test_limits_are_read(tmp_path: Path) -> None:
    path = tmp_path / "limits.yaml"
    path.write_text("f1_aligned: 0.9\naccept: [path only]\n")
    assert read_limits(path) == (VerdictLimits(f1_aligned=0.9), frozenset({"path only"}))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("f2: 1\n", "unknown limit 'f2'; legal: robot_lengths"),
        ("f1_aligned: high\n", "f1_aligned must be a finite number, at least 0, got 'high'"),
        ("drift: 1" + 400 * "0" + "\n", "drift must be a finite number"),
        ("accept: [failed]\n", "accept must be a list of no reference, path only"),
        ("[1]\n", "must have fields"),
        ("a: [\n", "cannot be read as YAML"),
        pytest.param("[" * 5000, "cannot be read as YAML", marks=pytest.mark.slow),
    ],
)
def test_unusable_limits_are_one_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "limits.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        read_limits(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_client_that_drives_into_a_dead_end_loses_its_way() -> None:
    stuck = ENTRY | {"status": "stuck", "reason": "did not move"}
    by_hand = stuck | {"config": ENTRY["config"] | {"driver": "manual"}}
    by_client = stuck | {"config": ENTRY["config"] | {"driver": "client"}}
    assert (judge(by_hand).kind, judge(by_client).kind) == ("not evaluated", "loses its way")


def test_a_share_of_false_cells_decides_only_next_to_that_of_the_true_poses() -> None:
    figures = VerdictFigures(status="ok", error=0.01, odometry_error=1.0, false_occupied=0.5)
    assert classify(figures)[0] == "works"
    assert classify(replace(figures, reference_false_occupied=0.1))[0] == "path only"


def test_a_log_of_one_pass_states_its_walls_and_what_they_do_not_tell() -> None:
    log = {"name": "hall", "status": "ok", "reason": "", "config": {"mapper": "hector"}, "log": {}}
    sentence = judge_log(log | {"quality": {"revisit_residual": None, "wall_thickness": 0.021}}).sentence
    assert "No place is seen by two passes, so that its path cannot be checked" in sentence
    assert "walls are 0.021 m thick" in sentence
