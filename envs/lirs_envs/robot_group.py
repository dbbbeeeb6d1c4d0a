"""Robots that one thread at a time advances: physics, control, walkers, inertial units and odometry.

The physics steps N robots through `mujoco.batch`, or one through `mj_step`; the results of both are equal.
"""

from __future__ import annotations

import copy
import math
from array import array
from time import perf_counter as clock
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError as BatchError

from lirs_envs.robot_model import (
    CENTER_SENSOR,
    CONTACT_SENSOR,
    KINDS,
    SETTLING_TIME,
    WHEEL_CONTACTS,
    Collisions,
    RobotModel,
    contact_state,
    describe_divergence,
    divergence_message,
    is_sound,
    is_tipped,
)
from lirs_envs.robots.control import BodyState, LateCommands, make_controllers
from lirs_envs.robots.robot import Robot, Waypoint
from lirs_envs.sensing.imu import MOTION, ImuSensors, InertialUnit
from lirs_envs.sensing.odometry import Odometries
from lirs_envs.sensing.sensors import IMU_STREAM, INERTIAL_STREAM, ODOMETRY_STREAM, sensor_stream
from lirs_envs.sensing.wheel_odometry import WheelOdometries
from lirs_envs.simulation_config import SimulationConfig, check_settled, footprint, standing_pose
from lirs_envs.walkers import WALKER_STREAM, Walkers
from lirs_wct import HeightField, ImuReadings, Pose2, Pose3, SimulationError, World
from lirs_wct.arrays import BoolArray, FloatArray, Int32Array, IntArray, njit

TRACK_RATE = 50.0
"""Aimed rate of the odometry between scans, Hz."""


class Bodies:
    """N robots in a batch of MuJoCo.

    Attributes:
        body: Compiled model, which also gives the addresses of its values.
        qpos: (N, nq) positions, live; the first seven are those of `T_world_base`.
        qvel: (N, nv) velocities, live.
        ctrl: (N, nu) controls, to be written.
        mocap_pos: (N, m, 3) centers of the walkers with a body, to be written.
        models: Model of each robot; one for all unless `own_models`.
        views: State of each robot, for its sensors and control.

    Args:
        body: Compiled model, with contact sensors.
        own_models: Whether each robot has a model of its own, to be edited and announced by `models_changed`.
    """

    def __init__(self, robot: Robot, body: RobotModel, count: int, *, own_models: bool = False) -> None:
        self.robot, self.body, self.count = robot, body, count
        self.models = [copy.copy(body.model) for _ in range(count)] if own_models else [body.model] * count
        self._own_models = own_models
        self._find_contact_sensors()
        self._force = int(body.model.sensor("accelerometer").adr[0])
        self.views = [BodyState(model, robot) for model in self.models]
        self._make_batch()

    def _make_batch(self) -> None:
        model = self.body.model
        # MuJoCo stores sleeping bodies in its data, not in the state.
        sleeps = bool(model.opt.enableflags & mujoco.mjtEnableBit.mjENBL_SLEEP)
        # Its own threads would not survive a fork.
        self._batch = Batch(model, self.count, nthread=1, persistent=sleeps)
        self.models_changed()
        self.qpos, self.qvel, self.ctrl = (self._batch.bind(name) for name in ("qpos", "qvel", "ctrl"))
        for view, qpos, qvel in zip(self.views, self.qpos, self.qvel, strict=True):
            view.qpos, view.qvel = qpos, qvel
        self.mocap_pos: FloatArray = self._batch.bind("mocap_pos")
        self._sensordata: FloatArray = self._batch.bind("sensordata")

    def _find_contact_sensors(self) -> None:
        """Note addresses of the body's sensors (n,) and of the wheels' contacts and centers (m, 2)."""
        body, touch, wheels, drops = self.body, list[int](), list[tuple[int, int]](), list[float]()
        for sensor in (body.model.sensor(i) for i in range(body.model.nsensor)):
            if not sensor.name.startswith(CONTACT_SENSOR):
                continue
            geom, address = int(sensor.objid[0]), int(sensor.adr[0])
            if geom not in body.wheel_geoms:
                touch.append(address)
                continue
            center = body.model.sensor(CENTER_SENSOR + body.model.geom(geom).name)
            wheels.append((address, int(center.adr[0])))
            drops.append(float(body.contact_drops[geom]))
        self._touch, self._drops = np.array(touch, np.int64), np.array(drops, np.float64)
        self._wheels = np.array(wheels, np.int64).reshape(-1, 2)

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
        """Let the physics read the robots' own models again after one was edited."""
        if self._own_models:
            self._batch.set_models(self.models)

    def step(self, ids: Int32Array | None, steps: int) -> dict[int, str]:
        """Step robots with their controls; return the errors of those that MuJoCo could not step."""
        try:
            self._batch.step(ids, nstep=steps)
        except BatchError as error:
            return {int(i): self._batch.error(int(i)) for i in error.ids}
        return {}

    def settle(self, i: int, T_world_base: Pose3, walkers: FloatArray | None = None) -> None:
        """Release robot `i` in a pose with its wheels held, and settle (see `RobotModel.settle`)."""
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
        diverged: BoolArray = np.zeros(self.count, np.bool_)
        _find_diverged(self.qpos, self.qvel, self._batch.warning, KINDS, diverged)
        return diverged

    def divergence(self, i: int) -> str:
        """Return how robot `i` has diverged; empty = it has not."""
        if not self.find_diverged()[i]:
            return ""
        return divergence_message(float(self._batch.bind("time")[i].item()), self._batch.warning[i, :, 1])


@njit
def _add_touching(
    sensordata: FloatArray, touch: IntArray, wheels: IntArray, drops: FloatArray, touched: BoolArray
) -> None:
    """Mark colliding robots like `lirs_envs.robot_model.contact_state`, from readings of contact sensors."""
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
    qpos: FloatArray, qvel: FloatArray, warning: Int32Array, kinds: IntArray, diverged: BoolArray
) -> None:
    for i in range(len(diverged)):
        diverged[i] = not is_sound(warning[i, :, 1], kinds, qpos[i], qvel[i])


class SingleBody:
    """One robot stepped by `mujoco.mj_step`, with the interface of `Bodies` and records of each update."""

    def __init__(self, robot: Robot, body: RobotModel) -> None:
        self.robot, self.body, self.views, self.models, self.count = robot, body, [body], [body.model], 1
        self.clear()
        self._bind()

    def clear(self) -> None:
        """Clear the records."""
        self._controls, self._penetrations = array("d"), array("d")
        self._touching, self._body_contacts, self._body_seconds = False, 0, 0.0

    def _bind(self) -> None:
        body = self.body
        self.qpos, self.qvel, self.ctrl = body.qpos[None], body.qvel[None], body.ctrl[None]
        self.mocap_pos, self._force = body.walker_centers[None], body.force[None]

    def __getstate__(self) -> dict[str, Any]:
        live = ("models", "qpos", "qvel", "ctrl", "mocap_pos", "_force")
        return {name: value for name, value in self.__dict__.items() if name not in live}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.models = [self.body.model]
        self._bind()

    @property
    def controls(self) -> FloatArray:
        """(n, nu) controls of each update since `clear`."""
        return np.array(self._controls).reshape(-1, self.ctrl.shape[1])

    @property
    def collisions(self) -> Collisions:
        """Contacts since `clear`."""
        depths = np.array(self._penetrations or (0.0,))
        return Collisions(
            max_penetration=float(depths.max()),
            penetration_p999=float(np.quantile(depths, 0.999)),
            body_contacts=self._body_contacts,
            body_contact_seconds=self._body_seconds,
            samples=len(self._penetrations),
        )

    def models_changed(self) -> None:
        """Do nothing: the physics reads the model itself."""

    def step(self, ids: Int32Array | None, steps: int) -> dict[int, str]:
        """Step the robot with its controls."""
        mujoco.mj_step(self.body.model, self.body.data, steps)
        return {}

    def settle(self, i: int, T_world_base: Pose3, walkers: FloatArray | None = None) -> None:
        """Release the robot in a pose with its wheels held, and settle (see `RobotModel.settle`)."""
        self.body.settle(T_world_base, walkers)

    def add_touching(self, touched: BoolArray, dt: float) -> None:
        """Record controls and contacts of `dt` seconds; mark in (1,) a robot that collides."""
        data, depth, touching = self.body.data, 0.0, False
        self._controls.frombytes(self.body.ctrl.tobytes())
        if data.ncon:
            c, drops = data.contact, self.body.contact_drops
            depth, touching = contact_state(c.dist, c.geom, c.pos, data.geom_xpos, drops)
        self._penetrations.append(depth)
        self._body_contacts += touching and not self._touching
        self._body_seconds += dt * touching
        self._touching = touching
        touched[0] |= touching

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


class RobotGroup:
    """Robots `rows` of a simulation; array row k is the group's k-th robot.

    Attributes:
        rows: Rows of the simulation.
        imu: Inertial units, read at each period's end.
        odometry: (n, 3) `T_odom_base`: x, y, yaw, meters and radians.
        surfaces: Ground of each robot; replaceable.
        walkers: Walkers around each robot; None = none; replaceable.
        waypoints: Pose that each quadrotor flies to instead of its command; None = the command.
        inertial: Inertial readings near 200 Hz in the last period of each robot; None without such a unit.
        touched: (n,) whether the robot collided in the last `advance` (see `RobotModel.contact_drops`).
        physics_seconds: Wall-clock seconds of the last `advance` in MuJoCo's step.
    """

    def __init__(
        self, config: SimulationConfig, rows: range, bodies: Bodies | SingleBody, world: World
    ) -> None:
        robot, noise, body, count = config.robot, config.noise, bodies.body, len(rows)
        self.rows, self.bodies, self._config = rows, bodies, config
        self.surfaces: list[HeightField] = [world.surface] * count
        self.walkers = [make_walkers(world, config) for _ in rows]
        self.touched: BoolArray = np.zeros(count, np.bool_)
        self.physics_seconds = 0.0
        updates = len(body.substeps)
        self.imu = ImuSensors(noise.imu, count, updates)
        self.waypoints: list[Waypoint | None] = [None] * count
        self._late: LateCommands | None = None
        self._control = make_controllers(robot, body.actuators, bodies.views, self.surfaces, self.waypoints)
        self._odometry: WheelOdometries | Odometries
        if robot.flies or noise.odometry.method == "ekf":
            self._odometry = Odometries(robot, noise.odometry, noise.imu, bodies.views)
        else:
            self._odometry = WheelOdometries(body.wheels, noise.odometry, count, updates)
        self.odometry = self._odometry.pose
        self._units: list[InertialUnit] = []
        self.inertial: list[ImuReadings | None] = [None] * count
        if config.inertial is not None:
            self._units = [InertialUnit(config.inertial, body.timestep, body.gravity) for _ in rows]
        # Of each physics step, and of each control update, of the last period.
        self._motion = np.zeros((sum(body.substeps), count, MOTION))
        self._track = np.zeros((updates, count, 3))

    @property
    def imu_rate(self) -> float | None:
        """Inertial readings a second, Hz; None without `SimulationConfig.inertial`."""
        return self._units[0].rate if self._units else None

    def set_latency(self, k: int, seconds: float) -> None:
        """Set the latency of robot `k`'s commands (see `LateCommands`)."""
        if self._late is None:
            self._late = LateCommands(self.bodies.count)
        body = self.bodies.body
        self._late.updates[k] = round(seconds / (body.timestep * max(body.substeps)))

    def set_slip(self, k: int, share: float) -> None:
        """Lengthen the measured distance of robot `k` by a share, until it begins."""
        self._odometry.set_slip(k, share)

    def replace_world(self, k: int, world: World) -> None:
        """Replace the ground of robot `k` and the walkers around it."""
        self.surfaces[k] = world.surface
        self.walkers[k] = make_walkers(world, self._config)

    def place(self, k: int, world: World, start: Pose2, seed: int) -> None:
        """Put robot `k` at rest on the ground, and the walkers around it on new paths."""
        bodies, robot = self.bodies, self.bodies.robot
        T_world_base, touchable, walkers = standing_pose(world, robot, start), None, self.walkers[k]
        if walkers is not None:
            walkers.reset(start, np.random.default_rng((seed, WALKER_STREAM)))
            touchable = walkers.touchable
        bodies.settle(k, T_world_base, touchable)
        divergence = bodies.divergence(k)
        if divergence:
            raise SimulationError(divergence)
        settled = bodies.views[k].pose()
        check_settled(robot, start, settled, tipped=is_tipped(settled))

    def begin(self, k: int, seed: int) -> None:
        """Start robot `k` where it stands."""
        bodies = self.bodies
        self.imu.begin(k, bodies.qpos, bodies.qvel, sensor_stream(seed, IMU_STREAM))
        self._odometry.begin(k, bodies.qpos, sensor_stream(seed, ODOMETRY_STREAM))
        self._control.begin(k)
        if self._late is not None:
            self._late.begin(k)
        self.imu.read(np.array((k,)), bodies.qpos, bodies.specific_force(), bodies.body.period)
        self.touched[k] = False
        if self._units:
            motion = np.concatenate((bodies.qpos[k, 3:7], bodies.qvel[k, :6]))
            self._units[k].begin(motion, sensor_stream(seed, INERTIAL_STREAM))
            self.inertial[k] = self._units[k].read(self._motion[:0, k])

    def advance(self, ids: IntArray, commands: FloatArray) -> dict[int, str]:
        """Drive robots for one period, then read their sensors; return the errors of robots that diverged.

        A diverged robot keeps its last readings.

        Args:
            ids: Robots of the group, sorted.
            commands: (n, 3) speeds ahead, m/s, turn rates, rad/s, climbs, m/s.
        """
        bodies, imu, odometry = self.bodies, self.imu, self._odometry
        touched, before = np.zeros(bodies.count, np.bool_), self.odometry.copy()
        some = ids.astype(np.int32) if len(ids) < bodies.count else None
        failed: dict[int, str] = {}
        self.physics_seconds, done = 0.0, 0
        for update, steps in enumerate(bodies.body.substeps):
            dt = steps * bodies.body.timestep
            present = commands if self._late is None else self._late.delay(ids, commands)
            self._control.update(ids, present, imu.rates, dt, bodies.ctrl)
            begun = clock()
            failed |= self._step(ids, some, self._motion[done : done + steps], dt)
            self.physics_seconds += clock() - begun
            done += steps
            bodies.add_touching(touched, dt)
            imu.read_rates(ids, bodies.qvel)
            odometry.integrate(ids, bodies.qpos, imu.rates, imu.attitude, dt)
            if self._units:
                self._track[update] = self.odometry
        self.touched[ids] = touched[ids]
        stopped = [*{*failed, *ids[bodies.find_diverged()[ids]].tolist()}]
        errors = {k: failed.get(k, "") or bodies.divergence(k) for k in stopped}
        if errors:
            self.odometry[stopped] = before[stopped]
            ids = ids[~np.isin(ids, stopped)]
        imu.read(ids, bodies.qpos, bodies.specific_force(), bodies.body.period)
        odometry.read(ids)
        for k in ids.tolist() if self._units else ():
            self.inertial[k] = self._units[k].read(self._motion[:, k])
        return errors

    def _step(self, ids: IntArray, some: Int32Array | None, motion: FloatArray, dt: float) -> dict[int, str]:
        """Let the walkers walk, then step the robots; inertial units need their motion (steps, n, 10)."""
        bodies = self.bodies
        for k in ids.tolist() if self._config.actors else ():
            walkers, (x, y) = self.walkers[k], bodies.qpos[k, :2].tolist()
            if walkers is not None:
                walkers.advance(dt, x, y)
                bodies.mocap_pos[k] = walkers.touchable
        if not self._units:
            return bodies.step(some, len(motion))
        failed: dict[int, str] = {}
        for row in motion:
            failed |= bodies.step(some, 1)
            row[:, :4], row[:, 4:] = bodies.qpos[:, 3:7], bodies.qvel[:, :6]
        return failed

    def track(self, k: int, stamp: float) -> tuple[tuple[float, Pose2], ...]:
        """Return stamps and `T_odom_base` near `TRACK_RATE` in the period before `stamp`, without its end.

        There is none without inertial readings, and of odometry that is filtered once a scan.
        """
        if not self._units or isinstance(self._odometry, Odometries):
            return ()
        body, poses = self.bodies.body, self._track[:, k].tolist()
        ends = stamp - body.period + body.timestep * np.cumsum(body.substeps)
        every = max(1, round(len(poses) / (TRACK_RATE * body.period)))
        chosen = range(len(poses) - 1 - every, -1, -every)
        return tuple((float(ends[n]), Pose2(*poses[n])) for n in reversed(chosen))


def make_groups(
    config: SimulationConfig, body: RobotModel, world: World, count: int, *, threads: int, own_models: bool
) -> list[RobotGroup]:
    """Return `count` robots in groups, at most one per thread."""
    # The calls of a group cost half a robot's step and never run at the same time: g groups take
    # g / 2 + count / g steps.
    number = min(threads, math.isqrt(2 * count))
    groups = []
    for k in range(number):
        rows = range(k * count // number, (k + 1) * count // number)
        bodies = Bodies(config.robot, body, len(rows), own_models=own_models)
        groups.append(RobotGroup(config, rows, bodies, world))
    return groups


def make_walkers(world: World, config: SimulationConfig) -> Walkers | None:
    """Return the walkers of a config in a world; None = it has none."""
    if not config.actors:
        return None
    props = [footprint(prop) for prop in config.props]
    return Walkers(world, config.actors, config.robot.radius, props, bodies=config.walker_bodies)
