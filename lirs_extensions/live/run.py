"""Live drives from start to record: a client maps, or drives, or both."""

from __future__ import annotations

import signal
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from lirs_envs.lidar.presets import make_lidar_preset
from lirs_envs.robots.robot import make_robot
from lirs_envs.simulation import Simulation
from lirs_envs.simulation_config import can_stand
from lirs_extensions.live.bridge import Bridge, Client, ClientDriver, ClientMapper, PublishedMapper
from lirs_extensions.live.graph import CYCLONE_LOOPBACK, PUBLISHED, LiveTopic, Middleware
from lirs_extensions.live.options import LiveOptions
from lirs_validation.config import CLIENT, FRONTIER, RunConfig, run_name
from lirs_validation.driving.choice import check_driver, make_driver, start_pose
from lirs_validation.experiment.drive import Scenario, build_scenario
from lirs_validation.experiment.mapper_under_test import MapperUnderTest, mapper_named, needs_process
from lirs_validation.experiment.recording import sensor_errors
from lirs_validation.experiment.run import ReadyRun, Run, drive_and_conclude, warm_up
from lirs_validation.processes import compile_timer
from lirs_wct import ConfigError, Pose2, unknown_name
from lirs_wct.files import check_writable
from lirs_wct.formats.rosbag.topics import MAP_TOPIC
from lirs_wct.progress import Progress, no_progress
from slam_baselines.mapper import MAPPERS

LOOK = 0.05
"""Seconds between two looks for a subscriber."""
PACKAGES = {"dds": "cyclonedds", "zenoh": "zenoh"}
"""Package of each middleware, of the extra [live]."""


@dataclass(frozen=True)
class LiveRun:
    """Result of a live drive."""

    run: Run
    bridge: Bridge


def live(
    config: RunConfig,
    options: LiveOptions,
    *,
    out: Path | None = None,
    progress: Progress = no_progress,
    announce: Callable[[str], None] = lambda _: None,
) -> Iterator[LiveRun]:
    """Drive with a client; yield the result of each drive.

    A request for a new start ends a drive, and the next one begins. The config names the mapper `client` or
    one of ours, and the driver `client` for /cmd_vel or one of ours.
    """
    robot = make_robot(config.robot)
    _check(config, options)
    check_writable(out)
    progress("build", 0.0)
    scenario = build_scenario(config)
    start = start_pose(scenario.world, robot, config)
    progress("compile", 0.0)
    with compile_timer() as compile_seconds:
        simulation = scenario.simulation(robot, inertial=True)
        warm_up(config, simulation, start)
    middleware = open_middleware(options, _topics(config, options))
    with closing(middleware):
        _await_client(middleware, options, announce)
        session = _Session(scenario, simulation, middleware, options, start, compile_seconds())
        yield from session.drives(out, progress)


@dataclass(frozen=True)
class _Session:
    """Drives of one client, one after the other.

    Attributes:
        simulation: Robot in its world, for all drives.
        first: Start pose of the first drive, world frame; the client's map frame begins there.
        compile_seconds: Wall seconds that the compiler took.
    """

    scenario: Scenario
    simulation: Simulation
    middleware: Middleware
    options: LiveOptions
    first: Pose2
    compile_seconds: float

    def drives(self, out: Path | None, progress: Progress) -> Iterator[LiveRun]:
        """Yield the drives until the configured time is over."""
        config, T_map_start, left, count = self.scenario.config, Pose2(), self.scenario.config.seconds, 0
        while True:
            count += 1
            ready, bridge = self._ready(T_map_start, left)
            if count > 1:
                self.middleware.receive()  # what the client sent since the former drive is not for this one
            name = run_name(config, self.scenario.world.name)
            with _ended_by_interrupt(bridge.client):
                run = drive_and_conclude(ready, out, progress, name if count == 1 else f"{name}-{count}")
            yield LiveRun(run, bridge)
            left -= len(run.log.tick_seconds) * self.simulation.period
            if bridge.client.ended or not bridge.client.reset or left < self.simulation.period:
                return
            T_map_start = self._requested(bridge.client.start)

    def _ready(self, T_map_start: Pose2, seconds: float) -> tuple[ReadyRun, Bridge]:
        config, scenario, simulation = self.scenario.config, self.scenario, self.simulation
        bridge = Bridge(self.middleware, self.options, simulation, sensor_errors(config), T_map_start)
        mapper: MapperUnderTest
        if config.mapper == self.options.client:
            clouds, T_start_map = simulation.preset.rings > 1, T_map_start.inverse()
            mapper = ClientMapper(bridge, config.mapper, reads_clouds=clouds, T_start_map=T_start_map)
        else:
            ours = mapper_named(config.mapper, config.seed, config.parameters)
            mapper = PublishedMapper(bridge, ours, config)
        own, stand = None, 0.0
        if config.driver != CLIENT:
            own = make_driver(scenario.world, simulation.robot, config, mapper.map)
            stand = config.stand or 0.0
        start = self.first @ T_map_start if own is None else own.start
        driver = ClientDriver(start, bridge.client, own)
        ready = ReadyRun(scenario, simulation, driver, mapper, seconds, self.compile_seconds, stand)
        return ready, bridge

    def _requested(self, T_map_start: Pose2 | None) -> Pose2:
        """Return the requested start, map frame; the first one if the robot cannot stand there."""
        if T_map_start is None:
            return Pose2()
        start = self.first @ T_map_start
        if can_stand(self.scenario.world, self.simulation.robot, start):
            return T_map_start
        name, where = self.simulation.robot.name, f"({T_map_start.x:.2f}, {T_map_start.y:.2f})"
        warnings.warn(f"/initialpose: {name} cannot stand at {where}; starts at (0, 0)", stacklevel=2)
        return Pose2()


@contextmanager
def _ended_by_interrupt(client: Client) -> Iterator[None]:
    """End the drive at the first Ctrl-C, so that it is evaluated; the second one interrupts."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(*_: object) -> None:
        client.ended = True
        signal.signal(signal.SIGINT, former)

    former = signal.signal(signal.SIGINT, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, former)


def _check(config: RunConfig, options: LiveOptions) -> None:
    """Check that the middleware is installed, and that mapper and driver suit a live drive."""
    package = PACKAGES[options.middleware]
    if find_spec(package) is None:
        raise ConfigError(
            f"--middleware {options.middleware} needs the package {package}: pip install '.[live]'"
        )
    maps = config.mapper == options.client
    if not maps and needs_process(config.mapper):
        raise ConfigError(f"mapper {config.mapper}: live publishes the map of {', '.join(MAPPERS)}")
    if not maps and config.mapper not in MAPPERS:
        raise unknown_name("mapper", config.mapper, MAPPERS)
    if config.driver == FRONTIER and maps:
        raise ConfigError(f"driver {FRONTIER} plans on the map of one of our mappers: give --mapper")
    if config.driver != CLIENT:
        check_driver(config)


def _topics(config: RunConfig, options: LiveOptions) -> tuple[LiveTopic, ...]:
    """Return the topics of a drive: /points with rings only, /map of our mappers only."""
    lidar = make_lidar_preset(config.lidar or make_robot(config.robot).lidar)
    absent = {"/points"} if lidar.rings == 1 else set()
    if config.mapper == options.client:
        absent.add(MAP_TOPIC)
    return tuple(topic for topic in PUBLISHED if topic.name not in absent)


def open_middleware(options: LiveOptions, topics: tuple[LiveTopic, ...]) -> Middleware:
    """Join a network."""
    if options.middleware == "dds":
        from lirs_extensions.live.dds import DdsNode

        return DdsNode(options, topics)
    from lirs_extensions.live.zenoh_node import ZenohNode

    return ZenohNode(options, topics)


def _await_client(middleware: Middleware, options: LiveOptions, announce: Callable[[str], None]) -> None:
    """Wait for a subscriber of scans; with lockstep, also for a publisher of answers."""
    if not options.wait:
        return
    place = f"{options.middleware} domain {options.domain} on {options.host or 'loopback'}"
    announce(f"{place}: waiting for a subscriber of /scan or /points")
    end = time.perf_counter() + options.wait
    while time.perf_counter() < end:
        listens = middleware.subscribers("/scan") + middleware.subscribers("/points")
        if listens and (middleware.publishers() or not options.lockstep):
            return
        time.sleep(LOOK)
    needed = (
        "/scan or /points and no publisher of /cmd_vel or /tf" if options.lockstep else "/scan or /points"
    )
    line = f"{place}: no subscriber of {needed} within {options.wait:g} s (option wait)"
    if options.middleware == "dds" and options.host is None:
        line += (
            "; Cyclone DDS is not on loopback by default: start its client with "
            f"export CYCLONEDDS_URI='{CYCLONE_LOOPBACK}', or live with --host ADDRESS of this machine"
        )
    raise ConfigError(line)
