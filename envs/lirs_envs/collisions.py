"""Contact statistics of a simulation, and the check for divergence."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field

import mujoco
import numpy as np

from lirs_wct.errors import SimulationError

DIVERGENCE_WARNINGS = {
    mujoco.mjtWarning.mjWARN_BADQPOS: "a position is not finite or too large",
    mujoco.mjtWarning.mjWARN_BADQVEL: "a velocity is not finite or too large",
    mujoco.mjtWarning.mjWARN_BADQACC: "an acceleration is not finite or too large",
    mujoco.mjtWarning.mjWARN_INERTIA: "the inertia matrix is singular",
    mujoco.mjtWarning.mjWARN_CONTACTFULL: "there are more contacts than memory for them",
    mujoco.mjtWarning.mjWARN_CNSTRFULL: "there are more constraints than memory for them",
}


@dataclass(frozen=True, kw_only=True)
class Collisions:
    """Contact statistics of a run.

    Attributes:
        max_penetration: deepest that the robot was in ground or walls, metres; a loaded tyre's 1 mm counts.
        penetration_p999: what it stayed below in 99.9 % of the samples, metres.
        body_contacts: times that the body (not a wheel) came to touch something.
        body_contact_seconds: time that it touched.
        samples: number of samples, one each control update.
    """

    max_penetration: float
    penetration_p999: float
    body_contacts: int
    body_contact_seconds: float
    samples: int


@dataclass
class ContactMonitor:
    """Statistics of the contacts after each control update."""

    wheel_geoms: frozenset[int]
    own_geoms: frozenset[int] | None = None
    """The robot's geoms, where props have contacts as well; None = all contacts are the robot's."""
    penetrations: array[float] = field(default_factory=lambda: array("d"))
    body_contacts: int = 0
    body_seconds: float = 0.0
    _touching: bool = False

    def record(self, data: mujoco.MjData, dt: float) -> None:
        """Record the deepest contact, and whether the body touches."""
        if data.ncon == 0:
            self.penetrations.append(0.0)
            self._touching = False
            return
        distances, pairs = data.contact.dist.tolist(), data.contact.geom.tolist()
        if self.own_geoms is not None:
            own = [k for k, pair in enumerate(pairs) if not self.own_geoms.isdisjoint(pair)]
            distances, pairs = [distances[k] for k in own], [pairs[k] for k in own]
        self.penetrations.append(max(0.0, -min(distances, default=0.0)))
        # The ground's and walls' geoms come after the robot's or before; a contact has one of each.
        wheels = self.wheel_geoms
        touching = any(a not in wheels and b not in wheels for a, b in pairs)
        self.body_contacts += touching and not self._touching
        self.body_seconds += dt * touching
        self._touching = touching

    def statistics(self) -> Collisions:
        """Return the statistics so far."""
        depths = np.array(self.penetrations or (0.0,))
        return Collisions(
            max_penetration=float(depths.max()),
            penetration_p999=float(np.quantile(depths, 0.999)),
            body_contacts=self.body_contacts,
            body_contact_seconds=self.body_seconds,
            samples=len(self.penetrations),
        )


def check_divergence(data: mujoco.MjData) -> None:
    """Stop a simulation that has diverged.

    Raises:
        SimulationError: MuJoCo warned, or the state is not finite.
    """
    for warning, reason in DIVERGENCE_WARNINGS.items():
        if data.warning[warning].number:
            raise SimulationError(f"the simulation diverged at {data.time:.3f} s: {reason}")
    if not (np.isfinite(data.qpos).all() and np.isfinite(data.qvel).all()):
        raise SimulationError(f"the simulation diverged at {data.time:.3f} s: the state is not finite")
