"""A mapper beside the drive, in a process or a thread: the bytes of one thread, and nothing that hangs."""

import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lirs_envs.sensing.sensors import Observation
from lirs_validation import Run, RunConfig, read_record, validate
from lirs_validation.experiment import loop
from lirs_validation.experiment.drive_log import DriveLog
from lirs_validation.experiment.evaluation import evaluate_rtf
from lirs_validation.experiment.loop import Drive, drive
from lirs_validation.experiment.mapper_process import MapperProcess
from lirs_validation.experiment.mapper_under_test import Estimate, MapperUnderTest
from lirs_validation.experiment.run import prepare
from lirs_validation.record.schema import schema_error
from lirs_validation.sweep.engines import Processes
from lirs_validation.sweep.experiment import SlamExperiment
from lirs_wct.errors import ConfigError
from lirs_wct.progress import no_progress
from tests.lirs_validation.experiment.mapper_processes import mapper_processes
from tests.lirs_validation.experiment.puppets import Puppet, SlowPuppet

TIMED = ("rtf.csv", "record.json", "overview.png", "manifest-sha256.txt")
"""Files that hold what the clock says."""


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.syspath_prepend(Path(__file__).parent)
    monkeypatch.chdir(tmp_path)
    yield
    assert not mapper_processes()


def both(**options: Any) -> tuple[Run, Run]:
    """Return the run of one thread and that of two."""
    one, two = (validate(**options, threads=n, out=f"out{n}") for n in (1, 2))
    return one, two


def untimed(made: Run) -> dict[str, Any]:
    assert made.folder is not None
    entry = read_record(made.folder)
    assert schema_error(entry) is None
    rtf = {name: entry["rtf"][name] for name in ("simulated_seconds", "extrapolated")}
    counts = {key: value for key, value in entry["mapper"].items() if not key.startswith("ms_")}
    config = {key: value for key, value in entry["config"].items() if key != "threads"}
    kept = ("world", "status", "reason", "trajectory", "map", "collisions", "seed", "versions")
    return {key: entry[key] for key in kept} | {"rtf": rtf, "mapper": counts, "config": config}


def assert_same(one: Run, two: Run) -> None:
    assert untimed(one) == untimed(two)
    assert one.folder is not None
    assert two.folder is not None
    names = {path.name for path in one.folder.iterdir()}
    assert names == {path.name for path in two.folder.iterdir()}
    for name in sorted(names.difference(TIMED)):
        assert (one.folder / name).read_bytes() == (two.folder / name).read_bytes(), name
    assert len(one.log.commands) == len(two.log.commands)
    assert len(one.record.rtf["series"]) == len(two.record.rtf["series"])


@pytest.mark.parametrize(
    "options",
    [
        {"mapper": "own_mappers:Slow", "seconds": 1},
        *(
            pytest.param({"mapper": mapper, "seconds": 2, "bag": "sqlite3", **more}, marks=pytest.mark.slow)
            for mapper, more in (
                ("cartographer", {"attitude": "none"}),
                ("own_mappers:Still", {"lidar": "vlp16"}),
            )
        ),
    ],
    ids=lambda options: options["mapper"],
)
def test_two_threads_give_the_same_bytes(
    options: dict[str, Any], room: str, monkeypatch: pytest.MonkeyPatch, plain_pictures: None
) -> None:
    monkeypatch.setattr("lirs_validation.experiment.mapper_process.needs_process", lambda mapper: False)
    one, two = both(source=room, actors=3, **options)
    assert_same(one, two)
    assert one.log.walker_beams
    assert one.record.name != two.record.name
    assert two.record.config.threads == 2
    assert (one.record.rtf["mapper_in"], two.record.rtf["mapper_in"]) == ("drive", "process")
    assert two.record.cost["peak_memory"] > one.record.cost["peak_memory"]
    for a, b in zip(one.log.clouds.clouds, two.log.clouds.clouds, strict=True):
        np.testing.assert_array_equal(a.xyz, b.xyz)


def test_the_parts_of_the_time_add_up(room: str) -> None:
    ready = prepare(RunConfig(source=room, mapper="own_mappers:Slow", seconds=2, threads=2))
    with closing(ready.mapper):
        begun = time.perf_counter()
        log = drive(ready.simulation, ready.driver, ready.mapper, 2.0)
        assert 0.9 * (time.perf_counter() - begun) < sum(log.walls) < time.perf_counter() - begun
    rtf = evaluate_rtf(log, ready.simulation)
    parts = rtf["parts"]
    assert set(parts) == {"physics", "sensors", "mapper", "waiting", "rest"}
    assert min(parts.values()) >= 0
    beside = sum(parts.values()) - parts["mapper"]
    assert beside == pytest.approx(1 / rtf["mean"])
    assert parts["waiting"] < parts["mapper"]  # it worked beside the simulation


def puppets(
    fails: str,
    threads: int,
    *,
    seconds: float = 4.0,
    finished: str = "",
    lost: tuple[float, float] = (1e9, 1e9),
    wall_limit: float | None = None,
) -> tuple[DriveLog, Puppet, SlowPuppet]:
    sim, mapper = Puppet(fails, 40, finished), SlowPuppet(0.001, lost=lost)
    made = under_test(mapper, threads)
    return drive(sim, sim, made, seconds, wall_limit=wall_limit), sim, mapper  # type: ignore[arg-type]


def assert_alike(one: tuple[DriveLog, Puppet, SlowPuppet], two: tuple[DriveLog, Puppet, SlowPuppet]) -> None:
    (log1, sim1, mapper1), (log2, sim2, mapper2) = one, two
    assert (log1.status, log1.reason) == (log2.status, log2.reason)
    assert sim1.ticks == sim2.ticks
    assert mapper1.stamps == mapper2.stamps
    for name in ("truth", "estimates", "commands"):
        assert list(getattr(log1, name)) == list(getattr(log2, name))
    np.testing.assert_array_equal(log1.stamps, log2.stamps)


class LateMapper(MapperUnderTest):
    """Mapper whose estimates come some scans later, as those of one in another process."""

    place = "process"
    follow = MapperProcess.follow  # type: ignore[assignment]
    _look_ahead, late = True, 7

    def __init__(self, mapper: Any) -> None:
        super().__init__(lambda: mapper, "late")
        self._given = list[Observation]()

    @property
    def _answered(self) -> bool:
        return len(self._given) > self.late

    def _give(self, observation: Observation) -> None:
        self._given.append(observation)

    def _answer(self) -> Estimate:
        return self.observe(self._given.pop(0))


def under_test(mapper: Any, threads: int = 2) -> MapperUnderTest:
    return LateMapper(mapper) if threads > 1 else mapper.under_test


@pytest.mark.parametrize("fails", ["tipped", "off world", "stuck", "diverged", "nothing"])
def test_a_failure_ends_both_at_the_same_tick(fails: str) -> None:
    one, two = (puppets(fails, threads) for threads in (1, 2))
    assert_alike(one, two)
    assert one[0].status == ("ok" if fails == "nothing" else fails)


@pytest.mark.parametrize(("until", "ticks"), [(1e9, 151), (5.9, 201)])
def test_a_drive_that_gets_lost_ends_at_the_same_scan(until: float, ticks: int) -> None:
    one, two = (puppets("nothing", n, seconds=8.0, lost=(1.0, until)) for n in (1, 2))
    assert_alike(one, two)
    assert (one[0].status, one[1].ticks) == ("lost", ticks)


def test_a_driver_that_is_done_early_ends_the_drive_at_the_same_scan() -> None:
    one, two = (puppets("nothing", threads, finished="it is there") for threads in (1, 2))
    assert_alike(one, two)
    assert (one[0].status, one[0].reason, one[1].ticks) == ("ok", "it is there at 1.6 s", 40)


def test_an_error_of_the_driver_comes_after_the_ticks_before_it() -> None:
    for threads in (1, 2):
        sim, mapper = Puppet("driver", 40), SlowPuppet(0.001)
        with pytest.raises(ValueError, match="a bug"):
            drive(sim, sim, under_test(mapper, threads), 4.0)  # type: ignore[arg-type]
        assert len(mapper.stamps) == 40


def test_a_simulation_that_is_ahead_stays_within_its_limit() -> None:
    sim, mapper = Puppet("nothing", 0), SlowPuppet(0.005)
    taken = Drive(sim, sim, under_test(mapper), 4.0)  # type: ignore[arg-type]
    steps = iter(taken)
    for _ in range(50):
        next(steps)
        assert sim.ticks <= len(taken.log.truth) + loop.MOST_AHEAD
    assert sim.ticks > len(taken.log.truth) + 5
    taken.look_ahead = False
    while not taken.caught_up:
        next(steps)
    assert sim.ticks == len(taken.log.truth) == len(taken.log.commands) + 1


def test_a_drive_of_two_threads_stops_at_its_wall_limit() -> None:
    log, sim, mapper = puppets("nothing", 2, wall_limit=0.05)
    assert log.status == "wall limit"
    assert sim.ticks == len(log.truth) == len(mapper.stamps) < 101
    assert f"for {sim.time:.1f} of 4 simulated seconds" in log.reason


def test_a_driver_that_waits_for_the_mapper_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"driver frontier waits .* --threads 1, got 2"):
        RunConfig(source="simple", driver="frontier", threads=2)
    with pytest.raises(ConfigError, match=r"threads must be within \[1, 2\]"):
        RunConfig(source="simple", threads=3)


def test_one_thread_is_in_no_name() -> None:
    assert RunConfig(source="simple", threads=1).digest == RunConfig(source="simple").digest
    assert RunConfig(source="simple", threads=2).digest != RunConfig(source="simple").digest


@pytest.mark.slow
def test_workers_drive_with_two_threads(room: str, tmp_path: Path) -> None:
    given = SlamExperiment(RunConfig(source=room, mapper="own_mappers:Slow", seconds=1, threads=2))
    (outcome,) = Processes(jobs=1).run([given], tmp_path, lambda name: no_progress)
    assert outcome.status == "ok"
    assert read_record(tmp_path / given.name)["rtf"]["mapper_in"] == "process"
