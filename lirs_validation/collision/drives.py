"""Drives of the collision validation: at random at full speed, and up the steepest slope.

In the random drive the robot hits walls, falls off ledges, tips over and is set down again; each step is
logged.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import cycle, zip_longest
from typing import Any, NamedTuple

import cv2
import mujoco
import numpy as np

from lirs_envs.robot_model import RobotModel, check_divergence
from lirs_envs.robots.control import make_controllers
from lirs_envs.robots.robot import Robot, Twist
from lirs_envs.simulation import ROW
from lirs_envs.simulation_config import can_stand, standing_pose
from lirs_validation.driving.choice import no_room
from lirs_wct import FloatArray, Pose2, SimulationError, World
from lirs_wct.navigation import largest_area

MAX_DEPTH = 0.010
"""Penetration that a contact may have whatever happens, meters."""
PERIOD = 0.04
"""Seconds between two looks at the robot's state: a whole number of steps."""
COMMAND_SECONDS = 1.6
"""Seconds for which a command is held."""
FLIGHT_SPEED = 3.0
"""Speed at which a robot that flies follows terrain, m/s."""
LYING_SECONDS = 1.0
"""Seconds for which a robot that has tipped is driven on: its body must not sink either."""
LEG_SECONDS = 10.0
"""Seconds after which a robot is set down elsewhere."""
PLACES, TRIES = 8, 64
"""Number of places of each kind, and of tries to find them."""
CLEARANCE = 0.1
"""Meters beyond the robot's radius that are free where it is set down."""


class DeepContact(NamedTuple):
    """Contact deeper than `MAX_DEPTH`.

    Its step, depth in meters, (3,) point, (3,) normal out of the ground.
    """

    step: int
    depth: float
    point: FloatArray
    normal: FloatArray


@dataclass(frozen=True, kw_only=True)
class Leg:
    """Part of a drive between two resets, with one row per simulation step.

    It ends when the robot tips, leaves the world, or time is up. All values belong to a step's beginning,
    where MuJoCo finds contacts.

    Attributes:
        position: (n, 3) positions of base_link, meters.
        upright: (n,) cosines of the angle by which the robot leans.
        velocity: (n, 3) velocities of base_link in the world, m/s.
        spin: (n, 3) turn rates in the world, rad/s.
        bodies: (n, bodies, 3) centers of mass of all moving bodies, meters.
        depth: (n,) deepest penetrations, meters; 0 without contact.
        peak_force: (n,) largest normal forces of a contact, newtons.
        force: (n,) sums of all normal forces, newtons.
        energy: (n,) kinetic, potential and spring energies, joules.
        kinetic: (n,) kinetic energies, joules.
        work: (n,) works of the motors during the step, joules.
        commanded: (n,) wanted speeds ahead, m/s.
        deep: Deepest contact of each step where it is deeper than `MAX_DEPTH`.
        timestep: Duration of a step, seconds.
        tipped: Whether it ended lying.
        diverged: Reason why the simulation could not go on; empty = it could.
    """

    position: FloatArray
    upright: FloatArray
    velocity: FloatArray
    spin: FloatArray
    bodies: FloatArray
    depth: FloatArray
    peak_force: FloatArray
    force: FloatArray
    energy: FloatArray
    kinetic: FloatArray
    work: FloatArray
    commanded: FloatArray
    deep: tuple[DeepContact, ...]
    timestep: float
    tipped: bool
    diverged: str


class ContactRecorder:
    """Makes steps and notes each; nobody but the robot may touch anything in its model."""

    def __init__(self, body: RobotModel) -> None:
        self.body = body
        model = body.model
        model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
        self._own = model.geom_bodyid > 0
        # A velocity servo's force changes with the speed within the step: integration is implicit.
        self._damping = model.actuator_biasprm[:, 2].copy()
        self._most = np.where(model.actuator_forcelimited, model.actuator_forcerange[:, 1], np.inf)
        self._moment = np.zeros((model.nu, model.nv))
        self._rows: list[dict[str, FloatArray | float]] = []
        self._deep: list[DeepContact] = []

    def __len__(self) -> int:
        return len(self._rows)

    def step(self, commanded: float = 0.0) -> None:
        """Make one step with the present controls; the wanted speed ahead is noted, m/s."""
        body, data = self.body, self.body.data
        rotation = body.pose().rotation
        row: dict[str, FloatArray | float] = {
            "position": data.qpos[:3].copy(),
            "upright": float(rotation[2, 2]),
            "velocity": data.qvel[:3].copy(),
            "spin": rotation @ data.qvel[3:6],
            "commanded": commanded,
        }
        body.step(1)
        potential, kinetic = data.energy.tolist()
        depth, peak, force = self._contacts() if data.ncon else (0.0, 0.0, 0.0)
        row |= {"bodies": data.xipos[1:].copy(), "depth": depth, "peak_force": peak, "force": force}
        row |= {"energy": potential + kinetic, "kinetic": kinetic, "work": self._work()}
        self._rows.append(row)

    def leg(self, *, tipped: bool = False, diverged: str = "") -> Leg:
        """Return the log of all steps."""
        columns: Any = {name: np.array([row[name] for row in self._rows]) for name in self._rows[0]}
        timestep = self.body.timestep
        return Leg(**columns, deep=tuple(self._deep), timestep=timestep, tipped=tipped, diverged=diverged)

    def _work(self) -> float:
        """Return the motors' work in the last step: force times mean speed."""
        data, moment = self.body.data, self._moment
        mujoco.mju_sparse2dense(
            moment, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind
        )
        before = data.actuator_velocity
        after = moment @ data.qvel
        force = data.actuator_force
        # At its limit it stays as it is.
        force = force + np.where(np.abs(force) < self._most, self._damping * (after - before), 0.0)
        return float(force @ (before + after) / 2 * self.body.timestep)

    def _contacts(self) -> tuple[float, float, float]:
        """Return deepest penetration, largest normal force and force sum; log a deep contact.

        Only the deepest contact of a step tells how far the robot is in: ground is many convex pieces, and
        the way out of one, maybe sideways into its neighbor, is never longer than the way out of them all.
        """
        data = self.body.data
        contact = data.contact
        depth = -contact.dist
        i = int(depth.argmax())
        if depth[i] > MAX_DEPTH:
            # MuJoCo's normal points from the first geom to the second.
            out = contact.frame[i, :3] * (1.0 if self._own[contact.geom[i, 1]] else -1.0)
            self._deep.append(DeepContact(len(self._rows), float(depth[i]), contact.pos[i].copy(), out))
        rows = contact.efc_address
        normal = data.efc_force[rows[rows >= 0]]
        return max(float(depth.max()), 0.0), float(normal.max(initial=0.0)), float(normal.sum())


def places(world: World, robot: Robot, rng: np.random.Generator) -> list[Pose2]:
    """Return start poses, alternately in the open and next to an obstacle.

    Of a world with a start that was asked for, this alone.
    """
    if world.start is not None:
        standing_pose(world, robot, world.start)
        return [world.start]
    free = world.driven(world.traversable(clearance=robot.radius + CLEARANCE, max_slope=robot.max_slope))
    inside = cv2.erode(free.free.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=0)
    edge = free.centers(np.argwhere(largest_area(free.free) & (inside == 0)))
    beside = [
        Pose2(float(edge[k, 0]), float(edge[k, 1]), float(rng.uniform(-math.pi, math.pi)))
        for k in rng.integers(len(edge), size=TRIES if len(edge) else 0).tolist()
    ]
    kinds = [
        [start for start in starts if can_stand(world, robot, start)][:PLACES]
        for starts in (world.starts(free, PLACES), beside)
    ]
    if not any(kinds):
        raise no_room(world.name, world, robot, CLEARANCE)
    return [start for pair in zip_longest(*kinds) for start in pair if start is not None]


def drive_at_random(
    body: RobotModel, world: World, robot: Robot, seconds: float, rng: np.random.Generator
) -> Iterator[Leg]:
    """Drive for a time, leg after leg, each from another place."""
    starts = places(world, robot, rng)
    left, longest = math.ceil(seconds / body.timestep), round(LEG_SECONDS / body.timestep)
    for start in cycle(starts):
        body.settle(standing_pose(world, robot, start))
        leg = _leg(body, world, robot, min(left, longest), rng)
        yield leg
        left -= len(leg.commanded)
        if leg.diverged or left <= 0:
            return


def _leg(body: RobotModel, world: World, robot: Robot, steps: int, rng: np.random.Generator) -> Leg:
    controllers = make_controllers(robot, body.actuators, [body], [world.surface], [None])
    controllers.begin(0)
    recorder, command = ContactRecorder(body), Twist()
    full_speed = min(robot.max_speed, FLIGHT_SPEED) if robot.flies else robot.max_speed
    every, tipped, rest = round(COMMAND_SECONDS / body.timestep), False, steps
    while len(recorder) < steps and rest > 0:
        for piece in body.substeps:
            if len(recorder) % every < piece:
                # Full speed ahead or, one time in three, back; straight or in a curve.
                ahead, turn = float(rng.choice((-1.0, 1.0, 1.0))), float(rng.uniform(-1, 1) * rng.integers(2))
                command = Twist(ahead * full_speed, turn * robot.max_turn_rate)
            twists, rates = np.array(((command.v, command.omega, command.climb),)), np.array((body.rates(),))
            controllers.update(ROW, twists, rates, piece * body.timestep, body.ctrl[None])
            for _ in range(piece):
                recorder.step(command.v)
            rest -= piece
        try:
            check_divergence(body.data)
        except SimulationError as error:
            return recorder.leg(tipped=tipped, diverged=str(error))
        x, y, z = body.pose().position.tolist()
        fell_into_hole = z < float(world.surface.z.min()) - 1.0
        if fell_into_hole or not world.surface.contains(x, y):
            break
        if not tipped and body.tipped:
            tipped, rest = True, min(rest, round(LYING_SECONDS / body.timestep))
    return recorder.leg(tipped=tipped)


MAX_SLOPE_CELLS = 20_000
"""Free cells that are searched for slopes."""
SLOPE_TRIES = 20
"""Steepest places that are tried: on some an obstacle stands beside the slope."""
HOLD_SECONDS = 2.0
"""Seconds for which the wheels hold before it climbs."""
CLIMB_SPEED = 0.3
"""Speed of the climb, m/s; at most the robot's own."""


class Climb(NamedTuple):
    """Result of the slope test.

    Attributes:
        slope: Slope of the ground under the robot, degrees.
        slid: Sliding distance while it should stand, without the rolling of its wheels, meters.
        climbed: Share of the commanded distance that it came uphill.
    """

    slope: float
    slid: float
    climbed: float


def climb(body: RobotModel, world: World, robot: Robot) -> Climb | None:
    """Test holding and climbing at the steepest place; None where it cannot stand."""
    for slope, start in _steepest(world, robot):
        try:
            body.settle(standing_pose(world, robot, start))
        except SimulationError:
            continue
        before, angles = body.pose(), body.wheel_angles()
        body.ctrl[:] = 0.0
        body.step(round(HOLD_SECONDS / body.timestep))
        # A wheel's servo has no integral part: it turns at torque / kv, which says nothing of the contact.
        rolled = robot.wheel_radius * float(np.mean(np.subtract(body.wheel_angles(), angles)))
        moved = body.pose().position - before.position
        slid = float(np.linalg.norm(moved - rolled * before.rotation[:, 0]))
        return Climb(math.degrees(slope), slid, _climb_share(body, robot, start.yaw))
    return None


def _climb_share(body: RobotModel, robot: Robot, uphill: float) -> float:
    """Return the driven share of the commanded distance, both from the moment of full speed on."""
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
    v = min(CLIMB_SPEED, robot.max_speed)
    return v, v / robot.max_acceleration + 0.2, 2 * robot.radius


def _steepest(world: World, robot: Robot) -> list[tuple[float, Pose2]]:
    """Return slopes (radians) and poses facing uphill to free ground, the steepest legal ones first."""
    free = world.traversable(clearance=robot.radius + CLEARANCE, max_slope=robot.max_slope)
    cells = np.argwhere(free.free)
    x, y = free.centers(cells[:: max(1, len(cells) // MAX_SLOPE_CELLS)]).T
    if len(x) == 0:
        return []
    r, z = robot.radius, world.surface.height_at
    east, north = (z(x + r, y) - z(x - r, y)) / (2 * r), (z(x, y + r) - z(x, y - r)) / (2 * r)
    slope = np.nan_to_num(np.arctan(np.hypot(east, north)), nan=np.inf)
    uphill = np.nan_to_num(np.arctan2(north, east))
    v, ramp, distance = _course(robot)
    length = v * ramp + distance
    ends = free.cells(np.stack((x + length * np.cos(uphill), y + length * np.sin(uphill)), axis=-1))
    inside = np.clip(ends, 0, np.array(free.shape) - 1)
    slope = np.where(free.free[inside[:, 0], inside[:, 1]] & (inside == ends).all(axis=1), slope, np.inf)
    order = np.argsort(-np.where(slope <= robot.max_slope, slope, -1.0), kind="stable")[:SLOPE_TRIES]
    return [
        (float(slope[i]), Pose2(float(x[i]), float(y[i]), float(uphill[i])))
        for i in order.tolist()
        if slope[i] <= robot.max_slope
    ]
