"""Physics of N robots through `mujoco.batch`, or of one through `mj_step`.

Each robot is alone in its world, and is one row of MuJoCo's state. The results of both are equal.
"""

from __future__ import annotations

import copy
import math
from array import array
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError as BatchError

from lirs_envs.collisions import KINDS, ContactMonitor, describe_divergence, divergence_reason, is_sound
from lirs_envs.robot_model import CENTER_SENSOR, CONTACT_SENSOR, SETTLING_TIME, WHEEL_CONTACTS, RobotModel
from lirs_envs.robots.body_state import BodyState
from lirs_envs.robots.robot import Robot
from lirs_wct import Pose3
from lirs_wct.arrays import BoolArray, FloatArray, Int32Array, IntArray, njit


class Bodies:
    """N robots in MuJoCo.

    Attributes:
        body: the compiled model, which also gives the addresses of its values.
        count: number of robots, N.
        qpos: (N, nq) positions, live; the first seven are those of `T_world_base`.
        qvel: (N, nv) velocities, live.
        ctrl: (N, nu) controls, to be written.
        mocap_pos: (N, m, 3) centers of the walkers with a body, to be written.
        models: the model of each robot; one for all unless `own_models`.
        views: state of each robot, for its sensors and control.

    Args:
        body: the compiled model, with contact sensors.
        own_models: whether each robot has a model of its own, to be edited and announced by `models_changed`.
    """

    def __init__(self, robot: Robot, body: RobotModel, count: int, *, own_models: bool = False) -> None:
        self.robot = robot
        self.body = body
        self.count = count
        self.models = [copy.copy(body.model) for _ in range(count)] if own_models else [body.model] * count
        self._own_models = own_models
        self._touch, self._wheels, self._drops = _contact_sensors(body)
        self._force = int(body.model.sensor("accelerometer").adr[0])
        self.views = [BodyState(model, robot) for model in self.models]
        self._make_batch()

    def _make_batch(self) -> None:
        model = self.body.model
        # MuJoCo stores sleeping bodies in its data, not in the state.
        sleeps = bool(model.opt.enableflags & mujoco.mjtEnableBit.mjENBL_SLEEP)
        # Its own threads would not survive a fork.
        self._batch = Batch(model, self.count, nthread=1, persistent=sleeps)
        if self._own_models:
            self._batch.set_models(self.models)
        self.qpos, self.qvel, self.ctrl = (self._batch.bind(name) for name in ("qpos", "qvel", "ctrl"))
        for view, qpos, qvel in zip(self.views, self.qpos, self.qvel, strict=True):
            view.qpos, view.qvel = qpos, qvel
        self.mocap_pos: FloatArray = self._batch.bind("mocap_pos")
        self._sensordata: FloatArray = self._batch.bind("sensordata")

    def __getstate__(self) -> dict[str, Any]:
        live = ("_batch", "qpos", "qvel", "ctrl", "mocap_pos", "_sensordata")
        kept = {name: value for name, value in self.__dict__.items() if name not in live}
        return kept | {"_rows": self._batch.state.copy(), "_warnings": self._batch.warning.copy()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        rows, warnings = state.pop("_rows"), state.pop("_warnings")
        self.__dict__.update(state)
        self._make_batch()
        self._batch.state[:], self._batch.warning[:] = rows, warnings

    def models_changed(self) -> None:
        """Let the physics read the models again after one was edited."""
        self._batch.set_models(self.models)

    def step(self, ids: Int32Array | None, steps: int) -> dict[int, str]:
        """Step robots with their controls; return the errors of those that MuJoCo could not step."""
        try:
            self._batch.step(ids, nstep=steps)
        except BatchError as error:
            return {int(i): self._batch.error(int(i)) for i in error.ids}
        return {}

    def settle(self, i: int, T_world_base: Pose3, walkers: FloatArray | None = None) -> None:
        """Release robot `i` in a pose with its wheels held, and settle (see `RobotModel.settle`).

        Args:
            i: row of the robot.
            T_world_base: its pose.
            walkers: (m, 3) centers of the walkers within its reach, meters.
        """
        row = np.array((i,), np.int32)
        self._batch.reset(row, stage=mujoco.mjtStage.mjSTAGE_NONE.value)
        self._batch.warning[i] = 0
        if walkers is not None:
            self.mocap_pos[i] = walkers
        self.qpos[i, :7] = (*T_world_base.position, *T_world_base.quaternion)
        if self.robot.flies:
            weight = float(self.models[i].body("base_link").subtreemass[0]) * self.body.gravity
            self.ctrl[i] = weight / len(self.robot.rotors)
            self._batch.forward(row)
        else:
            self.step(row, math.ceil(SETTLING_TIME / self.body.timestep))
        self._batch.bind("time")[i] = 0.0

    def add_touching(self, touched: BoolArray, dt: float) -> None:
        """Mark in (N,) which robots collide, at the beginning of the last step."""
        _add_touching(self._sensordata, self._touch, self._wheels, self._drops, touched)

    def specific_force(self) -> FloatArray:
        """Return (N, 3) true readings of the accelerometers along the bases' axes, m/s^2."""
        return self._sensordata[:, self._force : self._force + 3]

    def find_diverged(self) -> BoolArray:
        """Return (N,) whether each robot has diverged."""
        found: BoolArray = np.zeros(self.count, np.bool_)
        _find_diverged(self.qpos, self.qvel, self._batch.warning, KINDS, found)
        return found

    def divergence(self, i: int) -> str:
        """Return how robot `i` has diverged; empty = it has not."""
        if not self.find_diverged()[i]:
            return ""
        return f"the simulation diverged: {divergence_reason(self._batch.warning[i, :, 1])}"

    def read_poses(self, rows: IntArray, out: FloatArray) -> None:
        """Fill rows of (N, 7) with x, y, z, qw, qx, qy, qz of `T_world_base`."""
        _read_poses(rows, self.qpos, out)


def _contact_sensors(body: RobotModel) -> tuple[IntArray, IntArray, FloatArray]:
    """Return addresses of the contact sensors, and the drops (m,).

    The addresses are those of the body's sensors (n,) and of the wheels' contacts and centers (m, 2).
    """
    model, touch, wheels, drops = body.model, list[int](), list[tuple[int, int]](), list[float]()
    for sensor in (model.sensor(i) for i in range(model.nsensor)):
        if sensor.name.startswith(CONTACT_SENSOR):
            geom, address = int(sensor.objid[0]), int(sensor.adr[0])
            if geom in body.wheel_geoms:
                center = model.sensor(CENTER_SENSOR + model.geom(geom).name)
                wheels.append((address, int(center.adr[0])))
                drops.append(float(body.contact_drops[geom]))
            else:
                touch.append(address)
    return np.array(touch, np.int64), np.array(wheels, np.int64).reshape(-1, 2), np.array(drops, np.float64)


@njit
def _add_touching(
    sensordata: FloatArray, touch: IntArray, wheels: IntArray, drops: FloatArray, touched: BoolArray
) -> None:
    """Mark colliding robots like `lirs_envs.collisions.contact_state`, from readings of contact sensors."""
    for i in range(len(touched)):
        for k in touch:
            touched[i] |= sensordata[i, k] > 0.0
        for j in range(len(wheels)):
            contacts, center = wheels[j]
            # Each contact: number of contacts, x, y, z.
            for k in range(contacts, contacts + min(int(sensordata[i, contacts]), WHEEL_CONTACTS) * 4, 4):
                touched[i] |= sensordata[i, center + 2] - sensordata[i, k + 3] < drops[j]


@njit
def _find_diverged(
    qpos: FloatArray, qvel: FloatArray, warning: Int32Array, kinds: IntArray, found: BoolArray
) -> None:
    for i in range(len(found)):
        found[i] = not is_sound(warning[i, :, 1], kinds, qpos[i], qvel[i])


@njit
def _read_poses(rows: IntArray, qpos: FloatArray, out: FloatArray) -> None:
    for i in rows:
        w, x, y, z = qpos[i, 3], qpos[i, 4], qpos[i, 5], qpos[i, 6]
        norm = math.sqrt(w * w + x * x + y * y + z * z)
        out[i, 0], out[i, 1], out[i, 2] = qpos[i, 0], qpos[i, 1], qpos[i, 2]
        out[i, 3], out[i, 4], out[i, 5], out[i, 6] = w / norm, x / norm, y / norm, z / norm


class SingleBody:
    """One robot stepped by `mujoco.mj_step`, with the interface of `Bodies` and records of each step.

    Attributes:
        body: the compiled model and state.
        views: the model, for sensors and control.
        count: 1.
        contacts: statistics of the contacts since `clear`.
        qpos: (1, nq) positions, live.
        qvel: (1, nv) velocities, live.
        ctrl: (1, nu) controls, to be written.
        mocap_pos: (1, m, 3) centers of the walkers with a body, to be written.

    Args:
        record_motion: whether to record the base after each step (see `take_motion`).
    """

    def __init__(self, robot: Robot, body: RobotModel, *, record_motion: bool = False) -> None:
        self.robot, self.body, self.views, self.count = robot, body, [body], 1
        self._record_motion = record_motion
        self.clear()
        self._bind()

    def clear(self) -> None:
        """Clear the records."""
        self.contacts = ContactMonitor(self.body.contact_drops)
        self._controls, self._motion = array("d"), array("d")

    def _bind(self) -> None:
        body = self.body
        self.qpos, self.qvel, self.ctrl = body.qpos[None], body.qvel[None], body.ctrl[None]
        self.mocap_pos, self._force = body.walker_centers[None], body.force[None]
        self._quaternion, self._velocity = body.qpos[3:7], body.qvel[:6]

    def __getstate__(self) -> dict[str, Any]:
        live = ("qpos", "qvel", "ctrl", "mocap_pos", "_force", "_quaternion", "_velocity")
        return {name: value for name, value in self.__dict__.items() if name not in live}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._bind()

    @property
    def controls(self) -> FloatArray:
        """(n, nu) controls of each step since `clear`."""
        return np.array(self._controls).reshape(-1, self.ctrl.shape[1])

    def step(self, ids: Int32Array | None, steps: int) -> dict[int, str]:
        """Step the robot with its controls."""
        self._controls.frombytes(self.body.ctrl.tobytes())
        if not self._record_motion:
            self.body.step(steps)
            return {}
        for _ in range(steps):
            self.body.step(1)
            self._motion.frombytes(self._quaternion.tobytes())
            self._motion.frombytes(self._velocity.tobytes())
        return {}

    def motion(self) -> FloatArray:
        """Return the base (10,): quaternion, real part first, velocity in the world, m/s, rates, rad/s."""
        return np.concatenate((self._quaternion, self._velocity))

    def take_motion(self) -> FloatArray:
        """Return and forget the base (n, 10) after each step since the last call (see `motion`)."""
        taken = np.array(self._motion).reshape(-1, 10)
        self._motion = array("d")
        return taken

    def settle(self, i: int, T_world_base: Pose3, walkers: FloatArray | None = None) -> None:
        """Release the robot in a pose with its wheels held, and settle (see `RobotModel.settle`)."""
        self.body.settle(T_world_base, walkers)

    def add_touching(self, touched: BoolArray, dt: float) -> None:
        """Record the contacts, which last for `dt` seconds; mark in (1,) whether the robot collides."""
        touched[0] |= self.contacts.record(self.body.data, dt)

    def specific_force(self) -> FloatArray:
        """Return (1, 3) the true reading of the accelerometer along the base's axes, m/s^2."""
        return self._force

    def find_diverged(self) -> BoolArray:
        """Return (1,) whether the robot has diverged."""
        data = self.body.data
        return np.array((not is_sound(data.warning.number, KINDS, data.qpos, data.qvel),))

    def divergence(self, i: int) -> str:
        """Return how the robot has diverged; empty = it has not."""
        return describe_divergence(self.body.data)
