"""The axes of a sweep, the suites, and the engines that go with options."""

from __future__ import annotations

from itertools import groupby

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lirs_validation.sweep.axes import Axes, View, read_seeds
from lirs_validation.sweep.collision_cell import CollisionCell
from lirs_validation.sweep.engines.base import Limits
from lirs_validation.sweep.engines.factory import make_executor
from lirs_validation.sweep.engines.processes import Processes
from lirs_validation.sweep.engines.serial import Serial
from lirs_validation.sweep.run_cell import RunCell
from lirs_validation.sweep.suites import SUITES, suite_named
from lirs_wct.errors import ConfigError


@given(st.lists(st.tuples(st.integers(0, 999), st.integers(0, 20)), min_size=1, max_size=6))
def test_seeds_are_read_as_written(ranges: list[tuple[int, int]]) -> None:
    text = ",".join(f"{a}-{a + n}" if n else f"{a}" for a, n in ranges)
    expected = [seed for a, n in ranges for seed in range(a, a + n + 1)]
    assert read_seeds(text) == tuple(dict.fromkeys(expected))


@pytest.mark.parametrize("text", ["", "a", "1-", "-3", "5-1", "1,,2", "1.5", "0-99999999999", "1-999999999"])
def test_what_is_no_list_of_seeds_is_told(text: str) -> None:
    with pytest.raises(ConfigError, match="--seeds must be a list such as"):
        read_seeds(text)


def test_every_crossing_is_a_cell_world_by_world() -> None:
    axes = Axes(
        sources=("simple", "medium"),
        robots=("husky", "jackal"),
        mappers=("hector", "gmapping", "cartographer"),
        lidars=("lms111", "utm30lx"),
        views=(View(), View(terrain="mesh", rays="mujoco")),
        seeds=(1, 2, 3),
    )
    cells = axes.cells()
    assert len(cells) == len({cell.name for cell in cells}) == 2 * 2 * 3 * 2 * 2 * 3
    assert [source for source, _ in groupby(cell.config.source for cell in cells)] == ["simple", "medium"]


def test_the_papers_suite_has_every_cell_of_its_tables_once() -> None:
    cells = SUITES["paper"].cells(seeds=(1, 2))
    runs = [cell for cell in cells if isinstance(cell, RunCell)]
    assert len({cell.name for cell in cells}) == len(cells)
    for table in ("II", "III", "IV"):
        of_table = [cell.config for cell in runs if table in cell.tables]
        assert {c.robot for c in of_table} == {"husky"}
        assert len({c.source for c in of_table}) == 1
        kinds = {(c.terrain, c.rays, c.mapper, c.seed) for c in of_table}
        views = (("hfield", "ours"), ("hfield", "mujoco"), ("mesh", "mujoco"))
        mappers = ("gmapping", "hector", "cartographer")
        assert kinds == {(*view, mapper, seed) for view in views for mapper in mappers for seed in (1, 2)}
        assert len(of_table) == len(kinds)
    robots = [cell.config for cell in runs if "robots" in cell.tables]
    assert len(robots) == 3 * 3 * 3 * 2 * 2
    assert {c.robot for c in robots} == {"husky", "turtlebot2", "jackal"}
    checks = [cell for cell in cells if isinstance(cell, CollisionCell)]
    assert {(c.source, c.robot) for c in checks} == {
        (world, robot)
        for world in ("simple", "medium", "advanced")
        for robot in ("husky", "turtlebot2", "jackal")
    }
    assert all(cell.config.wall_limit == SUITES["paper"].wall_limit for cell in runs)
    assert {
        cell.config.seconds for cell in suite_named("paper").cells(seconds=7.0) if isinstance(cell, RunCell)
    } == {7.0}
    with pytest.raises(ConfigError, match="unknown suite 'papr'; legal: paper"):
        suite_named("papr")


def test_options_choose_the_engine() -> None:
    assert isinstance(make_executor(None), Serial)
    assert make_executor(None, jobs=3) == Processes(jobs=3)
    alone = make_executor(None, limits=Limits(seconds=5))
    assert alone == Processes(jobs=1, limits=Limits(seconds=5))
    for wrong, message in (
        ({"engine": "serial", "jobs": 2}, "serial runs one cell at a time, got --jobs 2"),
        ({"engine": "slurm"}, "unknown engine 'slurm'; legal: processes, ray, serial"),
        ({"engine": None, "jobs": 0}, "--jobs must be 1 or more, got 0"),
        ({"engine": "processes", "address": "x:1"}, "--address is of a Ray cluster"),
    ):
        with pytest.raises(ConfigError, match=message):
            make_executor(**wrong)  # type: ignore[arg-type]
    for limits in ({"seconds": 0.0}, {"memory": -1}, {"seconds": float("nan")}):
        with pytest.raises(ConfigError, match="must be above 0"):
            Limits(**limits)  # type: ignore[arg-type]
