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

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lirs_envs.placement import check_fit
from lirs_envs.robot_model import RobotModel
from lirs_envs.robots.robot import Robot
from lirs_validation.collision import contact_metrics
from lirs_validation.collision.contact_log import DEEP
from lirs_validation.collision.contact_solid import ContactSolid
from lirs_validation.collision.random_drive import PERIOD, drive_at_random
from lirs_validation.collision.slope_test import climb
from lirs_wct import ConfigError, World
from lirs_wct.contact.contact_geometry import ContactGeometry
from lirs_wct.field_validators import require_seed
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
    require_seed(seed)
    if not 0 < seconds < float("inf"):
        raise ConfigError(f"seconds must be a finite number above 0, got {seconds:g}")
    body = RobotModel(world, robot, PERIOD, contact_geometry=terrain)
    legs = list(drive_at_random(body, world, robot, seconds, np.random.default_rng((seed, STREAM))))
    slope = None if robot.flies or legs[-1].diverged else climb(body, world, robot)
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
        inside_steps=contact_metrics.inside_steps(legs, ContactSolid(world, body, terrain)),
        energy_gain=gain.value,
        energy_limit=gain.limit,
        slope=slope.slope if slope else None,
        slid=slope.slid if slope else None,
        climbed=slope.climbed if slope else None,
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
