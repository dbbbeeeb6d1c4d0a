"""A robot's figures on made-up ground, each with its limit."""

from __future__ import annotations

import math
from dataclasses import replace

import mujoco
import numpy as np
from scipy.spatial import ConvexHull

from lirs_envs.robots.robot import Robot, Twist, Waypoint
from lirs_envs.simulation import Simulation
from lirs_envs.simulation_config import SimulationConfig
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.geometry.pose import Pose2
from lirs_wct.ground import Terrain
from lirs_wct.world import World

LIDAR = "lms111"
"""The same for all: one tick is 40 ms."""
CLIMBS = {"husky": 30.0, "jackal": 45.0}
"""Degrees; the others 10."""
Row = tuple[str, float, str, bool]
"""What, figure, limit in words, whether it is kept."""


def flat(degrees: float = 0.0) -> World:
    """Level ground; with an angle, from x = -5 on a bend of 2 m radius, then a slope."""
    axis = (np.arange(201) - 100) * 0.1
    angle, s = math.radians(degrees), axis + 5
    end = 2.0 * math.sin(angle)
    z = 2.0 - np.sqrt(4.0 - np.clip(s, 0, end) ** 2) + np.maximum(s - end, 0) * math.tan(angle)
    heights = np.broadcast_to(z, (201, 201)).astype(np.float32)
    return World("flat", Terrain(HeightField.centered(heights, (0.1, 0.1))), spawn_poses=(Pose2(),))


def within(what: str, value: float, low: float, high: float, unit: str = "") -> Row:
    return what, value, f"{low:g} to {high:g} {unit}".strip(), low <= value <= high


def at_rest(robot: Robot) -> list[Row]:
    sim = Simulation(flat(), SimulationConfig(robot=robot, lidar=LIDAR))
    sim.reset()
    start = sim.T_world_base
    for _ in range(250):
        sim.advance(Twist())
    end = sim.T_world_base
    drift = 1e3 * math.hypot(end.x - start.x, end.y - start.y)
    legal = 50.0 if robot.flies else 1.0
    return [
        within("drift in 10 s, mm", drift, 0, legal),
        within("height off, mm", 1e3 * (end.z - robot.base_height), -legal, legal),
    ]


def driven(robot: Robot, command: Twist, start: Pose2) -> tuple[float, float, float]:
    """Speed and turn rate once it is up to them, then the hardest braking (m/s^2) to a stop."""
    sim = Simulation(flat(), SimulationConfig(robot=robot, lidar=LIDAR))
    sim.reset(start)
    ramp = abs(command.v) / robot.max_acceleration + (1.5 if command.omega else 0.0)
    for _ in range(math.ceil((ramp + (0.4 if robot.flies else 1.2)) / sim.period)):
        sim.advance(command)
    way = turned = 0.0
    for _ in range(10):
        before = sim.T_world_base.to_pose2()
        sim.advance(command)
        moved = before.inverse() @ sim.T_world_base.to_pose2()
        way, turned = way + moved.x, turned + moved.yaw
    speeds = [float(np.linalg.norm(sim.body.data.qvel[:2]))]
    for _ in range(math.ceil((ramp + 0.5) / sim.period)):
        sim.advance(Twist())
        speeds.append(float(np.linalg.norm(sim.body.data.qvel[:2])))
    braking = -float(np.diff(speeds).min()) / sim.period
    return way / (10 * sim.period), turned / (10 * sim.period), braking


def on_the_level(robot: Robot) -> list[Row]:
    speed, _, braking = driven(robot, Twist(robot.max_speed), Pose2(-9.0, 0.0))
    _, turn, _ = driven(robot, Twist(0.0, robot.max_turn_rate), Pose2())
    rows = [
        within("full speed, %", 100 * speed / robot.max_speed, 95, 105),
        within("full turn rate, %", 100 * turn / robot.max_turn_rate, 95, 105),
    ]
    if not robot.flies:
        rows.append(within("braking, m/s2", braking, 0, 1.1 * robot.max_acceleration))
    return rows


def climbed(robot: Robot) -> list[Row]:
    degrees = CLIMBS.get(robot.name, 10.0)
    sim = Simulation(flat(degrees), SimulationConfig(robot=robot, lidar=LIDAR))
    sim.reset(Pose2(-5.0 - 2 * robot.radius, 0.0))
    while sim.time < 30 and sim.T_world_base.x < -1.5:
        sim.advance(Twist(min(0.3, robot.max_speed)))
    return [within(f"way up {degrees:g} deg, x, m", sim.T_world_base.x, -1.5, 10)]


def slides(robot: Robot) -> list[Row]:
    """The first whole degree at which gravity, leaned sideways, takes a standing robot away."""
    expected = math.degrees(math.atan(robot.friction))
    for degrees in range(math.floor(expected) - 5, math.ceil(expected) + 6):
        sim = Simulation(flat(), SimulationConfig(robot=robot, lidar=LIDAR))
        sim.reset()
        angle = math.radians(degrees)
        sim.body.model.opt.gravity[:] = (0.0, -9.81 * math.sin(angle), -9.81 * math.cos(angle))
        for _ in range(50):
            sim.advance(Twist())
        if math.hypot(*sim.body.data.qvel[:2]) > 0.3:
            return [within("slides at, deg", degrees, round(expected - 3, 1), round(expected + 3, 1))]
    return [within("slides at, deg", math.nan, expected - 3, expected + 3)]


def tip_angle(sim: Simulation) -> float:
    """Degrees sideways at which the center of mass is above the edge of its feet, as it stands."""
    model, data = sim.body.model, sim.body.data
    mujoco.mj_forward(model, data)
    x, y, z = data.subtree_com[model.body("base_link").id]
    feet = np.array([data.geom_xpos[g][:2] for g in sim.body.wheel_geoms if model.geom_contype[g]])
    # Each row (a, b, c): a x + b y + c <= 0 inside.
    half = min(y + (a * x + c) / b for a, b, c in ConvexHull(feet).equations if b < -1e-6)
    return math.degrees(math.atan(half / z))


def lean(sim: Simulation, degrees: float) -> float:
    """Largest roll in 6 s from its start, degrees, while gravity turns sideways by an angle and stays."""
    gravity, largest = sim.body.model.opt.gravity, 0.0
    gravity[:] = (0.0, 0.0, -9.81)
    sim.reset()
    for k in range(150):
        angle = math.radians(degrees) * min(1.0, (k + 1) / 75)
        gravity[:] = (0.0, -9.81 * math.sin(angle), -9.81 * math.cos(angle))
        sim.advance(Twist())
        largest = max(largest, abs(math.degrees(sim.T_world_base.roll)))
    return largest


def tips(robot: Robot) -> list[Row]:
    """The first whole degree at which a robot that cannot slide falls over sideways.

    MuJoCo's friction is soft: at impratio 1 the robot creeps, and a burger has turned by 12 deg into a wider
    stance before it is tilted far enough to fall. At 100 it stays. A robot on springs leans first
    and falls that much earlier: the limit is that of the leaning robot.
    """
    sim = Simulation(flat(), SimulationConfig(robot=robot, lidar=LIDAR))
    sim.reset()
    sim.body.model.geom_friction[:, 0] = 5.0
    sim.body.model.opt.impratio = 100
    lean(sim, tip_angle(sim) - 10)
    expected = tip_angle(sim)
    tried = range(math.floor(expected) - 5, math.ceil(expected) + 6)
    degrees = next((float(angle) for angle in tried if lean(sim, angle) > 15), math.nan)
    return [within("tips at, deg", degrees, round(expected - 3, 1), round(expected + 3, 1))]


def flight(robot: Robot) -> list[Row]:
    """A step of 2 m, and 3 m/s over hills of 1.5 m."""
    sim = Simulation(flat(), SimulationConfig(robot=robot, lidar=LIDAR))
    sim.reset()
    way = []
    for _ in range(75):
        sim.advance(Waypoint(2.0, 0.0, 1.0))
        way.append(sim.T_world_base.x)
    hills, axis = flat(), (np.arange(201) - 100) * 0.1
    z = 1.5 * np.sin(axis / 1.5)[None, :] * np.cos(axis / 2)[:, None]
    hills = replace(hills, ground=Terrain(HeightField.centered(z.astype(np.float32), (0.1, 0.1))))
    sim = Simulation(hills, SimulationConfig(robot=robot, lidar=LIDAR))
    sim.reset(Pose2(-8.0, 0.0))
    gaps = []
    for _ in range(125):
        sim.advance(Twist(3.0))
        T = sim.T_world_base
        gaps.append(T.z - float(hills.surface.height_at(T.x, T.y)))
    return [
        within("2 m step after 3 s, m", way[-1], 1.95, 2.05),
        within("overshoot, %", 100 * (max(way) / 2 - 1), -5, 20),
        within("lowest over hills, m", min(gaps), 0.4, 2.5),
        within("highest over hills, m", max(gaps), 0.4, 2.5),
    ]


def figures(robot: Robot) -> list[Row]:
    """All of them."""
    own = [flight] if robot.flies else [climbed, slides, tips]
    return [row for part in (at_rest, on_the_level, *own) for row in part(robot)]
