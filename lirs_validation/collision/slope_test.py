"""Slope test: does a robot hold and climb on the steepest drivable ground?"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lirs_envs.placement import standing_pose
from lirs_envs.robot_model import RobotModel
from lirs_envs.robots.drive import make_controllers
from lirs_envs.robots.robot import Robot
from lirs_envs.simulation import ROW
from lirs_validation.collision.random_drive import MARGIN
from lirs_wct import Pose2, SimulationError, World

PLACES = 20_000
"""Free cells that are looked at, at most."""
TRIES = 20
"""Of the steepest places, so many are tried: on some an obstacle stands beside the slope."""
HELD = 2.0
"""Seconds for which the wheels hold before it climbs."""
SPEED = 0.3
"""Meters a second of the climb, or the robot's most."""


@dataclass(frozen=True)
class Climb:
    """Result of the slope test.

    Attributes:
        slope: of the ground under the robot, degrees.
        slid: sliding distance while it should stand, without the rolling of its wheels, meters.
        climbed: share of the commanded distance that it came uphill.
    """

    slope: float
    slid: float
    climbed: float


def climb(body: RobotModel, world: World, robot: Robot) -> Climb | None:
    """Test holding and climbing at the steepest drivable place.

    The place is one robot's length long. None if the robot cannot stand anywhere.
    """
    for slope, start in _steepest(world, robot):
        try:
            body.settle(standing_pose(world, robot, start))
        except SimulationError:
            continue
        return Climb(math.degrees(slope), _slid(body, robot), _climb_share(body, robot, start.yaw))
    return None


def _slid(body: RobotModel, robot: Robot) -> float:
    """Return meters that a robot slides while it should stand.

    The rolling of its wheels is subtracted.

    A wheel's servo has no integral part: it turns at torque / kv, which says nothing of the contact.
    """
    before, angles = body.pose(), body.wheel_angles()
    body.ctrl[:] = 0.0
    body.step(round(HELD / body.timestep))
    rolled = robot.wheel_radius * float(np.mean(np.subtract(body.wheel_angles(), angles)))
    moved = body.pose().position - before.position
    return float(np.linalg.norm(moved - rolled * before.rotation[:, 0]))


def _climb_share(body: RobotModel, robot: Robot, uphill: float) -> float:
    """Return the driven share of the commanded distance.

    Both are counted once the robot is up to speed.
    """
    controllers, (v, ramp, distance) = make_controllers(robot, body.actuators, [body]), _course(robot)
    controllers.begin(0)
    axis = np.array((math.cos(uphill), math.sin(uphill)))
    before, time, twists = body.pose().position, 0.0, np.array(((v, 0.0, 0.0),))
    began: float | None = None
    while time < ramp + distance / v:
        for piece in body.substeps:
            dt = piece * body.timestep
            controllers.update(ROW, twists, np.array((body.rates(),)), dt, body.ctrl[None])
            body.step(piece)
            time += dt
        if began is None and time >= ramp:
            before, began = body.pose().position, time
    moved = body.pose().position - before
    length = math.hypot(float(moved[:2] @ axis), float(moved[2])) if moved[:2] @ axis > 0 else 0.0
    return length / (v * (time - (began or 0.0)))


def _course(robot: Robot) -> tuple[float, float, float]:
    """Return speed, time until it is reached, and distance that then counts; m/s, s, m."""
    v = min(SPEED, robot.max_speed)
    return v, v / robot.max_acceleration + 0.2, 2 * robot.radius


def _steepest(world: World, robot: Robot) -> list[tuple[float, Pose2]]:
    """Return slopes (radians) and poses facing uphill, from where the climb ends on free ground.

    The steepest legal ones come first.
    """
    free = world.traversable(clearance=robot.radius + MARGIN, max_slope=robot.max_slope)
    cells = np.argwhere(free.free)
    x, y = free.centers(cells[:: max(1, len(cells) // PLACES)]).T
    if len(x) == 0:
        return []
    r, z = robot.radius, world.surface.height_at
    east, north = (z(x + r, y) - z(x - r, y)) / (2 * r), (z(x, y + r) - z(x, y - r)) / (2 * r)
    slope = np.nan_to_num(np.arctan(np.hypot(east, north)), nan=np.inf)
    uphill = np.nan_to_num(np.arctan2(north, east))
    v, ramp, distance = _course(robot)
    length = v * ramp + distance
    ends = free.cells(np.stack((x + length * np.cos(uphill), y + length * np.sin(uphill)), axis=-1))
    held = np.clip(ends, 0, np.array(free.shape) - 1)
    slope = np.where(free.free[held[:, 0], held[:, 1]] & (held == ends).all(axis=1), slope, np.inf)
    order = np.argsort(-np.where(slope <= robot.max_slope, slope, -1.0), kind="stable")[:TRIES]
    return [
        (float(slope[i]), Pose2(float(x[i]), float(y[i]), float(uphill[i])))
        for i in order.tolist()
        if slope[i] <= robot.max_slope
    ]
