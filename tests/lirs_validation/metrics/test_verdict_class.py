"""Classes of verdicts: the first rule that applies decides."""

from dataclasses import replace
from typing import get_args

import pytest
from hypothesis import given, settings, strategies as st

from lirs_validation.metrics.verdict import VerdictClass, VerdictFigures, classify
from lirs_validation.record.run_record import Status

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
