"""Drivers of validation runs as policies: commands become actions."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np

from lirs_envs.policies.policy import PolicyContext
from lirs_validation.driving.driver import Driver
from lirs_wct.arrays import Float32Array
from lirs_wct.geometry.pose import Pose2


class DrivenPolicy(ABC):
    """A policy that asks a driver for its command at each step; of a robot that flies the height stays."""

    def __init__(self, context: PolicyContext) -> None:
        self.context = context
        self._time = 0.0

    @abstractmethod
    def driver(self) -> Driver:
        """Return the driver of the episode that begins."""

    @abstractmethod
    def pose(self, observation: Mapping[str, Any]) -> Pose2:
        """Return the robot's pose in the driver's frame."""

    def reset(self, info: Mapping[str, Any]) -> None:
        """Begin an episode."""
        self._time, self._driver = 0.0, self.driver()

    def act(self, observation: Mapping[str, Any]) -> Float32Array:
        """Return the driver's command as an action."""
        twist = self._driver.command(self.pose(observation), self._time)
        self._time += self.context.period
        action = np.zeros(self.context.action_size, np.float32)
        action[0] = np.clip(twist.v / self.context.robot.max_speed, -1, 1)
        action[1] = np.clip(twist.omega / self.context.robot.max_turn_rate, -1, 1)
        return action
