"""Verdicts of methods as published and with attitude, by world."""

from collections.abc import Sequence

from lirs_validation.record.metric_catalog import Entry
from lirs_validation.report.run_tables import method_tables
from lirs_validation.report.table import MetricSpread
from tests.lirs_validation.records import entry


def runs(mapper: str, ates: Sequence[float], world: str = "medium", **more: str) -> list[Entry]:
    return [entry(world, seed, mapper=mapper, ate=ate, **more) for seed, ate in enumerate(ates, start=1)]


def test_ends_of_the_drive_are_not_counted_and_those_of_the_mapper_are() -> None:
    original = [
        *runs("hector_original", [0.1, 0.3, 0.02]),
        *(entry("medium", mapper="hector_original", status=s, ate=0.01) for s in ("tipped", "stuck")),
        *(entry("medium", mapper="hector_original", status=s, ate=0.01) for s in ("off world", "diverged")),
        *(entry("medium", mapper="hector_original", status=s) for s in ("lost", "error", "timeout")),
    ]
    (table,) = method_tables([*original, *runs("hector", [0.02])])
    verdicts = table.texts()[0][table.headings.index("verdicts as published")]
    assert verdicts == "works (2 of 6), loses its way (2 of 6), failed (2 of 6)"


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
    (table,) = method_tables(entries)
    assert table.texts()[1] == [
        "simple", "my_slam:Slam", "0.300‡", "loses its way", "0.020", "works", "0.200"
    ]  # fmt: skip
    assert table.headings == (
        "world", "mapper", "as published", "verdicts as published", "with attitude", "verdicts with attitude",
        "odometry",
    )  # fmt: skip
    assert table.texts()[0] == [
        "medium", "hector", "2.000 ± 0.000‡", "loses its way (5 of 5)", "0.020 ± 0.000", "works (5 of 5)",
        "0.200 ± 0.000",
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
    published, without = method_tables(entries)
    assert [published.key, without.key] == ["as-published", "without-attitude"]
    assert [row[1] for row in published.texts()] == ["hector"]
    assert [row[1:4:2] for row in without.texts()] == [["my_slam:Slam", "loses its way (3 of 3)"]]


def test_an_original_that_ran_without_attitude_alone_is_the_original_still() -> None:
    entries = [*runs("hector", [0.02]), *runs("hector_original", [2.0], attitude="none")]
    (table,) = method_tables(entries)
    assert len(table.rows) == 1
