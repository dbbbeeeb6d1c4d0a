"""The time that a sweep still needs, against sweeps whose times are known."""

from dataclasses import dataclass

import pytest

from lirs_validation.config import RunConfig
from lirs_validation.sweep.sweep import SweepTask, TimeLeft
from lirs_validation.sweep.tasks import CollisionTask, RunTask, make_suite

OVERHEAD, RTF = 3.0, {"hfield builtin": 8.0, "mesh mujoco": 0.9, "hfield mujoco": 0.01}
"""A machine several times as slow as the one of the typical times, and not equally so."""
FACTOR = {"jackal": 2.0, "gmapping": 1.5, "advanced": 1.4}


@dataclass
class Clock:
    now: float = 0.0

    def __call__(self) -> float:
        return self.now


def actual(task: SweepTask) -> float:
    """Seconds of a task on the slow machine."""
    if not isinstance(task, RunTask):
        return 20.0
    c = task.config
    drive = c.seconds / RTF[f"{c.terrain} {c.rays}"]
    for name in (c.robot, c.mapper, c.source):
        drive *= FACTOR.get(name, 1.0)
    return OVERHEAD + min(drive, c.wall_limit or drive)


def estimates(tasks: list[SweepTask], compile_seconds: float = 0.0) -> list[tuple[float, float]]:
    """Estimated and true time left after each end; the first three tasks compile, too."""
    clock = Clock()
    left, pairs = TimeLeft(tasks, clock), []
    for number, task in enumerate(tasks):
        compilation = compile_seconds if number < 3 else 0.0
        left.begin(task.name)
        clock.now += compilation + actual(task)
        left.end(task.name, compilation)
        estimate = left.seconds()
        assert estimate is not None
        pairs.append((estimate, sum(map(actual, tasks[number + 1 :]))))
    return pairs


@pytest.mark.parametrize("first", [0, 36])
def test_the_papers_suite_is_estimated_from_its_first_runs(first: int) -> None:
    tasks = list(make_suite("paper-short"))[first:]
    pairs = estimates(tasks, compile_seconds=90.0)
    assert all(true / 1.5 <= estimate <= true * 1.5 for estimate, true in pairs[6:])
    assert pairs[-1] == (0.0, 0.0)


def test_unknown_costs_are_learned() -> None:
    """Of a mapper of your own nothing is known before a run has ended; on a cluster, begins are not told."""
    for told in (True, False):
        clock = Clock()
        tasks = [RunTask(RunConfig(source="simple", mapper="own:Slow", seed=seed)) for seed in (1, 2, 3)]
        left = TimeLeft(tasks, clock)
        assert left.seconds() is None
        if told:
            left.begin(tasks[0].name)
        clock.now = 100.0
        left.end(tasks[0].name, 30.0)
        assert left.seconds() == pytest.approx(2 * 70.0)
        left.begin(tasks[1].name)
        clock.now = 150.0
        assert left.seconds() == pytest.approx(20.0 + 70.0)


def test_tasks_that_run_at_a_time_share_the_time() -> None:
    tasks = [CollisionTask(source="simple", robot="husky", seed=seed) for seed in range(8)]
    serial, parallel = TimeLeft(tasks).seconds(), TimeLeft(tasks).seconds(jobs=2)
    assert serial is not None
    assert parallel == pytest.approx(serial / 2)
