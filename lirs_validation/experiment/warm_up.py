"""Warm-up before timing: a short drive compiles all kernels."""

from __future__ import annotations

from dataclasses import replace

from lirs_envs.robots.robot import Robot
from lirs_validation.config import driver_parts
from lirs_validation.driving.choice import make_driver
from lirs_validation.experiment.feeding.process import MapperProcess
from lirs_validation.experiment.loop import drive
from lirs_validation.experiment.mapper_guard import guard_mapper, occupancy_map
from lirs_validation.experiment.mapper_loading import mapper_named, warm_up_mapper
from lirs_validation.experiment.scenario import Scenario

WARM_UP = 2.0
"""Simulated seconds of the drive."""
BRIEF = 0.2
"""The same where MuJoCo's rays meet its height field: there a scan alone may take seconds."""
_WARM: set[tuple[str | None, ...]] = set()
"""Kinds of drives that this process has warmed up."""


def warm_up(scenario: Scenario, robot: Robot, process: MapperProcess | None = None) -> None:
    """Drive a throw-away simulation for a moment, so that every kernel is compiled.

    A kind of drive is warmed up once per process, and again if the mapper has a new process.

    Args:
        scenario: of the drive.
        robot: that is driven.
        process: of the mapper, which begins anew; None = it has none.
    """
    c = scenario.config
    driven = driver_parts(c.driver)[0]
    where = (scenario.world.kind, c.terrain, c.rays, "walkers" if c.actors else "")
    kind = (*where, c.robot, c.lidar, c.mapper, c.attitude, driven)
    if process is None:
        if kind in _WARM:
            return
        warm_up_mapper(c.mapper)
    slow = c.rays == "mujoco" and c.terrain == "hfield"
    config = replace(c, seconds=BRIEF if slow else WARM_UP)
    mapper = guard_mapper(process or mapper_named(c.mapper, c.seed), c)
    driver = make_driver(scenario.world, robot, config, occupancy_map(mapper))
    drive(scenario.simulation(robot), driver, mapper, config.seconds, feeding=process)
    if process is None:
        _WARM.add(kind)
    else:
        process.begin()
