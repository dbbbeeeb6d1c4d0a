"""Verdicts of methods as published and with attitude, by world, and the sentence that follows."""

from collections.abc import Sequence

import pytest

from lirs_validation.analysis.as_published import (
    MethodOutcome,
    attitude_pairs,
    conclusion,
    outcome_of,
    published_pairs,
)
from lirs_validation.metrics.verdict import VerdictClass
from lirs_validation.record.formatting import Entry
from lirs_validation.record.verdict import Verdict
from lirs_validation.report.run_tables import method_tables
from lirs_validation.report.table import MetricSpread
from tests.lirs_validation.records import entry


def outcome(
    works: int, *, runs: int = 5, other: VerdictClass = "loses its way", ate: float | None = 0.1
) -> MethodOutcome:
    kinds = ("works",) * works + (other,) * (runs - works)
    return MethodOutcome(verdicts=tuple(Verdict(kind, "") for kind in kinds), ate=ate)


def runs(mapper: str, ates: Sequence[float], world: str = "medium", **more: str) -> list[Entry]:
    return [entry(world, seed, mapper=mapper, ate=ate, **more) for seed, ate in enumerate(ates, start=1)]


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
    kinds = [verdict.kind for verdict in found.verdicts]
    assert kinds == ["works", "loses its way", "works", "loses its way", "failed", "failed"]
    assert found.ate == 0.1


@pytest.mark.parametrize(
    ("works", "of", "shared"),
    [(5, 5, "works"), (4, 5, "works"), (3, 5, None), (2, 5, None), (1, 5, "loses its way"), (1, 1, "works"),
     (1, 2, None), (0, 0, None)],
)  # fmt: skip
def test_four_of_five_runs_decide(works: int, of: int, shared: str | None) -> None:
    assert outcome(works, runs=of).shared == shared


@pytest.mark.parametrize(
    ("planar", "aware", "sentence"),
    [
        (outcome(0), outcome(5), "As published: loses its way. With attitude: works."),
        (outcome(3), outcome(5), "As published: mixed. With attitude: works."),
        (
            outcome(0),
            outcome(5, other="failed", runs=7),
            "As published: loses its way. With attitude: mixed.",
        ),
        (outcome(0), outcome(1), "Loses its way, as published and with attitude."),
        (
            outcome(5, ate=0.3),
            outcome(5),
            "Works as published and with attitude; 3.0 times as accurate with attitude.",
        ),
        (
            outcome(5),
            outcome(5, ate=0.2),
            "Works as published and with attitude; 2.0 times less accurate with attitude.",
        ),
        (outcome(5, ate=0.11), outcome(4), "Works as published and with attitude."),
    ],
)
def test_the_sentence_says_what_follows(planar: MethodOutcome, aware: MethodOutcome, sentence: str) -> None:
    assert conclusion(planar, aware, "as published") == sentence


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
        "world", "mapper", "as published", "verdicts as published", "with attitude", "verdicts with attitude",
        "odometry", "what follows",
    )  # fmt: skip
    assert table.texts()[0] == [
        "medium", "hector", "2.000 ± 0.000‡", "loses its way (5 of 5)", "0.020 ± 0.000", "works (5 of 5)",
        "0.200 ± 0.000",
        "As published: loses its way. With attitude: works.",
    ]  # fmt: skip


def test_the_odometry_is_counted_once_a_seed() -> None:
    (table,) = method_tables([*runs("hector", [0.02] * 2), *runs("hector_original", [2.0] * 3)])
    spread = table.rows[0][table.headings.index("odometry")]
    assert isinstance(spread, MetricSpread)
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
    assert without.texts()[0][-1] == "Without attitude: loses its way. With attitude: works."


def test_an_original_that_ran_without_attitude_alone_is_the_original_still() -> None:
    entries = [*runs("hector", [0.02]), *runs("hector_original", [2.0], attitude="none")]
    assert [(pair.how, len(pair.planar)) for pair in published_pairs(entries)] == [("as published", 1)]
