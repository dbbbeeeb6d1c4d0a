"""The tour that a robot is sent on: over the true ground, which the mapper never sees."""

from __future__ import annotations

import math

import numpy as np

from lirs_envs.robots.robot import Robot
from lirs_validation.config import RunConfig
from lirs_validation.driving.drivers import CoverageDriver, plan_coverage
from lirs_validation.driving.pace import driver_config
from lirs_wct.errors import ConfigError
from lirs_wct.navigation.spawn_poses import spawn_poses
from lirs_wct.world import World

MARGIN = 0.15
"""Metres that a plan keeps beyond the robot's radius."""
PLAN_STREAM = 2
"""Which of the seed's random streams the tour is drawn from; the simulation has others."""


def plan(world: World, robot: Robot, config: RunConfig) -> CoverageDriver:
    """Plan a tour over the true ground; the mapper sees none of it.

    Raises:
        ConfigError: the robot fits nowhere in this world.
    """
    free = world.traversable(clearance=robot.radius + MARGIN, max_slope=robot.max_slope)
    starts = spawn_poses(free)
    if not starts:
        raise ConfigError(
            f"{config.source}: no place for {robot.name}: it needs {2 * (robot.radius + MARGIN):.1f} m of "
            f"free ground no steeper than {math.degrees(robot.max_slope):.0f} deg"
        )
    start = starts[(config.seed - 1) % len(starts)]
    rng = np.random.default_rng((config.seed, PLAN_STREAM))
    pace = driver_config(robot)
    return plan_coverage(free, start, seconds=config.seconds, rng=rng, config=pace, surface=world.surface)
