"""Collision validation (the paper's III-D): do robot and world touch like solids?

A robot is driven at random at full speed, again and again from other places, and every step of MuJoCo is
looked at; then it holds and climbs on the steepest ground that it may drive. Each metric that has a limit is
held against it:

- penetration stays below 10 mm in 99.9 % of the steps; beyond that only impacts go deeper, by at most 10 ms
  times the speed at which the robot came;
- no center of a body is ever inside ground or wall, by the world's own heights and cells;
- energy: contacts and brakes only take it. What a robot gains within a second beyond the work of its motors
  can only have been stored in a contact: at most the weight raised by the legal penetration, m g 10 mm, and
  what a critically damped contact gives back of an impact, exp(-4) of the kinetic energy (the spring
  pushes until omega t = 2, when the speed is exp(-2) of the first one, reversed);
- the simulation never diverges;
- on the slope the robot does not slide and comes up.

Forces, tip-overs and stuck time are reported without a limit: they belong to the drive, not to the contacts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lirs_envs.placement import check_fit, standing_pose
from lirs_envs.robot_model import RobotModel
from lirs_envs.robots.drive import make_controllers
from lirs_envs.robots.robot import Robot
from lirs_envs.simulation import ROW
from lirs_envs.simulation_config import SimulationConfig
from lirs_validation.collision import contact_metrics
from lirs_validation.collision.random_drive import DEEP, MARGIN, PERIOD, drive_at_random
from lirs_wct import Pose2, SimulationError, World
from lirs_wct.checks import check_seed, positive
from lirs_wct.contact import ContactGeometry
from lirs_wct.files import write_csv, write_json

STREAM = 21
"""Which of the seed's random streams the drive is drawn from."""
SLIDES = 0.05
"""Meters that a robot may slide in 2 s on its steepest slope.

MuJoCo's friction is soft: a contact creeps in proportion to its load, a Jackal's 9 mm/s on 29 deg.
"""
CLIMBS = 0.8
"""Share of the commanded distance that it must come uphill."""


@dataclass(frozen=True, kw_only=True)
class Check:
    """Metric with its limit.

    `least`: the limit is the smallest legal value, not the largest.
    """

    name: str
    value: float
    limit: float
    unit: str
    least: bool = False

    @property
    def passed(self) -> bool:
        """Whether the metric keeps its limit."""
        return self.value >= self.limit if self.least else self.value <= self.limit


@dataclass(frozen=True, kw_only=True)
class CollisionVerdict:
    """Result of the collision validation of a robot in a world.

    Attributes:
        world: name.
        robot: name.
        terrain: contact geometry of the ground.
        seconds: simulated time driven.
        seed: of the random drive.
        driven: meters, in all legs.
        legs: times that the robot was set down.
        tip_overs: legs that ended with the robot lying.
        stuck: seconds that it was commanded to drive, stood upright and came nowhere.
        force_peak: largest normal force of a contact, newtons.
        force_mean: mean of the sum of all normal forces while anything touched, newtons.
        penetration_p999: 99.9 % quantile of the penetration over the steps, meters.
        penetration_peak: the peak that is worst against its limit, meters.
        penetration_limit: limit at the speed of that impact, meters.
        inside_steps: steps in which a body's center was inside ground or wall.
        energy_gain: energy gained within a second beyond the motors' work where it is worst, joules.
        energy_limit: its limit there, joules.
        slope: steepest drivable ground that was found, degrees; None for a robot that flies, or none found.
        slid: sliding distance there while it should stand, without the rolling of its wheels, meters.
        climbed: share of the commanded distance that it came up there.
        diverged: why the simulation could not go on; empty = it could.
    """

    world: str
    robot: str
    terrain: ContactGeometry
    seconds: float
    seed: int
    driven: float
    legs: int
    tip_overs: int
    stuck: float
    force_peak: float
    force_mean: float
    penetration_p999: float
    penetration_peak: float
    penetration_limit: float
    inside_steps: int
    energy_gain: float
    energy_limit: float
    slope: float | None
    slid: float | None
    climbed: float | None
    diverged: str

    @property
    def checks(self) -> tuple[Check, ...]:
        """Every metric that has a limit."""
        peak, limit = 1e3 * self.penetration_peak, 1e3 * self.penetration_limit
        found = [
            Check(name="penetration, 99.9 %", value=1e3 * self.penetration_p999, limit=1e3 * DEEP, unit="mm"),
            Check(name="penetration, peak", value=peak, limit=limit, unit="mm"),
            Check(name="centers inside", value=self.inside_steps, limit=0, unit="steps"),
            Check(name="energy gained", value=self.energy_gain, limit=self.energy_limit, unit="J"),
            Check(name="diverged", value=float(bool(self.diverged)), limit=0, unit=""),
        ]
        if self.slid is not None and self.climbed is not None:
            found += [
                Check(name="slid on the slope", value=1e3 * self.slid, limit=1e3 * SLIDES, unit="mm"),
                Check(name="climbed", value=self.climbed, limit=CLIMBS, unit="", least=True),
            ]
        return tuple(found)

    @property
    def passed(self) -> bool:
        """Whether every metric keeps its limit."""
        return all(check.passed for check in self.checks)

    def as_dict(self) -> dict[str, Any]:
        """Return all metrics, the checks with their limits, and the verdict, ready for JSON."""
        checks = [asdict(check) | {"passed": check.passed} for check in self.checks]
        return asdict(self) | {"checks": checks, "passed": self.passed}


def check_collisions(
    world: World, robot: Robot, *, terrain: ContactGeometry = "hfield", seconds: float = 60.0, seed: int = 1
) -> CollisionVerdict:
    """Evaluate all contacts of a random drive and a slope test.

    The robot drives at full speed, then up the steepest ground.

    Raises:
        ConfigError: an argument is not legal, or the robot can stand nowhere in this world.
    """
    check_fit(world, robot)
    check_seed(seed)
    positive(seconds, "seconds")
    body = RobotModel(world, SimulationConfig(robot=robot, contact_geometry=terrain), PERIOD)
    legs = list(drive_at_random(body, world, robot, seconds, np.random.default_rng((seed, STREAM))))
    climbed = None if robot.flies or legs[-1].diverged else climb(body, world, robot)
    p999, peak = contact_metrics.penetrations(legs)
    gain = contact_metrics.energy_gain(legs, float(body.model.body_mass.sum()) * body.gravity)
    force_peak, force_mean = contact_metrics.forces(legs)
    return CollisionVerdict(
        world=world.name,
        robot=robot.name,
        terrain=terrain,
        seconds=sum(len(leg.commanded) for leg in legs) * body.timestep,
        seed=seed,
        driven=contact_metrics.driven(legs),
        legs=len(legs),
        tip_overs=sum(leg.tipped for leg in legs),
        stuck=contact_metrics.stuck_seconds(legs),
        force_peak=force_peak,
        force_mean=force_mean,
        penetration_p999=p999,
        penetration_peak=peak.value,
        penetration_limit=peak.limit,
        inside_steps=contact_metrics.inside_steps(legs, contact_metrics.inside_test(world, body, terrain)),
        energy_gain=gain.value,
        energy_limit=gain.limit,
        **(dict.fromkeys(Climb._fields) if climbed is None else climbed._asdict()),
        diverged=legs[-1].diverged,
    )


SCHEMA = 1


def write_verdicts(folder: Path, verdicts: Sequence[CollisionVerdict]) -> tuple[Path, Path]:
    """Write `collisions.json` and `collisions.csv`; return their paths.

    Raises:
        OutputError: the folder cannot be written.
    """
    paths = folder / "collisions.json", folder / "collisions.csv"
    write_json(paths[0], {"schema": SCHEMA, "collisions": [verdict.as_dict() for verdict in verdicts]})
    write_csv(paths[1], [asdict(v) | {"passed": v.passed} for v in verdicts], without_rows=("world",))
    return paths


PLACES = 20_000
"""Free cells that are looked at, at most."""
TRIES = 20
"""Of the steepest places, so many are tried: on some an obstacle stands beside the slope."""
HELD = 2.0
"""Seconds for which the wheels hold before it climbs."""
SPEED = 0.3
"""Meters a second of the climb, or the robot's most."""


class Climb(NamedTuple):
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
