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
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d
from scipy.spatial import ConvexHull

from lirs_envs.robot_model import TIPPED, RobotModel
from lirs_envs.robots.robot import Robot
from lirs_envs.simulation_config import SimulationConfig, check_fit
from lirs_validation.collision.drives import MAX_DEPTH, PERIOD, Climb, Leg, climb, drive_at_random
from lirs_validation.metrics.world_geometry import mesh_error
from lirs_wct import BoolArray, FloatArray, TriangleMesh, WallGrid, World
from lirs_wct.contact import ContactGeometry
from lirs_wct.contact.parts import PRISM_ERROR, touching_volume
from lirs_wct.errors import check_seed, positive
from lirs_wct.files import write_csv, write_json

STREAM = 21
"""Random stream of the seed for the drive."""
MAX_SLIDE = 0.05
"""Meters that a robot may slide in 2 s on its steepest slope.

MuJoCo's friction is soft: a contact creeps in proportion to its load, a Jackal's 9 mm/s on 29 deg.
"""
MIN_CLIMB = 0.8
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
        seconds: Simulated time driven.
        driven: Distance in all legs, meters.
        legs: Number of times that the robot was set down.
        tip_overs: Number of legs that ended with the robot lying.
        stuck: Seconds that it was commanded to drive, stood upright and came nowhere.
        force_peak: Largest normal force of a contact, newtons.
        force_mean: Mean of the sum of all normal forces while anything touched, newtons.
        penetration_p999: 99.9 % quantile of the penetration over the steps, meters.
        penetration_peak: Peak that is worst against its limit, meters.
        penetration_limit: Limit at the speed of that impact, meters.
        inside_steps: Steps in which a body's center was inside ground or wall.
        energy_gain: Energy gained within a second beyond the motors' work where it is worst, joules.
        energy_limit: Limit of the energy there, joules.
        slope: Steepest drivable ground, degrees; None for a robot that flies, or without such ground.
        slid: Sliding distance there while it should stand, without the rolling of its wheels, meters.
        climbed: Share of the commanded distance that it came up there.
        diverged: Reason why the simulation could not go on; empty = it could.
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
        p999 = 1e3 * self.penetration_p999
        found = [
            Check(name="penetration, 99.9 %", value=p999, limit=1e3 * MAX_DEPTH, unit="mm"),
            Check(name="penetration, peak", value=peak, limit=limit, unit="mm"),
            Check(name="centers inside", value=self.inside_steps, limit=0, unit="steps"),
            Check(name="energy gained", value=self.energy_gain, limit=self.energy_limit, unit="J"),
            Check(name="diverged", value=float(bool(self.diverged)), limit=0, unit=""),
        ]
        if self.slid is not None and self.climbed is not None:
            found += [
                Check(name="slid on the slope", value=1e3 * self.slid, limit=1e3 * MAX_SLIDE, unit="mm"),
                Check(name="climbed", value=self.climbed, limit=MIN_CLIMB, unit="", least=True),
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
    """
    check_fit(world, robot)
    check_seed(seed)
    positive(seconds, "seconds")
    body = RobotModel(world, SimulationConfig(robot=robot, contact_geometry=terrain), PERIOD)
    legs = list(drive_at_random(body, world, robot, seconds, np.random.default_rng((seed, STREAM))))
    climbed = None if robot.flies or legs[-1].diverged else climb(body, world, robot)
    p999, peak = penetrations(legs)
    gain = energy_gain(legs, float(body.model.body_mass.sum()) * body.gravity)
    inside = inside_test(world, body, terrain)
    force = np.concatenate([leg.force for leg in legs])
    return CollisionVerdict(
        world=world.name,
        robot=robot.name,
        terrain=terrain,
        seconds=sum(len(leg.commanded) for leg in legs) * body.timestep,
        seed=seed,
        driven=sum(float(np.linalg.norm(np.diff(leg.position, axis=0), axis=1).sum()) for leg in legs),
        legs=len(legs),
        tip_overs=sum(leg.tipped for leg in legs),
        stuck=stuck_seconds(legs),
        force_peak=max(float(leg.peak_force.max(initial=0.0)) for leg in legs),
        force_mean=float(force[force > 0].mean()) if (force > 0).any() else 0.0,
        penetration_p999=p999,
        penetration_peak=peak.value,
        penetration_limit=peak.limit,
        inside_steps=sum(int(inside_steps(leg, inside).sum()) for leg in legs),
        energy_gain=gain.value,
        energy_limit=gain.limit,
        **(dict.fromkeys(Climb._fields) if climbed is None else climbed._asdict()),
        diverged=legs[-1].diverged,
    )


SCHEMA = 1


def write_verdicts(folder: Path, verdicts: Sequence[CollisionVerdict]) -> tuple[Path, Path]:
    """Write `collisions.json` and `collisions.csv`; return their paths."""
    paths = folder / "collisions.json", folder / "collisions.csv"
    write_json(paths[0], {"schema": SCHEMA, "collisions": [verdict.as_dict() for verdict in verdicts]})
    write_csv(paths[1], [asdict(v) | {"passed": v.passed} for v in verdicts], without_rows=("world",))
    return paths


InsideTest = Callable[[FloatArray], BoolArray]
"""Function of points (n, 3) that returns (n,) whether each is inside ground or wall."""
MAX_HULLS = 500
"""Convex parts above which bodies are touched on their surface (see `shell_parts`)."""
IMPACT = 0.010
"""Meters of penetration that an impact may reach for each meter a second."""
ONSET = 0.1
"""Seconds before a deep contact in which its impact began."""
WINDOW = 1.0
"""Seconds over which energy and standing still are looked at."""
RETURNED = math.exp(-4)
"""Share of an impact's energy that a critically damped contact gives back."""
STANDS = 0.1
"""Below this share of the commanded distance a robot counts as stuck."""


class Bounded(NamedTuple):
    """Worst of many values with individual limits, and its limit."""

    value: float
    limit: float

    @property
    def ratio(self) -> float:
        """Value over limit."""
        return self.value / self.limit


def penetrations(legs: Sequence[Leg]) -> tuple[float, Bounded]:
    """Return the 99.9 % quantile and the worst peak of the penetration, meters.

    The limit of a peak grows with the highest speed at which the robot, as one rigid body, moved there into
    the ground just before.
    """
    depth, peaks = np.concatenate([leg.depth for leg in legs]), []
    for leg in legs:
        for contact in leg.deep:
            since = slice(max(0, contact.step - round(ONSET / leg.timestep)), contact.step + 1)
            arm = contact.point - leg.position[since]
            speed = -(leg.velocity[since] + np.cross(leg.spin[since], arm)) @ contact.normal
            peaks.append(Bounded(contact.depth, max(MAX_DEPTH, IMPACT * float(speed.max()))))
    peaks = peaks or [Bounded(float(depth.max()), MAX_DEPTH)]
    return float(np.quantile(depth, 0.999)), max(peaks, key=lambda peak: peak.ratio)


def energy_gain(legs: Sequence[Leg], weight: float) -> Bounded:
    """Return the largest energy gain within a second beyond the motors' work, joules.

    The robot's weight is in newtons.
    """
    gains = []
    for leg in legs:
        span = max(1, round(WINDOW / leg.timestep))
        # A window that ends at each step: the filters are centered.
        size, origin = span + 1, span // 2
        balance = leg.energy - (np.cumsum(leg.work) - leg.work)
        gain = balance - minimum_filter1d(balance, size, origin=origin, mode="nearest")
        # The impact whose energy comes back lies before the lowest point.
        since = span + round(ONSET / leg.timestep)
        kinetic = maximum_filter1d(leg.kinetic, since + 1, origin=since // 2, mode="nearest")
        limit = weight * MAX_DEPTH + RETURNED * kinetic
        k = int(np.argmax(gain / limit))
        gains.append(Bounded(float(gain[k]), float(limit[k])))
    return max(gains, key=lambda gain: gain.ratio)


def inside_steps(leg: Leg, inside: InsideTest) -> BoolArray:
    """Return (n,) whether a body's center was inside ground or wall in each step."""
    bodies = inside(leg.bodies.reshape(-1, 3)).reshape(len(leg.depth), -1)
    return np.asarray(bodies.any(axis=1))


def stuck_seconds(legs: Sequence[Leg]) -> float:
    """Return the time that the robot stood upright, was commanded to drive, and came nowhere."""
    total = 0
    for leg in legs:
        span = round(WINDOW / leg.timestep)
        for k in range(0, len(leg.depth) - span, span):
            commanded = abs(sum(leg.commanded[k : k + span].tolist())) * leg.timestep
            moved = float(np.linalg.norm(leg.position[k + span] - leg.position[k]))
            upright = bool((leg.upright[k : k + span] >= TIPPED).all())
            total += commanded > 0 and upright and moved < STANDS * commanded
    return total * WINDOW


def inside_test(world: World, body: RobotModel, terrain: ContactGeometry) -> InsideTest:
    """Return a test of points against the contact geometry, independent of MuJoCo's collision detection."""
    hulls = _hulls(body.model) if terrain == "convex" else []
    if hulls:
        # Thin shells of the body lie inside it; parts by CoACD bulge out of it.
        return partial(_in_hulls, hulls if len(hulls) <= MAX_HULLS else hulls[:1], world.solid)
    if world.walls is not None:
        return partial(_in_walls, world.walls)
    heights, slack = world.surface, 0.0
    if terrain in ("hfield", "mesh"):
        heights = body.contact.heights(heights)
    elif terrain == "prisms":
        limited = world.export_options.limited or world.solid is not None
        slack = mesh_error(world) if limited else PRISM_ERROR
    # Beyond the border the height is NaN, and nothing is below it.
    return lambda points: points[:, 2] < heights.height_at(points[:, 0], points[:, 1]) - slack


def _in_hulls(hulls: Sequence[FloatArray], solid: TriangleMesh | None, points: FloatArray) -> BoolArray:
    """Return whether points are in a convex part, or in the solid."""
    inside = np.zeros(len(points), np.bool_)
    for planes in hulls:
        inside |= (points @ planes[:, :3].T + planes[:, 3] < 0).all(axis=1)
    return inside if solid is None else inside | touching_volume(solid, points)


def _in_walls(walls: WallGrid, points: FloatArray) -> BoolArray:
    """Return whether points are in a wall, or under a floor that is there."""
    cells = np.floor(walls.origin.inverse().apply(points[:, :2]) / walls.resolution).astype(int)
    col, row = cells.T
    rows, cols = walls.shape
    on = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
    row, col = np.where(on, row, 0), np.where(on, col, 0)
    z = points[:, 2]
    inside: BoolArray = on & (
        (walls.solid[row, col] & (z < walls.height)) | (walls.floor[row, col] & (z < 0))
    )
    return inside


def _hulls(model: mujoco.MjModel) -> list[FloatArray]:
    """Return (n, 4) the outward planes of each convex part."""
    hulls = []
    for g in np.flatnonzero((model.geom_bodyid == 0) & (model.geom_contype > 0)).tolist():
        mesh = int(model.geom_dataid[g])
        start, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        turn = np.empty(9)
        mujoco.mju_quat2Mat(turn, model.geom_quat[g])
        corners = model.mesh_vert[start : start + count] @ turn.reshape(3, 3).T + model.geom_pos[g]
        hulls.append(np.array(ConvexHull(corners).equations))
    return hulls
