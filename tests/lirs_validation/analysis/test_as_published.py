"""Who holds where: a method as published, with attitude, odometry alone; and the sentence that follows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import pytest

from lirs_validation.analysis.as_published import (
    SLACK,
    TIMES,
    MethodOutcome,
    attitude_pairs,
    conclusion,
    holds,
    outcome_of,
    published_pairs,
)
from lirs_validation.record.formatting import Entry
from lirs_validation.report.run_tables import method_tables
from lirs_validation.report.table import MetricSpread
from tests.lirs_validation.records import entry

ODOMETRY = 0.2
"""ATE of the odometry in the records, meters."""
LIMIT = TIMES * ODOMETRY + SLACK


def outcome(held: int, *, runs: int = 5, lost: int = 0, ate: float | None = 0.1) -> MethodOutcome:
    return MethodOutcome(runs=runs, held=held, lost=lost, ate=ate)


def runs(mapper: str, ates: Sequence[float], world: str = "medium", **more: str) -> list[Entry]:
    return [entry(world, seed, mapper=mapper, ate=ate, **more) for seed, ate in enumerate(ates, start=1)]


@pytest.mark.parametrize(("ate", "held"), [(LIMIT - 1e-9, True), (LIMIT + 1e-9, False)])
def test_a_run_holds_up_to_the_limit(ate: float, held: bool) -> None:
    assert holds(entry(ate=ate)) is held


def test_a_run_that_failed_does_not_hold_however_small_its_error() -> None:
    assert not holds(entry(ate=0.01, status="lost"))
    assert not holds(entry(status="error"))


def test_ends_of_the_drive_are_not_counted_and_those_of_the_mapper_are() -> None:
    found = outcome_of(
        [
            *runs("hector", [0.1, 0.3, 0.02]),
            *(entry(status=status, ate=0.01) for status in ("tipped", "stuck", "off world", "diverged")),
            entry(status="lost", ate=0.01),
            entry(status="error"),
            entry(status="timeout"),
        ]
    )
    assert found == MethodOutcome(runs=6, held=2, lost=1, ate=0.1, odometry=0.2)


@pytest.mark.parametrize(
    ("held", "of", "holds", "loses"),
    [(5, 5, True, False), (4, 5, True, False), (3, 5, False, False), (2, 5, False, False),
     (1, 5, False, True), (0, 5, False, True), (1, 1, True, False), (0, 1, False, True),
     (1, 2, False, False), (0, 0, False, False)],
)  # fmt: skip
def test_four_of_five_runs_decide(held: int, of: int, holds: bool, loses: bool) -> None:
    found = outcome(held, runs=of)
    assert (found.holds, found.loses) == (holds, loses)


@pytest.mark.parametrize(
    ("planar", "aware", "sentence"),
    [
        (outcome(0), outcome(5), "As published it loses its way here; with attitude it holds."),
        (outcome(3), outcome(5), "As published it holds in 3 of 5 runs here; with attitude it holds."),
        (outcome(5), outcome(1), "As published it holds here; with attitude it loses its way."),
        (
            outcome(5),
            outcome(0, lost=5, ate=None),
            "As published it holds here; with attitude it loses its way and says so.",
        ),
        (
            outcome(1, lost=4),
            outcome(5),
            "As published it loses its way here and says so; with attitude it holds.",
        ),
        (
            outcome(0),
            outcome(1),
            "It loses its way here, as published and with attitude: odometry alone is as good or better.",
        ),
        (
            outcome(0),
            outcome(0, lost=5, ate=None),
            "As published it loses its way here, with attitude it loses its way and says so: odometry alone "
            "is as good or better.",
        ),
        (
            outcome(5, ate=0.3),
            outcome(5, ate=0.1),
            "As published it holds here, and with attitude it is 3.0 times as accurate.",
        ),
        (
            outcome(5, ate=0.1),
            outcome(5, ate=0.2),
            "As published it holds here, and is 2.0 times as accurate as with attitude.",
        ),
        (outcome(5, ate=0.11), outcome(4), "As published it holds here, as well as with attitude."),
        (
            outcome(0, runs=0),
            outcome(5),
            "As published it has no run that counts here; with attitude it holds.",
        ),
    ],
)
def test_the_sentence_says_what_follows(planar: MethodOutcome, aware: MethodOutcome, sentence: str) -> None:
    assert conclusion(planar, aware, "as published") == sentence


@pytest.mark.parametrize(("odometry", "told"), [(0.1, True), (0.14, True), (0.16, False)])
def test_a_method_that_only_follows_its_odometry_is_said_to(odometry: float, told: bool) -> None:
    """Where it finds no walls its ATE is the odometry's: it holds, and nothing is gained."""
    sentence = conclusion(outcome(0), replace(outcome(5, ate=0.1), odometry=odometry), "as published")
    said = "; with attitude it holds, but is not clearly more accurate than its odometry."
    assert sentence.endswith(said) == told


def test_methods_are_paired_with_their_originals_world_by_world() -> None:
    entries = [
        *runs("hector", [0.02] * 5),
        *runs("hector_original", [2.0] * 5),
        *runs("gmapping", [0.02] * 5),
        *runs("hector", [0.02] * 5, "simple"),
        *runs("my_slam:Slam", [0.02], "simple"),
        *runs("my_slam:Slam_original", [0.3], "simple"),
        *runs("cartographer_original", [0.3]),
    ]
    pairs = published_pairs(entries)
    assert [(p.group["world"], p.group["mapper"], len(p.planar), len(p.aware)) for p in pairs] == [
        ("medium", "hector", 5, 5),
        ("simple", "my_slam:Slam", 1, 1),
    ]
    assert attitude_pairs(entries) == ()
    (table,) = method_tables(entries)
    assert table.headings == (
        "world", "mapper", "as published", "holds as published", "with attitude", "holds with attitude",
        "odometry", "what follows",
    )  # fmt: skip
    assert table.texts()[0] == [
        "medium", "hector", "2.000 ± 0.000‡", "0 of 5", "0.020 ± 0.000", "5 of 5", "0.200 ± 0.000",
        "As published it loses its way here; with attitude it holds.",
    ]  # fmt: skip


def test_a_method_without_a_reference_says_so() -> None:
    (hector,) = method_tables([*runs("hector", [0.02]), *runs("hector_original", [2.0])])
    assert "never compared" not in hector.caption
    (cartographer,) = method_tables([*runs("cartographer", [0.02]), *runs("cartographer_original", [2.0])])
    assert "cartographer_original was never compared with runs of its original." in cartographer.caption


def test_the_odometry_is_counted_once_a_seed() -> None:
    (table,) = method_tables([*runs("hector", [0.02] * 2), *runs("hector_original", [2.0] * 3)])
    spread = table.rows[0][table.headings.index("odometry")]
    assert isinstance(spread, MetricSpread)
    assert spread.values is not None
    assert spread.values.count == 3


def test_mappers_are_paired_with_themselves_without_attitude() -> None:
    entries = [
        *runs("my_slam:Slam", [0.02] * 3),
        *runs("my_slam:Slam", [2.0] * 3, attitude="none"),
        *runs("hector_original", [2.0] * 3),
        *runs("hector_original", [2.0] * 3, attitude="none"),
        *runs("hector", [0.1] * 3),
    ]
    assert [(pair.group["mapper"], pair.how) for pair in attitude_pairs(entries)] == [
        ("my_slam:Slam", "without attitude")
    ]
    assert [(p.group["mapper"], len(p.planar)) for p in published_pairs(entries)] == [("hector", 3)]
    published, without = method_tables(entries)
    assert [published.key, without.key] == ["as-published", "without-attitude"]
    assert without.texts()[0][-1] == "Without attitude it loses its way here; with attitude it holds."


def test_an_original_that_ran_without_attitude_alone_is_the_original_still() -> None:
    entries = [*runs("hector", [0.02]), *runs("hector_original", [2.0], attitude="none")]
    assert [(pair.how, len(pair.planar)) for pair in published_pairs(entries)] == [("as published", 1)]
