"""Metrics of a random drive: penetration, impacts, energy, forces, standing still."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from lirs_envs.robot_model import TIPPED
from lirs_validation.collision.contact_log import DEEP, ContactLog, DeepContact
from lirs_validation.collision.contact_solid import ContactSolid
from lirs_validation.collision.random_drive import Leg

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


@dataclass(frozen=True)
class Bounded:
    """Worst of many values with individual limits, and its limit."""

    value: float
    limit: float

    @property
    def ratio(self) -> float:
        """Value over limit."""
        return self.value / self.limit


def penetrations(legs: Sequence[Leg]) -> tuple[float, Bounded]:
    """Return the 99.9 % quantile and the worst peak of the penetration, meters."""
    depth = np.concatenate([leg.log.depth for leg in legs])
    peaks = [_impact(leg.log, contact) for leg in legs for contact in leg.log.deep]
    return float(np.quantile(depth, 0.999)), worst(peaks or [Bounded(float(depth.max()), DEEP)])


def _impact(log: ContactLog, contact: DeepContact) -> Bounded:
    """Return a deep contact and the depth that the speed of the impact allows it.

    The speed is the highest at which the robot, as one rigid body, moved there into the ground just before.
    """
    since = slice(max(0, contact.step - round(ONSET / log.timestep)), contact.step + 1)
    arm = contact.point - log.position[since]
    speed = -(log.velocity[since] + np.cross(log.spin[since], arm)) @ contact.normal
    return Bounded(contact.depth, max(DEEP, IMPACT * float(speed.max())))


def energy_gain(legs: Sequence[Leg], weight: float) -> Bounded:
    """Return the largest energy gain within a second, joules.

    The motors' work is subtracted.

    Args:
        legs: of the drive.
        weight: of the robot, newtons.
    """
    return worst(_gain(leg.log, weight) for leg in legs)


def _gain(log: ContactLog, weight: float) -> Bounded:
    span = max(1, round(WINDOW / log.timestep))
    # A window that ends at each step: the filters are centered.
    size, origin = span + 1, span // 2
    balance = log.energy - (np.cumsum(log.work) - log.work)
    gain = balance - minimum_filter1d(balance, size, origin=origin, mode="nearest")
    # The impact whose energy comes back lies before the lowest point.
    since = span + round(ONSET / log.timestep)
    kinetic = maximum_filter1d(log.kinetic, since + 1, origin=since // 2, mode="nearest")
    limit = weight * DEEP + RETURNED * kinetic
    k = int(np.argmax(gain / limit))
    return Bounded(float(gain[k]), float(limit[k]))


def inside_steps(legs: Sequence[Leg], solid: ContactSolid) -> int:
    """Return the number of steps in which a body's center was inside ground or wall."""
    return sum(
        int(solid.holds(leg.log.bodies.reshape(-1, 3)).reshape(len(leg.log.depth), -1).any(axis=1).sum())
        for leg in legs
    )


def stuck_seconds(legs: Sequence[Leg]) -> float:
    """Return the time that the robot stood upright, was commanded to drive, and came nowhere."""
    total = 0
    for leg in legs:
        log, span = leg.log, round(WINDOW / leg.log.timestep)
        for k in range(0, len(log.depth) - span, span):
            commanded = abs(sum(leg.commanded[k : k + span])) * log.timestep
            moved = float(np.linalg.norm(log.position[k + span] - log.position[k]))
            upright = bool((log.upright[k : k + span] >= TIPPED).all())
            total += commanded > 0 and upright and moved < STANDS * commanded
    return total * WINDOW


def forces(legs: Sequence[Leg]) -> tuple[float, float]:
    """Return the largest contact force and the mean force sum during contact, N."""
    total = np.concatenate([leg.log.force for leg in legs])
    touching = total[total > 0]
    peak = max(float(leg.log.peak_force.max(initial=0.0)) for leg in legs)
    return peak, float(touching.mean()) if len(touching) else 0.0


def driven(legs: Sequence[Leg]) -> float:
    """Return the distance that base_link travelled, meters."""
    return sum(float(np.linalg.norm(np.diff(leg.log.position, axis=0), axis=1).sum()) for leg in legs)


def worst(values: Iterable[Bounded]) -> Bounded:
    """Return the value that is highest against its limit."""
    return max(values, key=lambda bounded: bounded.ratio)
