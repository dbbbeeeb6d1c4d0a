"""Log of each MuJoCo step of a robot: motion, contacts, energy."""

from __future__ import annotations

from dataclasses import dataclass, fields

import mujoco
import numpy as np

from lirs_envs.robot_model import RobotModel
from lirs_wct.arrays import FloatArray

DEEP = 0.010
"""Penetration that a contact may have whatever happens, meters."""


@dataclass(frozen=True)
class DeepContact:
    """Contact deeper than `DEEP`.

    Its step, depth in meters, (3,) point, (3,) normal out of the ground.
    """

    step: int
    depth: float
    point: FloatArray
    normal: FloatArray


@dataclass(frozen=True, kw_only=True)
class ContactLog:
    """One row per simulation step.

    All values belong to the step's beginning, where MuJoCo finds contacts.

    Attributes:
        position: (n, 3) of base_link, meters.
        upright: (n,) cosine of the angle by which the robot leans.
        velocity: (n, 3) of base_link in the world, m/s.
        spin: (n, 3) turn rate in the world, rad/s.
        bodies: (n, bodies, 3) centers of mass of all moving bodies, meters.
        depth: (n,) deepest penetration, meters; 0 without contact.
        peak_force: (n,) largest normal force of a contact, newtons.
        force: (n,) sum of all normal forces, newtons.
        energy: (n,) kinetic, potential and of springs, joules.
        kinetic: (n,) kinetic energy alone, joules.
        work: (n,) done by the motors during the step, joules.
        deep: the deepest contact of each step where it is deeper than `DEEP`.
        timestep: seconds.
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
    deep: tuple[DeepContact, ...]
    timestep: float


COLUMNS = tuple(item.name for item in fields(ContactLog) if item.name not in ("deep", "timestep"))


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
        self._rows: list[tuple[FloatArray | float, ...]] = []
        self._deep: list[DeepContact] = []

    def step(self) -> None:
        """Make one step with the present controls."""
        body, data = self.body, self.body.data
        pose = body.pose()
        rotation = pose.rotation
        before = (
            data.qpos[:3].copy(),
            float(rotation[2, 2]),
            data.qvel[:3].copy(),
            rotation @ data.qvel[3:6],
        )
        body.step(1)
        potential, kinetic = data.energy.tolist()
        contacts = self._contacts() if data.ncon else (0.0, 0.0, 0.0)
        self._rows.append(
            (*before, data.xipos[1:].copy(), *contacts, potential + kinetic, kinetic, self._work())
        )

    def log(self) -> ContactLog:
        """Return the log."""
        columns = zip(*self._rows, strict=True) if self._rows else ((),) * len(COLUMNS)
        noted = {name: np.array(column) for name, column in zip(COLUMNS, columns, strict=True)}
        return ContactLog(**noted, deep=tuple(self._deep), timestep=self.body.timestep)

    def _work(self) -> float:
        """Return the motors' work in the last step.

        It is the force times the mean of the speeds before and after.
        """
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
        if depth[i] > DEEP:
            # MuJoCo's normal points from the first geom to the second.
            out = contact.frame[i, :3] * (1.0 if self._own[contact.geom[i, 1]] else -1.0)
            self._deep.append(DeepContact(len(self._rows), float(depth[i]), contact.pos[i].copy(), out))
        rows = contact.efc_address
        normal = data.efc_force[rows[rows >= 0]]
        return max(float(depth.max()), 0.0), float(normal.max(initial=0.0)), float(normal.sum())
