"""The axes of a sweep, the suites, and the engines that go with options."""

from __future__ import annotations

from itertools import groupby

import pytest

from lirs_validation.sweep.axes import Axes, Representation
from lirs_validation.sweep.collision_experiment import CollisionExperiment
from lirs_validation.sweep.engines.base import Limits
from lirs_validation.sweep.engines.factory import make_executor
from lirs_validation.sweep.engines.processes import Processes
from lirs_validation.sweep.engines.serial import Serial
from lirs_validation.sweep.slam_experiment import SlamExperiment
from lirs_validation.sweep.suites import SUITES, suite_named
from lirs_wct.errors import ConfigError


def test_every_crossing_is_a_cell_world_by_world() -> None:
    axes = Axes(
        sources=("simple", "medium"),
        robots=("husky", "jackal"),
        mappers=("hector", "gmapping", "cartographer"),
        lidars=("lms111", "utm30lx"),
        representations=(Representation(), Representation(terrain="mesh", rays="mujoco")),
        seeds=(1, 2, 3),
    )
    experiments = axes.experiments()
    assert len(experiments) == len({experiment.name for experiment in experiments}) == 2 * 2 * 3 * 2 * 2 * 3
    assert [source for source, _ in groupby(experiment.config.source for experiment in experiments)] == [
        "simple",
        "medium",
    ]


def test_drivers_are_an_axis_and_the_usual_one_changes_no_name() -> None:
    tour, frontier, replay = Axes(
        sources=("simple",), drivers=("tour", "frontier", "replay:out/a")
    ).experiments()
    assert tour.name == Axes(sources=("simple",)).experiments()[0].name == "simple-husky-hector-s1-9ee60b70"
    assert frontier.name.startswith("simple-husky-hector-frontier-s1-")
    assert replay.name.startswith("simple-husky-hector-replay-s1-")
    assert len({e.config.digest for e in (tour, frontier, replay)}) == 3


def test_numbers_of_walkers_are_an_axis() -> None:
    found = Axes(sources=("simple",), actors=(0, 5, 20), seeds=(1, 2)).experiments()
    assert [(e.config.actors, e.config.seed) for e in found] == [(n, s) for n in (0, 5, 20) for s in (1, 2)]
    assert found[0].name == "simple-husky-hector-s1-9ee60b70"


def test_numbers_of_threads_are_an_axis_of_a_suite_too() -> None:
    one, two = Axes(sources=("simple",), threads=(1, 2)).experiments()
    assert one.name == "simple-husky-hector-s1-9ee60b70"
    assert (two.config.threads, two.name == one.name) == (2, False)
    runs = SUITES["paper"].experiments(threads=(2,))
    assert {run.config.threads for run in runs if isinstance(run, SlamExperiment)} == {2}


def test_the_papers_suite_has_every_cell_of_its_tables_once() -> None:
    experiments = SUITES["paper"].experiments(seeds=(1, 2))
    runs = [experiment for experiment in experiments if isinstance(experiment, SlamExperiment)]
    assert len({experiment.name for experiment in experiments}) == len(experiments)
    for table in ("II", "III", "IV"):
        of_table = [experiment.config for experiment in runs if table in experiment.tables]
        assert {c.robot for c in of_table} == {"husky"}
        assert len({c.source for c in of_table}) == 1
        kinds = {(c.terrain, c.rays, c.mapper, c.seed) for c in of_table}
        representations = (("hfield", "ours"), ("hfield", "mujoco"), ("mesh", "mujoco"))
        mappers = ("gmapping", "hector", "cartographer")
        assert kinds == {
            (*view, mapper, seed) for view in representations for mapper in mappers for seed in (1, 2)
        }
        assert len(of_table) == len(kinds)
    robots = [experiment.config for experiment in runs if "robots" in experiment.tables]
    assert len(robots) == 3 * 3 * 3 * 2 * 2
    assert {c.robot for c in robots} == {"husky", "turtlebot2", "jackal"}
    checks = [experiment for experiment in experiments if isinstance(experiment, CollisionExperiment)]
    assert {(c.source, c.robot) for c in checks} == {
        (world, robot)
        for world in ("simple", "medium", "advanced")
        for robot in ("husky", "turtlebot2", "jackal")
    }
    assert all(experiment.config.wall_limit == SUITES["paper"].wall_limit for experiment in runs)
    assert {
        experiment.config.seconds
        for experiment in suite_named("paper").experiments(seconds=7.0)
        if isinstance(experiment, SlamExperiment)
    } == {7.0}
    with pytest.raises(ConfigError, match="unknown suite 'papr'; legal: paper"):
        suite_named("papr")


def test_options_choose_the_engine() -> None:
    assert isinstance(make_executor(None), Serial)
    assert make_executor(None, jobs=3) == Processes(jobs=3)
    alone = make_executor(None, limits=Limits(seconds=5))
    assert alone == Processes(jobs=1, limits=Limits(seconds=5))
    for wrong, message in (
        ({"engine": "serial", "jobs": 2}, "serial runs one experiment at a time, got --jobs 2"),
        ({"engine": "slurm"}, "unknown engine 'slurm'; legal: processes, ray, serial"),
        ({"engine": None, "jobs": 0}, "--jobs must be 1 or more, got 0"),
        ({"engine": "processes", "address": "x:1"}, "--address is of a Ray cluster"),
    ):
        with pytest.raises(ConfigError, match=message):
            make_executor(**wrong)  # type: ignore[arg-type]
    for limits in ({"seconds": 0.0}, {"memory": -1}, {"seconds": float("nan")}):
        with pytest.raises(ConfigError, match="must be above 0"):
            Limits(**limits)  # type: ignore[arg-type]
