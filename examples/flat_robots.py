"""Robots on flat floor plans without physics, for `train_pretrained.py`: a sixth of the processor time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np

from lirs_envs.lidar.presets import make_lidar_preset
from lirs_envs.policies import PolicyContext
from lirs_envs.robots.robot import make_robot
from lirs_envs.tasks.site import draw_goal, make_site
from lirs_wct import World
from lirs_wct.arrays import FloatArray, njit

BEAMS = 121
"""Beams of a scan, at most."""
SUBSTEPS = 4
BODY = 0.85
"""Radius that collides, as a share of the robot's."""


class FlatRobots:
    """Discs with the speeds, accelerations and lidars of robots; the interface is that of the vectors.

    Args:
        worlds: floor plans; robot i of N is in world i * W // N.
        robot: name.
        count: number of robots, N.
        control_hz: steps a second.
        difficulty: difficulty of the goals, 0 to 1.
        time_limit: seconds until an episode is truncated.

    Attributes:
        sites: free ground of each robot.
        context: context of a policy.
    """

    def __init__(
        self,
        worlds: Sequence[World],
        robot: str,
        count: int,
        control_hz: float,
        difficulty: float,
        time_limit: float,
    ) -> None:
        figures = make_robot(robot)
        lidar = make_lidar_preset(figures.lidar)
        lidar = replace(lidar, beams=min(lidar.beams, BEAMS))
        self.context = PolicyContext(robot=figures, lidar=lidar, period=1 / control_hz)
        sites, clearances = [make_site(world, figures) for world in worlds], [_clearance(w) for w in worlds]
        self.sites = [sites[i * len(worlds) // count] for i in range(count)]
        self._clearances = [clearances[i * len(worlds) // count] for i in range(count)]
        self._corners = [world.walls.origin for world in worlds if world.walls]
        self._corners = [self._corners[i * len(worlds) // count] for i in range(count)]
        self._difficulty, self._steps = difficulty, round(time_limit * control_hz)
        self._states, self._starts, self._goals = (
            np.zeros((count, 5)),
            np.zeros((count, 3)),
            np.zeros((count, 2)),
        )
        self._ways, self._ages = np.zeros(count), np.zeros(count, np.int64)
        self._rng = np.random.default_rng()

    def reset(self, *, seed: int) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin all episodes."""
        self._rng = np.random.default_rng(seed)
        for i in range(len(self.sites)):
            self._begin(i)
        return self._observe(), self._infos()

    def _begin(self, i: int) -> None:
        site, goal = self.sites[i], None
        while goal is None:
            start = site.draw_start(self._rng)
            goal = draw_goal(site, start, self._difficulty, self._rng)
        row, col = site.grid.cells(goal).tolist()
        self._ways[i] = site.distances(start.x, start.y)[row, col]
        self._states[i], self._starts[i] = (start.x, start.y, start.yaw, 0, 0), start.as_array()
        self._goals[i], self._ages[i] = goal, 0

    def step(self, actions: FloatArray) -> tuple[dict[str, Any], None, Any, Any, dict[str, Any]]:
        """Act for one period, and begin the episodes anew that end."""
        robot, success = self.context.robot, np.zeros(len(self.sites), np.bool_)
        reasons = np.full(len(self.sites), "", dtype=object)
        commands = np.clip(actions, -1, 1) * (robot.max_speed, robot.max_turn_rate)
        limits = (
            np.array((robot.max_acceleration, robot.max_turn_acceleration)) * self.context.period / SUBSTEPS
        )
        self._ages += 1
        for i, (clearance, corner) in enumerate(zip(self._clearances, self._corners, strict=True)):
            hit = _move(
                self._states[i], commands[i], limits, self.context.period / SUBSTEPS, clearance,
                (corner.x, corner.y), BODY * robot.radius,
            )  # fmt: skip
            success[i] = np.hypot(*(self._goals[i] - self._states[i, :2])) <= max(0.5, robot.radius)
            reasons[i] = "success" if success[i] else "collision" if hit else ""
        terminated, truncated = reasons != "", self._ages >= self._steps
        final = self._infos() | {"reason": reasons, "success": success}
        for i in np.flatnonzero(terminated | truncated).tolist():
            self._begin(i)
        return self._observe(), None, terminated, truncated, self._infos() | {"final_info": final}

    def close(self) -> None:
        """Release nothing, as the vectors do."""

    def _infos(self) -> dict[str, Any]:
        poses = self._states[:, :3].copy()
        return {"T_world_base": poses, "goal": self._goals.copy(), "shortest_path": self._ways.copy()}

    def _observe(self) -> dict[str, Any]:
        context, yaw = self.context, self._states[:, 2]
        away = self._goals - self._states[:, :2]
        bearing = np.arctan2(away[:, 1], away[:, 0]) - yaw
        moved, turned = self._states[:, :2] - self._starts[:, :2], self._starts[:, 2]
        c, s = np.cos(turned), np.sin(turned)
        odometry = c * moved[:, 0] + s * moved[:, 1], c * moved[:, 1] - s * moved[:, 0], yaw - turned
        mount = np.array(context.robot.T_base_laser.position[:2])
        scans = [
            _scan(
                self._states[i],
                mount,
                context.lidar.angles,
                context.lidar.range_max,
                clearance,
                (corner.x, corner.y),
            )
            for i, (clearance, corner) in enumerate(zip(self._clearances, self._corners, strict=True))
        ]
        goal = np.hypot(*away.T), np.remainder(bearing + math.pi, math.tau) - math.pi
        return {"scan": np.array(scans), "goal": np.column_stack(goal), "odometry": np.column_stack(odometry)}


def _clearance(world: World) -> FloatArray:
    """Return (rows, cols) meters from each cell to the nearest wall."""
    assert world.walls is not None, "floor plans have walls"
    open_cells = np.pad((~world.walls.solid).astype(np.uint8), 1)
    found = cv2.distanceTransform(open_cells, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1]
    clearance: FloatArray = found.astype(np.float64) * world.walls.resolution
    return clearance


CELL = 0.05
"""Edge of a cell of floor plans, meters."""


@njit(cache=True, nogil=True)
def _at(clearance: FloatArray, corner: tuple[float, float], x: float, y: float) -> float:
    row, col = int((y - corner[1]) / CELL), int((x - corner[0]) / CELL)
    if 0 <= row < clearance.shape[0] and 0 <= col < clearance.shape[1]:
        return float(clearance[row, col])
    return 0.0


@njit(cache=True, nogil=True)
def _move(
    state: FloatArray, command: FloatArray, limits: FloatArray, dt: float, clearance: FloatArray,
    corner: tuple[float, float], body: float,
) -> bool:  # fmt: skip
    """Drive a robot for a step; return whether it touched a wall."""
    for _ in range(SUBSTEPS):
        for k in range(2):
            state[3 + k] += min(max(command[k] - state[3 + k], -limits[k]), limits[k])
        state[2] += state[4] * dt
        state[0] += state[3] * dt * math.cos(state[2])
        state[1] += state[3] * dt * math.sin(state[2])
        if _at(clearance, corner, state[0], state[1]) < body:
            return True
    return False


@njit(cache=True, nogil=True)
def _scan(
    state: FloatArray, mount: FloatArray, angles: FloatArray, range_max: float, clearance: FloatArray,
    corner: tuple[float, float],
) -> FloatArray:  # fmt: skip
    """Return ranges (beams,), each by steps of the clearance (sphere tracing)."""
    c, s = math.cos(state[2]), math.sin(state[2])
    x0, y0 = state[0] + c * mount[0] - s * mount[1], state[1] + s * mount[0] + c * mount[1]
    found = np.empty(len(angles))
    for k in range(len(angles)):
        dx, dy, r = math.cos(state[2] + angles[k]), math.sin(state[2] + angles[k]), 0.0
        while r < range_max:
            room = _at(clearance, corner, x0 + r * dx, y0 + r * dy)
            if room <= 0.0:
                break
            r += max(room - 0.7 * CELL, 0.5 * CELL)
        found[k] = min(r, range_max)
    return found
