"""Interface of a policy, and baseline policies without learning."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from lirs_envs.episodes.config import EnvConfig
from lirs_envs.lidar.presets import LidarPreset
from lirs_envs.robots.robot import Robot
from lirs_wct.arrays import Float32Array, FloatArray


class Policy(Protocol):
    """Actions from observations, episode by episode."""

    def reset(self, info: Mapping[str, Any]) -> None:
        """Begin an episode; `info` comes from the environment's reset."""

    def act(self, observation: Mapping[str, Any]) -> Float32Array:
        """Return the action of the next step."""


@dataclass(frozen=True, kw_only=True)
class PolicyContext:
    """Robot and lidar of a policy, seconds a step (`period`), and the seed of a random policy."""

    robot: Robot
    lidar: LidarPreset
    period: float
    seed: int = 0

    @staticmethod
    def of(config: EnvConfig, seed: int = 0) -> PolicyContext:
        """Return the context of a policy from an environment's options."""
        simulation = config.simulation
        return PolicyContext(
            robot=simulation.robot, lidar=simulation.preset, period=1 / config.control_hz, seed=seed
        )

    @property
    def action_size(self) -> int:
        """Numbers of an action: speed ahead, turn rate, and climb of a robot that flies."""
        return 3 if self.robot.flies else 2


HOLD = 1.0
"""Seconds for which a random action is held: new actions at each step would cancel out."""


class StraightAhead:
    """Full speed ahead."""

    def __init__(self, context: PolicyContext) -> None:
        self._action = np.zeros(context.action_size, np.float32)
        self._action[0] = 1.0

    def reset(self, info: Mapping[str, Any]) -> None:
        """Begin an episode."""

    def act(self, observation: Mapping[str, Any]) -> Float32Array:
        """Return the one action."""
        return self._action.copy()


class RandomActions:
    """Actions drawn evenly, each held for a second."""

    def __init__(self, context: PolicyContext) -> None:
        self._rng = np.random.default_rng(context.seed)
        self._size, self._hold = context.action_size, max(1, round(HOLD / context.period))
        self._left, self._action = 0, np.zeros(self._size, np.float32)

    def reset(self, info: Mapping[str, Any]) -> None:
        """Begin an episode."""
        self._left = 0

    def act(self, observation: Mapping[str, Any]) -> Float32Array:
        """Return the action that is held, or another."""
        if self._left == 0:
            self._action = self._rng.uniform(-1, 1, self._size).astype(np.float32)
            self._left = self._hold
        self._left -= 1
        return self._action.copy()


SIDE_CLEARANCE = 0.15
"""Lateral clearance of the robot, meters."""
HORIZON = 4.0
"""Distance beyond which obstacles are ignored, meters."""
HEADINGS = np.radians(np.arange(-132, 133, 4))
"""Candidate headings relative to the robot's heading."""
DETOUR, CHANGE = 1.6, 0.35
"""Reward of a free horizon, in radians off the goal; cost per radian off the last heading."""
CAUTION = 1.0
"""Time headway to obstacles ahead, seconds."""
PATIENCE, BACK_OFF = 6.0, 1.5
"""Seconds without progress after which the robot backs off, and for how long."""
PROGRESS = 0.3
"""Least approach to the goal that counts as progress, meters."""


class GoToGoal:
    """Reactive baseline without a map: drive to the goal around obstacles in the scan.

    From a set of headings the robot takes one near the goal's bearing with a long free distance for a disc of
    its size. It is the vector field histogram (Borenstein and Koren 1991) with this distance instead of the
    histogram. Without progress for a while the robot backs off. A flying robot keeps its height.
    """

    def __init__(self, context: PolicyContext) -> None:
        robot, lidar = context.robot, context.lidar
        self._size, self._period = context.action_size, context.period
        self._radius = robot.radius + SIDE_CLEARANCE
        self._speed, self._turn = robot.max_speed, robot.max_turn_rate
        angles = lidar.angle_min + lidar.angle_increment * np.arange(lidar.beams)
        self._beams = np.column_stack((np.cos(angles), np.sin(angles)))
        self._range_max = lidar.range_max
        self._mount = np.array(robot.T_base_laser.position[:2])
        self._rng = np.random.default_rng(context.seed)
        self.reset({})

    def reset(self, info: Mapping[str, Any]) -> None:
        """Begin an episode."""
        self._heading, self._nearest, self._waited, self._backing = 0.0, math.inf, 0.0, 0.0
        self._side = 1.0

    def act(self, observation: Mapping[str, Any]) -> Float32Array:
        """Return the action from the groups `scan` and `goal`."""
        distance, bearing = (float(value) for value in observation["goal"])
        free = self._free_ways(np.asarray(observation["scan"], dtype=np.float64), distance)
        if self._must_back_off(distance):
            return self._action(-0.4 * self._speed, self._side * 0.5 * self._turn)
        off_goal = np.abs(np.remainder(HEADINGS - bearing + math.pi, 2 * math.pi) - math.pi)
        cost = off_goal + CHANGE * np.abs(HEADINGS - self._heading)
        reach = min(HORIZON, max(distance, self._radius))
        cost -= DETOUR * np.minimum(free, reach) / reach
        best = int(np.argmin(cost))
        self._heading = heading = float(HEADINGS[best])
        ahead = float(np.interp(0.0, HEADINGS, free))
        speed = min(self._speed, ahead / CAUTION, distance) * max(0.0, math.cos(heading)) ** 2
        return self._action(speed, 1.5 * heading)

    def _free_ways(self, scan: FloatArray, distance: float) -> FloatArray:
        """Return meters that the robot's disc can go along each heading, at most the horizon."""
        hit = (scan > 0.0) & (scan < min(self._range_max, HORIZON + self._radius, distance + self._radius))
        points = scan[hit, None] * self._beams[hit] + self._mount
        ahead = points @ np.array((np.cos(HEADINGS), np.sin(HEADINGS)))
        beside = points @ np.array((-np.sin(HEADINGS), np.cos(HEADINGS)))
        inside = self._radius**2 - beside**2
        way = np.where((inside > 0) & (ahead > 0), ahead - np.sqrt(np.maximum(inside, 0)), HORIZON)
        least: FloatArray = np.clip(way.min(axis=0, initial=HORIZON), 0.0, HORIZON)
        return least

    def _must_back_off(self, distance: float) -> bool:
        """Note the progress; whether the robot is backing off."""
        if self._backing > 0:
            self._backing -= self._period
            return True
        if distance < self._nearest - PROGRESS:
            self._nearest, self._waited = distance, 0.0
        self._waited += self._period
        if self._waited > PATIENCE:
            self._waited, self._backing, self._nearest = 0.0, BACK_OFF, distance
            self._side = float(self._rng.choice((-1.0, 1.0)))
        return False

    def _action(self, speed: float, turn_rate: float) -> Float32Array:
        action = np.zeros(self._size, np.float32)
        action[0] = np.clip(speed / self._speed, -1, 1)
        action[1] = np.clip(turn_rate / self._turn, -1, 1)
        return action
