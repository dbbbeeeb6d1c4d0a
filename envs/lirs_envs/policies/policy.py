"""What a policy is, and what it is told before its first episode."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from lirs_envs.episodes.config import EnvConfig
from lirs_envs.lidar.presets import LidarPreset
from lirs_envs.robots.robot import Robot
from lirs_wct.arrays import Float32Array


class Policy(Protocol):
    """Actions from observations, episode by episode."""

    def reset(self, info: Mapping[str, Any]) -> None:
        """Begin an episode; `info` is what the environment's reset said."""

    def act(self, observation: Mapping[str, Any]) -> Float32Array:
        """Return the action of the next step."""


@dataclass(frozen=True, kw_only=True)
class PolicyContext:
    """The robot that a policy is to drive; a policy's factory takes it.

    Attributes:
        robot: figures of the robot.
        lidar: specification of its lidar.
        period: seconds a step.
        seed: of a policy that draws at random.
    """

    robot: Robot
    lidar: LidarPreset
    period: float
    seed: int = 0

    @staticmethod
    def of(config: EnvConfig, seed: int = 0) -> PolicyContext:
        """Return what the options of an environment mean for its policies."""
        simulation = config.simulation
        return PolicyContext(
            robot=simulation.robot, lidar=simulation.preset, period=1 / config.control_hz, seed=seed
        )

    @property
    def action_size(self) -> int:
        """Numbers of an action: speed ahead, turn rate, and climb of a robot that flies."""
        return 3 if self.robot.flies else 2
