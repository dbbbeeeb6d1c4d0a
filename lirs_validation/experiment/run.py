"""One validation run, as in the paper's experiment: build the world, drive, map, record, evaluate, write."""

from __future__ import annotations

import math
import shutil
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager, nullcontext, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lirs_envs.robot_model import CONTROL_PERIOD
from lirs_envs.robots.robot import Twist, make_robot
from lirs_envs.sensing.sensors import Observation
from lirs_envs.simulation import Simulation
from lirs_validation.config import FRONTIER, STAND, RunConfig
from lirs_validation.driving.choice import COMMANDS, check_driver, make_driver
from lirs_validation.driving.frontier_route import warm_up_explorer
from lirs_validation.experiment.drive import DriveLog, Driver, drive
from lirs_validation.experiment.evaluation import Maps, evaluate, evaluate_drive, evaluate_maps
from lirs_validation.experiment.mapper_under_test import MapperUnderTest, check_sensors, start_mapper
from lirs_validation.experiment.scenario import Scenario, ScenarioCache, sensor_noise
from lirs_validation.metrics.elevation import ELEVATION, write_elevation
from lirs_validation.processes import CostMeter, compile_timer, load_average
from lirs_validation.record.run_record import BAG, RunRecord
from lirs_validation.record.verdict import Verdict
from lirs_wct import (
    BuildOptions,
    ConfigError,
    OccupancyGrid,
    Pose2,
    Pose3,
    Progress,
    SimulationError,
    World,
    no_progress,
)
from lirs_wct.files import atomic_folder, check_writable, scratch_folder
from lirs_wct.formats import drive_files, map_server
from lirs_wct.option import check_names
from slam_baselines.mapper import MAPPERS, OWN_CLOUD_MAPPERS, warm_up as warm_up_mapper
from slam_baselines.watch import STEPS, Watch

if TYPE_CHECKING:
    from lirs_wct.drawing.canvas import Drawing
    from lirs_wct.formats.rosbag.messages import BagTick, SensorErrors
    from lirs_wct.formats.rosbag.writer import BagWriter

WARM_UP_SCANS = 12
"""Scans in which a mapper of point clouds meets all of its kernels."""
_WARM: set[str] = set()
"""Mappers whose kernels, if they are ours, this process has compiled."""


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
        period = record.rtf["simulated_seconds"] / len(log.tick_seconds)
        with atomic_folder(folder) as temporary:
            if maps.built is not None:
                map_server.write_map(temporary / "map", maps.built)
            if maps.elevation is not None:
                write_elevation(temporary / ELEVATION, maps.elevation.built, maps.elevation.true_pose)
            map_server.write_map(temporary / "map_true_pose", maps.true_pose)
            for name, trajectory in (("truth", truth), ("estimate", estimate), ("odometry", odometry)):
                drive_files.write_tum(temporary / f"{name}.tum", trajectory)
            times = np.arange(len(log.commands)) * period
            commands = np.column_stack((times, [(c.v, c.omega) for c in log.commands]))
            drive_files.write_commands(temporary / COMMANDS, drive_files.Commands(log.start, commands))
            drive_files.write_scans(temporary / "scans.clf.gz", zip(log.scans, log.odometry, strict=True))
            drive_files.write_imu(temporary / "imu.csv.gz", log.imu)
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
        return overview_figure(self.world, self.record, (truth, estimate), *drawn)

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
        config: Run configuration.
        out: Folder that receives the run's folder; None = nothing is written.
        progress: Function that receives step and share.
        scenarios: Worlds that were built before.
        concurrent: Whether the sweep runs others at the same time.
        name: Name of the run's folder; None = the record's.
        brief: Whether to omit the replay of the physics and the overview picture.
    """
    if config.bag is not None and out is None:
        raise ConfigError(f"{config.source}: a bag needs a folder to be written to: give out")
    check_writable(out)
    ready = prepare(config, progress, scenarios)
    return drive_and_conclude(ready, out, progress, name, concurrent=concurrent, brief=brief)


def run_unwritten(
    config: RunConfig, *, maps: bool = False, scenarios: ScenarioCache | None = None
) -> RunRecord:
    """Drive; return the part of a record that a verdict reads, sooner than `run`.

    Without `maps` they are not compared, and `map` is empty.
    """
    ready = prepare(config, scenarios=scenarios)
    with closing(ready.mapper):
        log = ready.log()
        for _ in ready.drive(log):
            pass
        log.final_trajectory = ready.mapper.trajectory()
        scores = evaluate_maps(ready.scenario.world, log, ready.mapper).scores if maps else {}
    return evaluate_drive(ready.scenario, ready.simulation, log, scores)


@dataclass(frozen=True)
class ReadyRun:
    """Everything that a drive needs, its kernels compiled.

    Attributes:
        seconds: Simulated time of the drive, standing included.
        compile_seconds: Wall seconds that the compiler took.
        stand: Simulated seconds of standing before it drives.
    """

    scenario: Scenario
    simulation: Simulation
    driver: Driver
    mapper: MapperUnderTest
    seconds: float
    compile_seconds: float
    stand: float = 0.0

    def log(self) -> DriveLog:
        """Return an empty log of the drive."""
        return DriveLog(self.driver.start, self.mapper.reads_clouds)

    def drive(self, log: DriveLog, **options: Any) -> Iterator[float]:
        """Drive, with the options of `drive`; yield the simulated time of each scan."""
        parts = self.simulation, self.driver, self.mapper
        return drive(*parts, log, self.seconds, stand=self.stand, **options)

    def cost(self, meter: CostMeter) -> dict[str, Any]:
        """Return the cost of the drive so far: `cpu_seconds`, `peak_memory`."""
        return asdict(meter.cost() + self.mapper.cost())


def prepare(
    config: RunConfig, progress: Progress = no_progress, scenarios: ScenarioCache | None = None
) -> ReadyRun:
    """Make a run's mapper, world, driver and simulation, and compile."""
    robot = make_robot(config.robot)
    with ExitStack() as on_failure:
        mapper = start_mapper(config)
        on_failure.callback(mapper.close)
        check_sensors(mapper, config)
        check_driver(config)
        progress("build", 0.0)
        scenario = (scenarios or ScenarioCache()).scenario(config)
        with compile_timer() as compile_seconds:
            progress("plan", 0.0)
            driver = make_driver(scenario.world, robot, config, mapper.map)
            stand = config.stand
            if stand is None:
                stand = STAND if mapper.reads_inertial else 0.0
            progress("compile", 0.0)
            inertial = config.bag is not None or mapper.reads_inertial
            simulation = scenario.simulation(robot, inertial=inertial)
            warm_up(config, simulation, driver.start)
        on_failure.pop_all()
    return ReadyRun(scenario, simulation, driver, mapper, config.seconds + stand, compile_seconds(), stand)


def warm_up(config: RunConfig, simulation: Simulation, start: Pose2) -> None:
    """Compile the kernels of simulation, explorer and mapper.

    A mapper of your own compiles in its first scans. The simulation is advanced by one scan, and reset when
    the drive begins.
    """
    simulation.reset(start)
    with suppress(SimulationError):  # the drive reports it
        simulation.advance(Twist())
    watch = Watch()
    for k in range(STEPS + 1):
        watch.update(Pose2(), 0.1 * k)
    if config.driver == FRONTIER:
        warm_up_explorer()
    if config.mapper not in _WARM and config.mapper in MAPPERS:
        warm_up_mapper(config.mapper)
    elif config.mapper not in _WARM and config.mapper in OWN_CLOUD_MAPPERS:
        _warm_up_cloud_mapper(config, simulation, start)
    _WARM.add(config.mapper)


def _warm_up_cloud_mapper(config: RunConfig, simulation: Simulation, start: Pose2) -> None:
    """Run a new mapper through the first scans of a simulation that drives straight on."""
    mapper, observation = start_mapper(config), simulation.reset(start)
    with suppress(SimulationError):
        for _ in range(WARM_UP_SCANS):
            mapper.observe(observation)
            observation = simulation.advance(Twist(0.5))


def drive_and_conclude(
    ready: ReadyRun,
    out: Path | None = None,
    progress: Progress = no_progress,
    name: str | None = None,
    *,
    concurrent: bool = False,
    brief: bool = False,
) -> Run:
    """Drive, record, evaluate and write a prepared run (see `run`); close its mapper."""
    config, log = ready.scenario.config, ready.log()
    bag: AbstractContextManager[Recording | None] = nullcontext()
    if config.bag is not None and out is not None:
        bag = recording(config, out, ready.simulation.period)
    with bag as recorder, closing(ready.mapper):
        meter = CostMeter()
        shown, record = 1.0, None if recorder is None else recorder.add
        for driven in ready.drive(log, wall_limit=config.wall_limit, recorder=record):
            if driven >= shown:
                progress("drive", driven / ready.seconds)
                shown += 1.0
        cost = ready.cost(meter)
        log.load = load_average()
        log.concurrent = concurrent
        return conclude(ready, log, cost, out, progress, name, recorder, brief=brief)


def conclude(
    ready: ReadyRun,
    log: DriveLog,
    cost: dict[str, Any],
    out: Path | None = None,
    progress: Progress = no_progress,
    name: str | None = None,
    recorder: Recording | None = None,
    *,
    brief: bool = False,
) -> Run:
    """Evaluate a drive that has ended, and write its folder (see `run`).

    `cost` holds `cpu_seconds` and `peak_memory` of the drive, `recorder` its bag.
    """
    scenario, mapper = ready.scenario, ready.mapper
    if not log.tick_seconds:
        raise SimulationError(f"{scenario.config.source}: nothing was driven: {log.reason}")
    log.final_trajectory = mapper.trajectory()
    progress("evaluate", 1.0)
    maps = evaluate_maps(scenario.world, log, mapper)
    cost = cost | {"compile_seconds": ready.compile_seconds}
    record = evaluate(scenario, ready.simulation, mapper, log, maps, cost, replayed=not brief)
    run = Run(record, log, maps, scenario.world, None if out is None else out / (name or record.name))
    if run.folder is not None:
        T_map_world = log.truth[0].to_pose2().inverse()
        built = None if maps.built is None else maps.built.moved(T_map_world)
        run.write(run.folder, () if recorder is None else recorder.finish(built), drawn=not brief)
    return run


class Recording:
    """The bag of a drive, with the mapper's results (`map` on /tf, /map) and organized clouds if `slam`."""

    def __init__(self, writer: BagWriter, folder: Path, *, slam: bool = True) -> None:
        self._writer, self._folder, self._slam = writer, folder, slam
        self._T_map_world: Pose3 | None = None

    def add(self, observation: Observation, T_world_base: Pose3, T_map_base: Pose2) -> None:
        """Record an observation, the true pose and the mapper's pose."""
        if self._T_map_world is None:
            self._T_map_world = Pose3.from_pose2(T_world_base.to_pose2().inverse())
        estimate = T_map_base if self._slam else None
        if not self._slam and observation.cloud is not None:  # as drivers publish it: LIO-SAM takes no NaN
            observation = replace(observation, cloud=observation.cloud.by_time())
        self._writer.add(bag_tick(observation, self._T_map_world @ T_world_base, estimate))

    def finish(self, grid: OccupancyGrid | None) -> Sequence[Path]:
        """Write the map (map frame) if any, close the bag, return its files."""
        self._writer.close(grid if self._slam else None)
        return sorted(self._folder.iterdir())


def bag_tick(observation: Observation, T_map_truth: Pose3, T_map_base: Pose2 | None) -> BagTick:
    """Return the messages' values of an observation, the true pose and the mapper's pose."""
    from lirs_wct.formats.rosbag.messages import BagTick  # prepares the layouts of all messages

    return BagTick(
        scan=observation.scan,
        odometry=observation.odometry,
        imu=observation.imu,
        truth=T_map_truth,
        estimate=T_map_base,
        cloud=observation.cloud,
        inertial=observation.inertial,
        odometry_track=observation.odometry_track,
    )


def sensor_errors(config: RunConfig) -> SensorErrors:
    """Return the standard deviations of a run's sensors, for the covariances of its bag."""
    from lirs_wct.formats.rosbag.messages import SensorErrors

    noise = sensor_noise(config)
    imu, wheels = noise.imu, noise.odometry
    return SensorErrors(
        scale=wheels.scale_sigma,
        scale_length=wheels.scale_length,
        rate=imu.rate_sigma,
        rate_bias=imu.rate_bias,
        update=CONTROL_PERIOD,
        attitude=math.hypot(imu.attitude_sigma, imu.attitude_bias),
        acceleration=math.hypot(imu.acceleration_sigma, imu.acceleration_bias),
    )


@contextmanager
def recording(config: RunConfig, out: Path, period: float) -> Iterator[Recording]:
    """Record a drive's bag; its files are deleted unless they were moved."""
    from lirs_wct.formats.rosbag.writer import BagWriter

    assert config.bag is not None
    with scratch_folder(out / "recording") as made:
        folder = made / BAG
        writer = BagWriter(folder, config.bag, period, sensor_errors(config))
        try:
            yield Recording(writer, folder, slam=not config.sensors_only)
        finally:
            writer.abort()
