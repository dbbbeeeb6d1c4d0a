"""Contact statistics of a simulation, and the check for divergence."""

from __future__ import annotations

import math
from array import array
from dataclasses import dataclass, field
from functools import cache
from threading import Lock

import mujoco
import numpy as np

from lirs_wct.arrays import FloatArray, Int32Array, IntArray, njit
from lirs_wct.errors import SimulationError

DIVERGENCE_WARNINGS = {
    mujoco.mjtWarning.mjWARN_BADQPOS: "a position is not finite or too large",
    mujoco.mjtWarning.mjWARN_BADQVEL: "a velocity is not finite or too large",
    mujoco.mjtWarning.mjWARN_BADQACC: "an acceleration is not finite or too large",
    mujoco.mjtWarning.mjWARN_INERTIA: "the inertia matrix is singular",
    mujoco.mjtWarning.mjWARN_CONTACTFULL: "there are more contacts than memory for them",
    mujoco.mjtWarning.mjWARN_CNSTRFULL: "there are more constraints than memory for them",
}
COMPILING = Lock()
"""A kernel is compiled by one thread; a second one would find the compiler disabled."""
KINDS: IntArray = np.array([int(kind) for kind in DIVERGENCE_WARNINGS], np.int64)


@dataclass(frozen=True, kw_only=True)
class Collisions:
    """Contact statistics of a run.

    Attributes:
        max_penetration: deepest penetration of ground or walls, meters; the 1 mm of a loaded tyre counts.
        penetration_p999: 99.9 % quantile of the penetration over the samples, meters.
        body_contacts: number of collisions: the body touched something, or a wheel a face steeper than the
            robot climbs.
        body_contact_seconds: duration of the collisions.
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

    drops: FloatArray
    """(ngeom,) see `lirs_envs.robot_model.RobotModel.contact_drops`."""
    penetrations: array[float] = field(default_factory=lambda: array("d"))
    body_contacts: int = 0
    body_seconds: float = 0.0
    _touching: bool = False
    _compiled: bool = False

    def record(self, data: mujoco.MjData, dt: float) -> bool:
        """Record the deepest contact; return whether the robot collides."""
        if data.ncon == 0:
            self.penetrations.append(0.0)
            self._touching = False
            return False
        if not self._compiled:
            compile_contact_state()
            self._compiled = True
        contact = data.contact
        depth, touching = contact_state(contact.dist, contact.geom, contact.pos, data.geom_xpos, self.drops)
        self.penetrations.append(depth)
        self.body_contacts += touching and not self._touching
        self.body_seconds += dt * touching
        self._touching = touching
        return self._touching

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


@njit
def contact_state(
    distance: FloatArray, pairs: Int32Array, points: FloatArray, centers: FloatArray, drops: FloatArray
) -> tuple[float, bool]:
    """Return the deepest contact of the robot, meters, and whether any is a collision.

    A contact has one geom of the robot and one of ground or walls, in either order.
    """
    depth, touching = 0.0, False
    for k in range(len(distance)):
        for side in range(2):
            geom = pairs[k, side]
            if drops[geom] > -np.inf:
                depth = max(depth, -distance[k])
                touching |= centers[geom, 2] - points[k, 2] < drops[geom]
    return depth, touching


def compile_contact_state() -> None:
    """Compile `contact_state` once for arrays of any layout, from any thread.

    A single contact is contiguous in memory, several are not. Without this, the first single contact of a
    drive would wait for the compiler.
    """
    with COMPILING:
        _compile_contact_state()


@cache
def _compile_contact_state() -> None:
    contact_state.compile("Tuple((f8, b1))(f8[:], i4[:, :], f8[:, :], f8[:, ::1], f8[::1])")
    contact_state.disable_compile()


def divergence_reason(warned: Int32Array) -> str:
    """Return the reason of a divergence by the numbers of MuJoCo's warnings, by kind."""
    reasons = [reason for kind, reason in DIVERGENCE_WARNINGS.items() if warned[kind]]
    return reasons[0] if reasons else "the state is not finite"


def describe_divergence(data: mujoco.MjData) -> str:
    """Return how a simulation has diverged; empty = it has not."""
    if is_sound(data.warning.number, KINDS, data.qpos, data.qvel):
        return ""
    return f"the simulation diverged at {data.time:.3f} s: {divergence_reason(data.warning.number)}"


def check_divergence(data: mujoco.MjData) -> None:
    """Stop a simulation that has diverged.

    Raises:
        SimulationError: MuJoCo warned, or the state is not finite.
    """
    if found := describe_divergence(data):
        raise SimulationError(found)


@njit
def is_sound(warned: Int32Array, kinds: IntArray, qpos: FloatArray, qvel: FloatArray) -> bool:
    """Return whether a state is finite and MuJoCo gave none of some warnings (n,)."""
    for kind in kinds:
        if warned[kind]:
            return False
    return bool(is_finite(qpos) and is_finite(qvel))


@njit
def is_finite(values: FloatArray) -> bool:
    """Return whether all of (n,) values are finite."""
    finite = True
    for value in values:  # compiles sooner than np.isfinite(values).all()
        finite &= math.isfinite(value)
    return finite
