"""Random drive of a robot at full speed.

It hits walls, falls off ledges, tips over and is set down again.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import cycle, zip_longest

import cv2
import numpy as np

from lirs_envs.collisions import check_divergence
from lirs_envs.placement import can_stand, standing_pose
from lirs_envs.robot_model import RobotModel
from lirs_envs.robots.drive import make_controllers
from lirs_envs.robots.robot import Robot, Twist
from lirs_envs.simulation import ROW
from lirs_validation.collision.contact_log import ContactLog, ContactRecorder
from lirs_validation.driving.choice import no_room
from lirs_wct import Pose2, SimulationError, World
from lirs_wct.navigation.spawn_poses import largest_area

PERIOD = 0.04
"""Seconds between two looks at the robot's state: a whole number of steps."""
HELD = 1.6
"""Seconds for which a command is held."""
FLIGHT = 3.0
"""Meters a second at which a robot that flies follows terrain."""
LYING = 1.0
"""Seconds for which a robot that has tipped is driven on: its body must not sink either."""
LONGEST = 10.0
"""Seconds after which a robot is set down elsewhere."""
PLACES, TRIES = 8, 64
"""Places of each kind, and how many are tried."""
MARGIN = 0.1
"""Meters beyond the robot's radius that are free where it is set down."""


@dataclass(frozen=True)
class Leg:
    """Part of a drive between two resets.

    It ends when the robot tips, leaves the world, or time is up.

    Attributes:
        log: every step.
        commanded: (n,) wanted speed ahead at each step, m/s.
        tipped: whether it ended lying.
        diverged: why the simulation could not go on; empty = it could.
    """

    log: ContactLog
    commanded: tuple[float, ...]
    tipped: bool
    diverged: str


def places(world: World, robot: Robot, rng: np.random.Generator) -> list[Pose2]:
    """Return start poses, alternately in the open and next to an obstacle.

    Of a world with a start that was asked for, this alone.

    Raises:
        ConfigError: there is none.
        SimulationError: the robot cannot stand at the start that was asked for.
    """
    if world.start is not None:
        standing_pose(world, robot, world.start)
        return [world.start]
    free = world.driven(world.traversable(clearance=robot.radius + MARGIN, max_slope=robot.max_slope))
    inside = cv2.erode(free.free.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=0)
    edge = free.centers(np.argwhere(largest_area(free.free) & (inside == 0)))
    beside = [
        Pose2(float(edge[k, 0]), float(edge[k, 1]), float(rng.uniform(-math.pi, math.pi)))
        for k in rng.integers(len(edge), size=TRIES if len(edge) else 0).tolist()
    ]
    found = [
        [start for start in starts if can_stand(world, robot, start)][:PLACES]
        for starts in (world.starts(free, PLACES), beside)
    ]
    if not any(found):
        raise no_room(world.name, world, robot, MARGIN)
    return [start for pair in zip_longest(*found) for start in pair if start is not None]


def drive_at_random(
    body: RobotModel, world: World, robot: Robot, seconds: float, rng: np.random.Generator
) -> Iterator[Leg]:
    """Drive for a time, leg after leg, each from another place.

    Raises:
        ConfigError: the robot can stand nowhere.
    """
    starts = places(world, robot, rng)
    left, longest = math.ceil(seconds / body.timestep), round(LONGEST / body.timestep)
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
    recorder, commanded = ContactRecorder(body), list[float]()
    every, tipped, diverged = round(HELD / body.timestep), False, ""
    command, rest = Twist(), steps
    while len(commanded) < steps and rest > 0:
        for piece in body.substeps:
            if len(commanded) % every < piece:
                command = _command(robot, rng)
            twists, rates = np.array(((command.v, command.omega, command.climb),)), np.array((body.rates(),))
            controllers.update(ROW, twists, rates, piece * body.timestep, body.ctrl[None])
            for _ in range(piece):
                recorder.step()
            commanded += [command.v] * piece
            rest -= piece
        try:
            check_divergence(body.data)
        except SimulationError as error:
            diverged = str(error)
            break
        x, y, _ = body.pose().position.tolist()
        if not world.surface.contains(x, y) or _fallen(body, world):
            break
        if not tipped and body.tipped:
            tipped, rest = True, min(rest, round(LYING / body.timestep))
    return Leg(recorder.log(), tuple(commanded), tipped, diverged)


def _command(robot: Robot, rng: np.random.Generator) -> Twist:
    """Return full speed ahead or, one time in three, back; straight or in a curve."""
    ahead, turn = float(rng.choice((-1.0, 1.0, 1.0))), float(rng.uniform(-1, 1) * rng.integers(2))
    speed = min(robot.max_speed, FLIGHT) if robot.flies else robot.max_speed
    return Twist(ahead * speed, turn * robot.max_turn_rate)


def _fallen(body: RobotModel, world: World) -> bool:
    """Whether the robot fell into a hole of the floor."""
    return body.pose().z < float(world.surface.z.min()) - 1.0
