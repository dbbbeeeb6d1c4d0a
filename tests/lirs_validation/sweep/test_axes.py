"""Crossing of run options, suites, and engines by their options."""

from itertools import groupby, product
from typing import Any

import pytest

from lirs_validation.config import EngineOptions, RunConfig
from lirs_validation.sweep.engines import Processes, RayCluster
from lirs_validation.sweep.sweep import Serial
from lirs_validation.sweep.tasks import SUITES, CollisionTask, RunTask, cross, make_executor, make_suite
from lirs_wct.errors import ConfigError


def test_every_combination_is_a_run_source_by_source() -> None:
    options: dict[str, Any] = {
        "robot": ("husky", "jackal"),
        "mapper": ("hector", "gmapping", "cartographer"),
        "lidar": ("lms111", "utm30lx"),
        "terrain": ("hfield", "mesh"),
        "seed": (1, 2, 3),
    }
    configs = cross(("simple", "medium"), **options)
    assert len(configs) == len({config.digest for config in configs}) == 2 * 2 * 3 * 2 * 2 * 3
    assert [source for source, _ in groupby(config.source for config in configs)] == ["simple", "medium"]
    for name, values in options.items():
        assert {getattr(config, name) for config in configs} == set(values)


def test_the_default_of_an_axis_changes_no_digest() -> None:
    default = RunConfig(source="simple").digest
    for name, values in {
        "driver": ("tour", "frontier", "replay:out/a"),
        "actors": (0, 5, 20),
        "attitude": ("imu", "none"),
        "rays": ("builtin", "mujoco"),
        "seconds": (120, 60.0),
    }.items():
        digests = [config.digest for config in cross("simple", **{name: values})]
        assert digests[0] == default, name
        assert len(set(digests)) == len(values), name
    assert RunConfig(source="simple", seconds=12).digest == RunConfig(source="simple", seconds=12.0).digest
    assert RunConfig(source="simple", wall_limit=3.0).digest == default


def test_the_papers_suite_has_every_run_of_its_tables_once() -> None:
    experiments = make_suite("paper", seed=(1, 2))
    runs = [experiment for experiment in experiments if isinstance(experiment, RunTask)]
    assert len({experiment.name for experiment in experiments}) == len(experiments)
    kinds = {(c.source, c.robot, c.mapper, c.seed, c.terrain, c.rays) for c in (run.config for run in runs)}
    worlds, robots = ("simple", "medium", "advanced"), ("husky", "turtlebot2", "jackal")
    shared = worlds, robots, ("gmapping", "hector", "cartographer"), (1, 2)
    heightmaps = {row for row in product(*shared, ("hfield",), ("mujoco",)) if row[1] == "husky"}
    others = {*product(*shared, ("hfield",), ("builtin",)), *product(*shared, ("mesh",), ("mujoco",))}
    assert kinds == heightmaps | others
    assert len(runs) == len(kinds)
    checks = [experiment for experiment in experiments if isinstance(experiment, CollisionTask)]
    assert {(c.source, c.robot) for c in checks} == set(product(worlds, robots))
    assert all(experiment.config.wall_limit == SUITES["paper"]["wall_limit"] for experiment in runs)
    assert {e.config.seconds for e in make_suite("paper", seconds=7.0) if isinstance(e, RunTask)} == {7.0}
    with pytest.raises(ConfigError, match="unknown suite 'papr'; legal: paper, paper-short"):
        make_suite("papr")


def test_options_choose_the_engine() -> None:
    assert isinstance(make_executor(EngineOptions()), Serial)
    assert make_executor(EngineOptions(jobs=3)) == Processes(jobs=3)
    assert make_executor(EngineOptions(cell_timeout=5)) == Processes(jobs=1, seconds=5)
    assert make_executor(EngineOptions(address="local", jobs=3)) == RayCluster(address="local", jobs=3)
    for wrong, message in (
        ({"jobs": 0}, "jobs must be at least 1, got 0"),
        ({"cell_timeout": 0.0}, "cell timeout must be a finite number above 0"),
    ):
        with pytest.raises(ConfigError, match=message):
            EngineOptions(**wrong)  # type: ignore[arg-type]
