"""One validation run, as in the paper's experiment: build the world, drive, map, judge, write."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from lirs_envs.robots import Robot, make_robot
from lirs_envs.simulation import Simulation
from lirs_validation.drivers import CoverageDriver, plan_coverage
from lirs_validation.judge import (
    Maps,
    judge_collisions,
    judge_contact,
    judge_maps,
    judge_rtf,
    judge_trajectory,
)
from lirs_validation.loop import DriveLog, drive
from lirs_validation.pace import driver_config
from lirs_validation.record import RunConfig, RunRecord, machine, versions
from lirs_validation.results import write_results
from lirs_wct.contact_parts import Terrain
from lirs_wct.errors import ConfigError
from lirs_wct.options import BuildOptions
from lirs_wct.starts import start_poses
from lirs_wct.window import Window
from lirs_wct.world import World, build_world
from slam_baselines.mapper import Mapper, make_mapper
from slam_baselines.rehearsal import rehearse

LARGE = 200.0
"""A terrain longer than this (metres) is validated on a window."""
WINDOW = 50.0
MARGIN = 0.15
"""Metres that a plan keeps beyond the robot's radius."""
PLAN_STREAM = 2
"""Which of the seed's random streams the tour is drawn from; the simulation has others."""
WARM_UP = 2.0
"""Simulated seconds driven before the clock starts, so that compiled kernels are loaded."""

Report = Callable[[str, float], None]
"""Called with what is going on and the share that is done, 0 to 1."""


@dataclass(frozen=True)
class Stage:
    """A config and its world; `window` is the square that was cut out of a larger one, if any."""

    config: RunConfig
    world: World
    window: Window | None


@dataclass(frozen=True)
class Run:
    """What a run leaves behind: the record, the log of the drive, the maps, the world."""

    record: RunRecord
    log: DriveLog
    maps: Maps
    world: World
    folder: Path | None


def validate(
    source: str | Path,
    *,
    robot: str = "husky",
    mapper: str = "hector",
    lidar: str | None = None,
    terrain: Terrain = "hfield",
    seconds: float = 120.0,
    seed: int = 1,
    options: BuildOptions | None = None,
    out: str | Path | None = None,
    report: Report | None = None,
) -> Run:
    """Drive a robot through a source with a mapper running, and say how well and how fast that went.

    Args:
        source: a bundled world's name, a built folder, a picture or a map YAML.
        robot: name of the robot.
        mapper: name of the mapper.
        lidar: name of an LRF preset; None = the robot's own.
        terrain: what MuJoCo touches: `hfield`, `mesh`, `prisms` or `convex`.
        seconds: simulated time to drive.
        seed: of every random number in the run; same seed, same bytes.
        options: how the source becomes a world.
        out: folder that receives the run's folder; None = nothing is written.
        report: called with the stage and the share done.

    Raises:
        WctError: the source, a name or an option cannot be used, or results cannot be written.
    """
    config = RunConfig(
        source=str(source),
        robot=robot,
        mapper=mapper,
        lidar=lidar,
        terrain=terrain,
        seconds=seconds,
        seed=seed,
        build=options or BuildOptions(),
    )
    return run(config, out=None if out is None else Path(out), report=report)


def run(config: RunConfig, *, out: Path | None = None, report: Report | None = None) -> Run:
    """Run a config (see `validate`)."""
    tell = report or (lambda stage, share: None)
    robot, mapper = make_robot(config.robot), make_mapper(config.mapper, seed=config.seed)
    tell("build", 0.0)
    stage = set_stage(config)
    tell("plan", 0.0)
    driver = plan(stage.world, robot, config)
    tell("compile", 0.0)
    compile_seconds = warm_up(stage, robot)
    simulation = simulate(stage, robot)
    log = drive(simulation, driver, mapper, config.seconds, lambda done: tell("drive", done / config.seconds))
    log.final = mapper.trajectory()
    tell("judge", 1.0)
    maps = judge_maps(stage.world, log, mapper)
    record = judge(stage, simulation, mapper, log, maps, compile_seconds)
    folder = None if out is None else write_results(out / record.name, record, log, maps, stage.world)
    return Run(record, log, maps, stage.world, folder)


def simulate(stage: Stage, robot: Robot) -> Simulation:
    """Put the robot into the config's world."""
    config = stage.config
    return Simulation(stage.world, robot, lidar=config.lidar, seed=config.seed, terrain=config.terrain)


def set_stage(config: RunConfig) -> Stage:
    """Build the config's world; of a terrain larger than 200 m, its middle 50 m."""
    world = build_world(config.source, config.build)
    if (
        max(world.surface.size) <= LARGE
        or world.kind == "map"
        or world.overhangs
        or config.build.window is not None
    ):
        return Stage(config, world, config.build.window)
    west, south, east, north = world.surface.bounds
    window = ((west + east) / 2, (south + north) / 2, WINDOW)
    return Stage(config, build_world(config.source, replace(config.build, window=window)), window)


def plan(world: World, robot: Robot, config: RunConfig) -> CoverageDriver:
    """Plan a tour over the true ground; the mapper sees none of it.

    Raises:
        ConfigError: the robot fits nowhere in this world.
    """
    free = world.traversable(clearance=robot.radius + MARGIN, max_slope=robot.max_slope)
    starts = start_poses(free)
    if not starts:
        raise ConfigError(
            f"{config.source}: no place for {robot.name}: it needs {2 * (robot.radius + MARGIN):.1f} m of "
            f"free ground no steeper than {math.degrees(robot.max_slope):.0f} deg"
        )
    start = starts[(config.seed - 1) % len(starts)]
    rng = np.random.default_rng((config.seed, PLAN_STREAM))
    pace = driver_config(robot)
    return plan_coverage(free, start, seconds=config.seconds, rng=rng, config=pace, surface=world.surface)


def warm_up(stage: Stage, robot: Robot) -> float:
    """Drive a throw-away simulation for a moment, so that every kernel is compiled; return the seconds."""
    begun = time.perf_counter()
    rehearse(stage.config.mapper)
    config = replace(stage.config, seconds=WARM_UP)
    simulation = simulate(stage, robot)
    drive(simulation, plan(stage.world, robot, config), make_mapper(config.mapper), WARM_UP)
    return time.perf_counter() - begun


def judge(
    stage: Stage,
    simulation: Simulation,
    mapper: Mapper,
    log: DriveLog,
    maps: Maps,
    compile_seconds: float,
) -> RunRecord:
    """Turn a finished drive into a record."""
    return RunRecord(
        config=stage.config,
        world=_described(stage, simulation),
        status=log.status,
        reason=log.reason,
        rtf=judge_rtf(log, simulation) | {"compile_seconds": compile_seconds},
        trajectory=judge_trajectory(log),
        map=maps.scores,
        collisions=judge_collisions(simulation),
        mapper=asdict(mapper.stats),
        versions=versions(),
        machine=machine(),
    )


def _described(stage: Stage, simulation: Simulation) -> dict[str, Any]:
    world, surface = stage.world, stage.world.surface
    return {
        "name": world.name,
        "kind": world.kind,
        "scale": world.scale,
        "size": surface.size,
        "bounds": surface.bounds,
        "relief": surface.relief,
        "nodes": surface.shape,
        "window": stage.window,
        "contact": judge_contact(simulation),
    }
