"""Frontier exploration on a mapper's own map, by the mapper's own pose; towards a goal where there is one."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from lirs_envs.env import RobotEnv
from lirs_envs.policies.policy import PolicyContext
from lirs_validation.bench.policies.driven import DrivenPolicy
from lirs_validation.driving.choice import MARGIN
from lirs_validation.driving.driver import Driver
from lirs_validation.driving.frontier_route import FrontierRoute
from lirs_validation.driving.goal_route import GoalRoute
from lirs_validation.driving.pace import driver_config
from lirs_validation.driving.path_driver import PathDriver
from lirs_wct.geometry.pose import Pose2
from slam_baselines.mapper import make_mapper

MAPPER = "hector"
"""SLAM method on whose map it plans."""


class Explorer(DrivenPolicy):
    """Sees scans, odometry and attitude as a mapper does, and the polar goal where there is one."""

    def __init__(self, env: RobotEnv, context: PolicyContext) -> None:
        super().__init__(context)
        self._env = env

    def driver(self) -> Driver:
        """Return the explorer, with a mapper that has seen nothing."""
        robot = self.context.robot
        self._mapper = make_mapper(MAPPER, seed=self.context.seed)
        self._pose, self._stamp = Pose2(), -math.inf
        pace = driver_config(robot)
        self._route = (
            FrontierRoute(self._mapper.map, robot.radius, robot.radius + MARGIN, pace)
            if self._env.view.goal is None
            else GoalRoute(self._mapper.map, robot.radius, robot.radius + MARGIN, pace)
        )
        return PathDriver(self._route, Pose2(), pace)

    def pose(self, observation: Mapping[str, Any]) -> Pose2:
        """Let the mapper see a new scan, and return its pose."""
        reading = self._env.view.reading()
        if reading.scan.stamp > self._stamp:
            self._pose = self._mapper.update(reading.scan, reading.odometry, reading.imu)
            self._stamp = reading.scan.stamp
        if isinstance(self._route, GoalRoute):
            distance, bearing = (float(value) for value in observation["goal"])
            offset = distance * np.array((math.cos(bearing), math.sin(bearing)))
            x, y = self._pose.apply(offset).tolist()
            self._route.goal = x, y
        return self._pose
