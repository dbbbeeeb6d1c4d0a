"""Warm-up before timing: a short drive compiles all kernels."""

from __future__ import annotations

from dataclasses import replace

from lirs_envs.robots.robot import Robot
from lirs_validation.config import driver_parts
from lirs_validation.driving.choice import make_driver
from lirs_validation.experiment.loop import drive
from lirs_validation.experiment.mapper_loading import warm_up_mapper
from lirs_validation.experiment.mapper_under_test import MapperUnderTest
from lirs_validation.experiment.scenario import Scenario

WARM_UP = 2.0
"""Simulated seconds of the drive."""
BRIEF = 0.2
"""The same where MuJoCo's rays meet its height field: there a scan alone may take seconds."""
_WARM: set[tuple[str | None, ...]] = set()
"""Kinds of drives that this process has warmed up."""


def warm_up(scenario: Scenario, robot: Robot, mapper: MapperUnderTest) -> None:
    """Compile every kernel by a short throw-away drive; restart the mapper.

    A kind of drive is warmed up once per process, and again if the mapper has a new process.

    Args:
        scenario: of the drive.
        robot: that is driven.
        mapper: of the drive.
    """
    c = scenario.config
    driven = driver_parts(c.driver)[0]
    where = (scenario.world.kind, c.terrain, c.rays, "walkers" if c.actors else "")
    kind = (*where, c.robot, c.lidar, c.mapper, c.attitude, driven)
    if mapper.place == "drive":
        if kind in _WARM:
            return
        warm_up_mapper(c.mapper)
    slow = c.rays == "mujoco" and c.terrain == "hfield"
    config = replace(c, seconds=BRIEF if slow else WARM_UP)
    driver = make_driver(scenario.world, robot, config, mapper.map)
    drive(scenario.simulation(robot, inertial=mapper.reads_inertial), driver, mapper, config.seconds)
    mapper.restart()
    if mapper.place == "drive":
        _WARM.add(kind)
