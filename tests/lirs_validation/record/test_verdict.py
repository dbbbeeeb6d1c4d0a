"""Verdicts: rules for lost mappers, classes, sentences, and the file of limits."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import pytest
from hypothesis import given, settings, strategies as st

from lirs_validation.experiment.mapper_under_test import LostRule
from lirs_validation.record.metric_catalog import is_worse
from lirs_validation.record.run_record import Status
from lirs_validation.record.verdict import (
    VerdictClass,
    VerdictFigures,
    VerdictLimits,
    classify,
    disagreement,
    incompleteness,
    judge,
    judge_log,
    read_limits,
    stored_verdict,
)
from lirs_wct.errors import ConfigError
from tests.lirs_validation.records import entry


def losses(*runs: tuple[int, int], times: int = 1) -> list[bool]:
    """Return flags of scans: numbers of scans with the place known, and lost, in turn."""
    return [lost for known, missing in runs for lost in [False] * known + [True] * missing] * times


@pytest.mark.parametrize(
    ("flags", "period", "words"),
    [
        (losses((500, 20), (500, 0)), 0.1, ""),
        ([], 0.1, ""),
        (losses((5000, 51), (5000, 0)), 0.1, "500.0 s for 5.0 s; it did not know it during 51 of 10051"),
        (losses((5000, 50), (5000, 0)), 0.1, ""),  # 4.9 s
        (losses((5, 3), times=251), 0.1, "753 of 2008 scans (37.5 %)"),
        (losses((97, 5), times=20), 0.1, ""),
        # A scan a meter: three of them last as long as 150 of a lidar at 25 Hz.
        (losses((300, 3), (37, 0)), 3.0, ""),
        (losses((300, 10), (37, 0)), 3.0, "at 900.0 s"),
    ],
)
def test_a_mapper_is_lost_for_five_seconds_in_a_row_or_during_a_share_of_the_scans(
    flags: Iterable[bool], period: float, words: str
) -> None:
    rule = LostRule()
    for k, lost in enumerate(flags):
        rule.observe(k * period, lost)
    assert words in (rule.reason() or "")
    assert bool(rule.reason()) == bool(words)


@pytest.mark.parametrize(("coverage", "complete"), [(1.0, True), (0.95, True), (0.9499, False), (0.0, False)])
def test_a_trajectory_needs_a_pose_for_95_percent_of_the_scans(coverage: float, complete: bool) -> None:
    lacking = incompleteness(coverage)
    assert (lacking is None) == complete
    if lacking is not None:
        assert "at least 95 % are required" in lacking


def test_walls_seen_again_may_differ_by_25_centimeters() -> None:
    assert disagreement(None) is None
    assert disagreement(0.25) is None
    assert "agree only to 0.26 m" in (disagreement(0.26) or "")


@pytest.mark.parametrize(
    ("ate", "odometry", "worse"),
    [(0.1006, 0.1, True), (0.1004, 0.1, False), (0.05, 0.1, False), (None, 0.1, False), (0.1, None, False)],
)
def test_an_error_is_worse_when_it_is_visibly_larger(
    ate: float | None, odometry: float | None, worse: bool
) -> None:
    assert is_worse(ate, odometry) == worse


GOOD = VerdictFigures(
    status="ok",
    robot_lengths=30.0,
    error=0.02,
    odometry_error=0.3,
    distance=40.0,
    occupied=900,
    f1_aligned=0.97,
    false_occupied=0.01,
    reference_false_occupied=0.0,
)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, "works"),
        ({"status": "wall limit"}, "works"),
        ({"status": "error"}, "failed"),
        ({"status": "timeout", "error": None}, "failed"),
        ({"status": "incomplete"}, "failed"),
        ({"error": None, "status": "lost"}, "no reference"),
        ({"status": "diverged"}, "not evaluated"),
        ({"status": "tipped"}, "not evaluated"),
        ({"status": "diverged", "error": None, "has_reference": True}, "not evaluated"),
        ({"status": "tipped", "uses_estimate": True}, "loses its way"),
        ({"robot_lengths": 9.9}, "not evaluated"),
        ({"robot_lengths": 9.9, "status": "lost"}, "not evaluated"),
        ({"status": "lost"}, "loses its way"),
        ({"error": 0.381}, "loses its way"),
        ({"error": 0.379}, "adds nothing"),
        ({"error": 0.269}, "works"),
        ({"error": 0.226, "f1_aligned": 0.79}, "adds nothing"),
        ({"error": 0.224, "f1_aligned": 0.79}, "path only"),
        ({"error": 0.031, "odometry_error": 0.04, "f1_aligned": 0.79}, "adds nothing"),
        ({"error": 0.04, "odometry_error": 0.03}, "works"),
        ({"occupied": 0}, "adds nothing"),
        ({"occupied": None}, "works"),
        ({"f1_aligned": 0.79}, "path only"),
        ({"false_occupied": 0.11}, "path only"),
        ({"false_occupied": 0.11, "reference_false_occupied": 0.05}, "works"),
        ({"odometry_error": None, "error": 0.81}, "loses its way"),
        ({"odometry_error": None, "error": 0.79}, "works"),
        ({"f1_aligned": None, "false_occupied": None}, "works"),
        ({"f1_aligned": None, "elevation_rmse": 0.11, "reference_elevation_rmse": 0.0}, "path only"),
        ({"occupied": None, "elevation_rmse": 0.11, "reference_elevation_rmse": 0.05}, "works"),
        ({"elevation_seen": 0.79}, "path only"),
        ({"elevation_seen": 0.81}, "works"),
        ({"false_occupied": 0.5, "reference_false_occupied": None}, "works"),
    ],
)
def test_the_first_rule_that_applies_decides(changes: dict[str, object], expected: str) -> None:
    kind, reasons = classify(replace(GOOD, **changes))
    assert kind == expected
    assert bool(reasons) == (kind != "works")


number = st.none() | st.floats(0, 5)


@settings(max_examples=200)
@given(
    st.builds(
        VerdictFigures,
        status=st.sampled_from(get_args(Status)),
        uses_estimate=st.booleans(),
        robot_lengths=st.none() | st.floats(0, 100),
        error=number,
        odometry_error=number,
        distance=st.none() | st.floats(0, 100),
        occupied=st.none() | st.integers(0, 9),
        f1_aligned=st.none() | st.floats(0, 1),
        false_occupied=st.none() | st.floats(0, 1),
        elevation_seen=st.none() | st.floats(0, 1),
    )
)
def test_every_result_has_one_class_and_a_reason_unless_it_works(figures: VerdictFigures) -> None:
    kind, reasons = classify(figures)
    assert kind in get_args(VerdictClass)
    assert (kind == "works") == (not reasons)
    if figures.error is not None and kind in ("works", "path only", "adds nothing"):
        assert figures.status in ("ok", "wall limit")
    if kind == "path only" and None not in (figures.error, figures.odometry_error):
        assert figures.error <= 0.75 * figures.odometry_error  # type: ignore[operator]


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
        "Its path error is 0.205 m after 31.0 m, the odometry's 0.205 m. Its map has no occupied cells. "
        "Evaluated on a window of 50 m of 16 km. "
        "The source's samples are 62 m apart: they do not resolve a robot of 0.64 m."
    )
    assert [reason.figure for reason in verdict.reasons] == ["occupied cells", "trajectory error"]


@pytest.mark.parametrize(
    ("error", "onset", "delay", "false", "words"),
    [
        (0.9, 12.0, None, 0, " It did not notice. "),
        (0.9, 12.0, 3.14, 0, " It said so after 3.1 s. "),
        (0.9, 12.0, -1.2, 1, " It said so 1.2 s before. It reported itself lost once without being lost. "),
        (0.1, None, None, 4, " It reported itself lost 4 times without being lost. "),
        (0.9, None, None, 0, ""),
    ],
)
def test_the_sentence_says_whether_a_loss_was_reported(
    error: float, onset: float | None, delay: float | None, false: int, words: str
) -> None:
    failure = {"onset": onset, "mapper": {"delay": delay, "false": false}}
    verdict = judge(ENTRY | {"trajectory": ENTRY["trajectory"] | {"ate_rmse": error, "failure": failure}})
    assert words in verdict.sentence
    assert ("notice" in verdict.sentence or "said so" in verdict.sentence) == (onset is not None)


def test_the_sentence_names_an_alarm_of_the_watch_that_the_method_missed() -> None:
    failure = {"onset": 12.0, "mapper": {"delay": None, "false": 0}, "watch": {"delay": -1.12, "false": 3}}
    lost = ENTRY | {"trajectory": ENTRY["trajectory"] | {"ate_rmse": 0.9, "failure": failure}}
    words = "It did not notice. The watch on its poses gave an alarm 1.1 s before."
    assert words in judge(lost).sentence
    failure["mapper"]["delay"] = 2.0
    assert "watch" not in judge(lost).sentence


PAIR = {"f1": 0.67, "f1_aligned": 0.94, "false_occupied_aligned": 0.13, "reference_false_occupied": 0.0}


@pytest.mark.parametrize(
    ("figures", "sentence"),
    [
        (PAIR, "Its map is not usable: 94 % of the walls agree, 13 % are false."),
        (PAIR | {"reference_false_occupied": None}, "Its map is as good as its scans allow: 94 %"),
        (PAIR | {"reference_false_occupied": 0.04}, "Its map is as good as its scans allow: 94 %"),
        (PAIR | {"false_occupied_aligned": 0.004}, "right: 94 % of the walls agree, 0 % are false."),
        (PAIR | {"f1_aligned": 0.55}, "Its map is not usable: 55 % of the walls agree, 13 % are false."),
        (PAIR | {"false_occupied_aligned": None}, "Its map is right: 94 % of the walls agree."),
        (PAIR | {"f1_aligned": None, "false_occupied_aligned": None}, "The map was not evaluated."),
        (PAIR | {"occupied_cells": 0}, "Its map has no occupied cells."),
        ({"elevation_rmse_aligned": 0.034, "reference_elevation_rmse": 0.01, "elevation_seen": 0.952},
         "Its elevation map is right: its error is 0.034 m, 95 % of the visible ground is seen."),
        ({"elevation_seen": 0.6}, "Its elevation map is not usable: 60 % of the visible ground is seen."),
        ({"elevation_rmse_aligned": 0.3, "reference_elevation_rmse": 0.29, "elevation_seen": 0.9},
         "Its elevation map is as good as its scans allow: its error is 0.300 m, 90 %"),
        ({"elevation_seen": 0.9}, "The map was not evaluated."),
        ({}, "The map was not evaluated."),
    ],
)  # fmt: skip
def test_the_sentence_on_the_map_states_the_figures_that_decide(
    figures: dict[str, Any], sentence: str
) -> None:
    verdict = judge(ENTRY | {"map": figures, "trajectory": ENTRY["trajectory"] | {"ate_rmse": 0.02}})
    assert sentence in verdict.sentence
    if verdict.kind in ("works", "path only"):
        assert ("not usable" in verdict.sentence) == (verdict.kind == "path only")


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
    assert (verdict.kind, verdict.conclusion) == ("no reference", "doubtful")
    assert "hector's map of hall is doubtful: contradicts itself." in verdict.sentence


def test_limits_are_read(tmp_path: Path) -> None:
    path = tmp_path / "limits.yaml"
    path.write_text("f1_aligned: 0.9\naccept: [path only]\n")
    assert read_limits(path) == (VerdictLimits(f1_aligned=0.9), frozenset({"path only"}))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("f2: 1\n", "unknown limit 'f2'; legal: robot_lengths"),
        ("f1_aligned: high\n", "f1_aligned must be within [0, 1e9], got 'high'"),
        ("drift: 1" + 400 * "0" + "\n", "drift must be within [0, 1e9]"),
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


SECOND = {"mapper": "hector", "command": "lirs-wct map hall.clf --mapper hector"}


@pytest.mark.parametrize(
    ("own", "other", "gap", "conclusion", "words"),
    [
        (0.25, 0.25, 10.0, "probably right", "its walls agree to 0.25 m, hector's to 0.25 m"),
        (0.16, 0.34, 1.0, "probably right", "its walls agree to 0.16 m, hector's only to 0.34 m"),
        (0.2, 0.1699, 1.0, "probably right", f"{SECOND['command']} may give the better path"),
        (0.251, 0.26, 1.0, "doubtful", "its walls agree only to 0.25 m, hector's only to 0.26 m"),
        (0.34, 0.16, 1.0, "doubtful", f"{SECOND['command']} may give the better path"),
        (None, None, 1.0, "cannot be checked", "it passes no place twice"),
        (None, 0.2, 1.0, "doubtful", "it passes no place twice, hector's walls agree to 0.20 m"),
        (None, 0.3, 1.0, "cannot be checked", "hector's walls agree only to 0.30 m"),
        (0.16, 0.16, 10.1, "cannot be checked", "10 m of its path are without a scan"),
    ],
)
def test_a_log_without_truth_has_a_conclusion_and_its_reason(
    own: float | None, other: float | None, gap: float, conclusion: str, words: str
) -> None:
    log = {"name": "hall", "status": "ok", "reason": "", "config": {"mapper": "gmapping"}, "log": {}}
    second = SECOND | {"revisit_residual": other, "difference": 0.04}
    quality = {"revisit_residual": own, "pass_residual": 0.1, "longest_gap": gap, "second": second}
    verdict = judge_log(log | {"quality": quality})
    assert verdict.conclusion == verdict.to_dict()["conclusion"] == conclusion
    assert verdict.sentence.startswith("gmapping's map of hall ")
    assert f"{conclusion}: " in verdict.sentence
    assert words in verdict.sentence
    assert "the two paths differ by 0.04 m" in verdict.sentence
    better = other is not None and other < 0.85 * (own or 0.25)
    assert (SECOND["command"] in verdict.sentence) == better


def test_scans_that_are_not_level_leave_a_log_unchecked() -> None:
    log = {"name": "hall", "status": "ok", "reason": "", "config": {"mapper": "hector"}, "log": {}}
    verdict = judge_log(log | {"quality": {"second": None}})
    assert verdict.conclusion == "cannot be checked"
    assert "it has no level planar scans" in verdict.sentence
    unfit = judge_log(log | {"quality": {"revisit_residual": 0.1}, "log": {"unfit": "odometry jumps"}})
    assert (unfit.conclusion, "not fit" in unfit.sentence) == ("doubtful", True)


def test_a_record_holds_its_verdict_and_other_limits_judge_it_again() -> None:
    made = entry(f1=0.85)
    assert stored_verdict(made) == judge(made)
    assert stored_verdict(made | {"status": "lost"}).kind == "works"
    assert stored_verdict(made, VerdictLimits(f1_aligned=0.9)).kind == "path only"
