"""One validation run, as in the paper's experiment: build the world, drive, map, evaluate, write."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from contextlib import ExitStack, closing
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lirs_envs.robots.robot import make_robot
from lirs_envs.simulation import Simulation
from lirs_validation.config import STAND, RunConfig, driver_parts
from lirs_validation.driving.choice import make_driver
from lirs_validation.driving.driver import Driver, StandingDriver
from lirs_validation.driving.replay import COMMANDS
from lirs_validation.experiment.cost import CostMeter, compile_timer, is_shared, load_average
from lirs_validation.experiment.drive_log import DriveLog
from lirs_validation.experiment.evaluation import (
    Maps,
    evaluate,
    evaluate_maps,
    evaluate_scans,
    evaluate_status,
    evaluate_trajectory,
)
from lirs_validation.experiment.loop import drive
from lirs_validation.experiment.mapper_loading import warm_up_mapper
from lirs_validation.experiment.mapper_process import start_mapper
from lirs_validation.experiment.mapper_under_test import MapperUnderTest, check_sensors
from lirs_validation.experiment.recording import Recording, recording
from lirs_validation.experiment.scenario import Scenario, ScenarioCache
from lirs_validation.metrics.elevation import ELEVATION, write_elevation
from lirs_validation.record.run_record import RunRecord
from lirs_validation.record.verdict import Verdict
from lirs_wct import BuildOptions, ConfigError, SimulationError, World
from lirs_wct.files import atomic_folder, check_writable
from lirs_wct.formats.carmen.writer import write_log
from lirs_wct.formats.drive_csv import Commands, write_commands, write_imu
from lirs_wct.formats.map_server import write_map
from lirs_wct.formats.tum import write_tum
from lirs_wct.option import check_names
from lirs_wct.progress import Progress, no_progress

if TYPE_CHECKING:
    from lirs_wct.drawing.canvas import Drawing

WARM_UP = 2.0
"""Simulated seconds of the drive."""
BRIEF = 0.2
"""The same where MuJoCo's rays meet its height field: there a scan alone may take seconds."""
_WARM: set[tuple[str | None, ...]] = set()
"""Kinds of drives that this process has warmed up."""


@dataclass(frozen=True)
class Run:
    """Result of a run: record, log of the drive, maps, world."""

    record: RunRecord
    log: DriveLog
    maps: Maps
    world: World
    folder: Path | None

    @property
    def verdict(self) -> Verdict:
        """Class, sentence and reasons of the result."""
        return self.record.verdict

    def write(self, folder: Path, bag: Sequence[Path] = (), *, drawn: bool = True) -> None:
        """Write the run's folder, its record last; an older folder is replaced.

        The files of a bag are moved into it; the overview picture is left out unless it is `drawn`.

        Raises:
            OutputError: the folder cannot be written.
        """
        record, log, maps = self.record, self.log, self.maps
        truth, estimate, odometry = log.trajectories()
        period = record.rtf["simulated_seconds"] / len(log.walls)
        with atomic_folder(folder) as temporary:
            if maps.built is not None:
                write_map(temporary / "map", maps.built)
            if maps.elevation is not None:
                write_elevation(temporary / ELEVATION, maps.elevation.built, maps.elevation.true_pose)
            write_map(temporary / "map_true_pose", maps.true_pose)
            for name, trajectory in (("truth", truth), ("estimate", estimate), ("odometry", odometry)):
                write_tum(temporary / f"{name}.tum", trajectory)
            times = np.arange(len(log.commands)) * period
            commands = np.column_stack((times, [(c.v, c.omega) for c in log.commands]))
            write_commands(temporary / COMMANDS, Commands(log.start, commands))
            write_log(temporary / "scans.clf.gz", zip(log.scans, log.odometry, strict=True))
            write_imu(temporary / "imu.csv.gz", list(log.imu))
            lines = [f"{second},{rtf:.4f}" for second, rtf in enumerate(record.rtf["series"], start=1)]
            (temporary / "rtf.csv").write_text("\n".join(["second,rtf", *lines]) + "\n", encoding="utf-8")
            if drawn:
                self.overview().savefig(temporary / "overview.png")
            for file in bag:
                shutil.move(file, temporary / file.name)
            record.save(temporary)

    def overview(self) -> Drawing:
        """Draw the run on one page."""
        from lirs_validation.drawing import overview_figure

        truth, estimate, _ = self.log.trajectories()
        maps = self.maps
        elevation = None if maps.elevation is None else maps.elevation.built
        drawn = (maps.true_pose, maps.built, maps.aligned, elevation)
        return overview_figure(self.world, self.record, truth, estimate, *drawn)

    def __repr__(self) -> str:
        return f"Run({self.record!r}, folder={self.folder})"

    def _repr_png_(self) -> bytes:
        return self.overview()._repr_png_()


def validate(
    source: str | Path,
    *,
    options: BuildOptions | None = None,
    out: str | Path | None = None,
    progress: Progress = no_progress,
    **run_options: Any,
) -> Run:
    """Drive a robot with a running mapper; evaluate path, map and speed.

    >>> validate("simple", robot="jackal", mapper="gmapping", seconds=30)  # doctest: +SKIP

    Args:
        source: a bundled world's name, a built folder, an image, a map YAML or a mesh.
        options: how the source becomes a world.
        out: folder that receives the run's folder; None = nothing is written.
        progress: function that receives step and share.
        **run_options: fields of `RunConfig`: robot, mapper, lidar, terrain, rays, attitude, driver, actors,
            seed, seconds, wall_limit, bag, sensors_only.

    Raises:
        WctError: the source, a name or an option cannot be used, or results cannot be written.
    """
    check_names(RunConfig, run_options)
    config = RunConfig(source=str(source), build=options or BuildOptions(), **run_options)
    return run(config, out=None if out is None else Path(out), progress=progress)


def run(
    config: RunConfig,
    *,
    out: Path | None = None,
    progress: Progress = no_progress,
    scenarios: ScenarioCache | None = None,
    concurrent: bool = False,
    name: str | None = None,
    brief: bool = False,
) -> Run:
    """Run a config (see `validate`).

    Args:
        config: run configuration.
        out: folder that receives the run's folder; None = nothing is written.
        progress: function that receives step and share.
        scenarios: worlds that were built before.
        concurrent: whether the sweep runs others at the same time.
        name: name of the run's folder; None = the record's.
        brief: Whether to omit the replay of the physics and the overview picture.

    Raises:
        WctError: see `validate`; a bag is to be recorded, and nothing written.
    """
    if config.bag is not None and out is None:
        raise ConfigError(f"{config.source}: a bag needs a folder to be written to: give out")
    check_writable(out)
    return drive_and_conclude(
        prepare(config, progress, scenarios), out, progress, name, concurrent=concurrent, brief=brief
    )


def run_unwritten(
    config: RunConfig, *, maps: bool = False, scenarios: ScenarioCache | None = None
) -> dict[str, Any]:
    """Drive; return `status`, `reason`, `trajectory`, `scans` and `map` of a record, sooner than `run`.

    Without `maps` they are not compared, and `map` is empty.

    Raises:
        WctError: see `validate`; the mapper failed, or nothing was driven.
    """
    ready = prepare(config, scenarios=scenarios)
    world = ready.scenario.world
    with closing(ready.mapper):
        log = drive(ready.simulation, ready.driver, ready.mapper, ready.seconds)
        log.final = ready.mapper.trajectory()
        scores = evaluate_maps(world, log, ready.mapper).scores if maps else {}
    trajectory = evaluate_trajectory(log, ready.simulation)
    status, reason = evaluate_status(log, trajectory["scan_coverage"])
    found = {"status": status, "reason": reason, "trajectory": trajectory, "map": scores}
    return found | {"scans": evaluate_scans(world, log)}


@dataclass(frozen=True)
class ReadyRun:
    """Everything that a drive needs, its kernels compiled.

    Attributes:
        seconds: simulated time of the drive, standing included.
        compile_seconds: wall seconds that the compiler took.
    """

    scenario: Scenario
    simulation: Simulation
    driver: Driver
    mapper: MapperUnderTest
    seconds: float
    compile_seconds: float

    def cost(self, meter: CostMeter) -> dict[str, Any]:
        """Return the cost of the drive so far: `cpu_seconds`, `peak_memory`."""
        return asdict(meter.cost() + self.mapper.cost())


def drive_and_conclude(
    ready: ReadyRun,
    out: Path | None = None,
    progress: Progress = no_progress,
    name: str | None = None,
    *,
    concurrent: bool = False,
    brief: bool = False,
) -> Run:
    """Drive, record, evaluate and write a prepared run (see `run`); close its mapper.

    Raises:
        WctError: the mapper failed, nothing was driven, or results cannot be written.
    """
    config = ready.scenario.config
    with recording(config, out, ready.simulation.period) as recorded, closing(ready.mapper):
        meter = CostMeter()
        log = drive(
            ready.simulation,
            ready.driver,
            ready.mapper,
            ready.seconds,
            progress,
            wall_limit=config.wall_limit,
            recorder=recorded.add,
        )
        cost = ready.cost(meter)
        log.load = load_average()
        log.concurrent = concurrent or is_shared(log.load)
        return conclude(ready, log, cost, out, progress, name, recorded, brief=brief)


def prepare(
    config: RunConfig, progress: Progress = no_progress, scenarios: ScenarioCache | None = None
) -> ReadyRun:
    """Build the world of a config, plan its drive, compile.

    Raises:
        WctError: the source, a name or an option cannot be used.
    """
    robot = make_robot(config.robot)
    with ExitStack() as started:
        mapper = start_mapper(config)
        started.callback(mapper.close)
        check_sensors(mapper, config)
        progress("build", 0.0)
        scenario = (scenarios or ScenarioCache()).scenario(config)
        with compile_timer() as compile_seconds:
            progress("plan", 0.0)
            driver = make_driver(scenario.world, robot, config, mapper.map)
            stand = config.stand
            if stand is None:
                stand = STAND if mapper.reads_inertial else 0.0
            driver = StandingDriver(driver, stand) if stand else driver
            progress("compile", 0.0)
            inertial = config.bag is not None or mapper.reads_inertial
            simulation = scenario.simulation(robot, inertial=inertial)
            warm_up(scenario, simulation, mapper)
        started.pop_all()
    return ReadyRun(scenario, simulation, driver, mapper, config.seconds + stand, compile_seconds())


def warm_up(scenario: Scenario, simulation: Simulation, mapper: MapperUnderTest) -> None:
    """Compile every kernel by a short throw-away drive; restart the mapper.

    A kind of drive is warmed up once per process, and again if the mapper has a new process.
    """
    c = scenario.config
    driven = driver_parts(c.driver)[0]
    where = (scenario.world.kind, c.terrain, c.rays, "walkers" if c.actors else "")
    kind = (*where, c.robot, c.lidar, c.mapper, c.attitude, driven)
    if not mapper.in_process:
        if kind in _WARM:
            return
        warm_up_mapper(c.mapper)
    slow = c.rays == "mujoco" and c.terrain == "hfield"
    config = replace(c, seconds=BRIEF if slow else WARM_UP)
    driver = make_driver(scenario.world, simulation.robot, config, mapper.map)
    drive(simulation, driver, mapper, config.seconds)
    mapper.restart()
    if not mapper.in_process:
        _WARM.add(kind)


def conclude(
    ready: ReadyRun,
    log: DriveLog,
    cost: dict[str, Any],
    out: Path | None = None,
    progress: Progress = no_progress,
    name: str | None = None,
    recorded: Recording = Recording(),  # noqa: B008  it holds nothing
    *,
    brief: bool = False,
) -> Run:
    """Evaluate a drive that has ended, and write its folder (see `run`).

    `cost` holds `cpu_seconds` and `peak_memory` of the drive, `recorded` its bag.

    Raises:
        SimulationError: not a single scan was driven.
    """
    scenario, mapper = ready.scenario, ready.mapper
    if not log.walls:
        raise SimulationError(f"{scenario.config.source}: nothing was driven: {log.reason}")
    log.final = mapper.trajectory()
    progress("evaluate", 1.0)
    maps = evaluate_maps(scenario.world, log, mapper)
    cost = cost | {"compile_seconds": ready.compile_seconds}
    record = evaluate(scenario, ready.simulation, mapper, log, maps, cost, replayed=not brief)
    run = Run(record, log, maps, scenario.world, None if out is None else out / (name or record.name))
    if run.folder is not None:
        T_map_world = log.truth[0].to_pose2().inverse()
        bag = recorded.finish(None if maps.built is None else maps.built.moved(T_map_world))
        run.write(run.folder, bag, drawn=not brief)
    return run
