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
from lirs_envs.simulation_config import can_stand
from lirs_extensions.live.bridge import Bridge, Client, ClientDriver, ClientMapper, PublishedMapper
from lirs_extensions.live.graph import CYCLONE_LOOPBACK, PUBLISHED, LiveTopic, Middleware
from lirs_extensions.live.options import LiveOptions
from lirs_validation.config import CLIENT, FRONTIER, RunConfig, run_name
from lirs_validation.driving.choice import check_driver, make_driver, start_pose
from lirs_validation.experiment.mapper_under_test import MapperUnderTest, mapper_named, needs_process
from lirs_validation.experiment.run import ReadyRun, Run, drive_and_conclude, sensor_errors, warm_up
from lirs_validation.experiment.scenario import Scenario, build_scenario
from lirs_validation.processes import compile_timer
from lirs_wct import ConfigError, Pose2, Progress, no_progress, unknown_name
from lirs_wct.files import check_writable
from lirs_wct.formats.rosbag.topics import MAP_TOPIC
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
    with closing(open_middleware(options, _topics(config, options))) as middleware:
        _await_client(middleware, options, announce)
        T_map_start, left, count = Pose2(), config.seconds, 0
        while True:
            count += 1
            bridge = Bridge(middleware, options, simulation, sensor_errors(config), T_map_start)
            ready = _make_ready(scenario, bridge, start @ T_map_start, left, compile_seconds())
            name = run_name(config, scenario.world.name)
            if count > 1:
                middleware.receive()  # what the client sent since the former drive is not for this one
                name += f"-{count}"
            with _ended_by_interrupt(bridge.client):
                run = drive_and_conclude(ready, out, progress, name)
            yield LiveRun(run, bridge)
            left -= len(run.log.tick_seconds) * simulation.period
            if bridge.client.ended or not bridge.client.reset or left < simulation.period:
                return
            T_map_start = bridge.client.start or Pose2()
            if not can_stand(scenario.world, robot, start @ T_map_start):
                where = f"({T_map_start.x:.2f}, {T_map_start.y:.2f})"
                line = f"/initialpose: {robot.name} cannot stand at {where}; starts at (0, 0)"
                warnings.warn(line, stacklevel=2)
                T_map_start = Pose2()


def _make_ready(
    scenario: Scenario, bridge: Bridge, start: Pose2, seconds: float, compile_seconds: float
) -> ReadyRun:
    """Return a drive whose mapper, driver or both is the client."""
    config, simulation = scenario.config, bridge.simulation
    mapper: MapperUnderTest
    if config.mapper == bridge.options.client:
        mapper = ClientMapper(bridge, config.mapper)
    else:
        mapper = PublishedMapper(bridge, mapper_named(config.mapper, config.seed, config.parameters), config)
    own, stand = None, 0.0
    if config.driver != CLIENT:
        own = make_driver(scenario.world, simulation.robot, config, mapper.map)
        start, stand = own.start, config.stand or 0.0
    driver = ClientDriver(start, bridge.client, own)
    return ReadyRun(scenario, simulation, driver, mapper, seconds, compile_seconds, stand)


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
            f"--middleware {options.middleware} needs the package {package}: pip install 'lirs-wct[live]'"
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
