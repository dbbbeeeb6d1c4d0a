"""Group of a batch's robots that one thread at a time advances.

A group holds physics, control, gyro and odometry.
"""

from __future__ import annotations

import math
from time import perf_counter as clock
from typing import Generic, TypeVar

import numpy as np

from lirs_envs.batch.bodies import Bodies, SingleBody
from lirs_envs.placement import check_settled, standing_pose
from lirs_envs.props import footprint
from lirs_envs.robot_model import RobotModel, is_tipped
from lirs_envs.robots.drive import make_controllers
from lirs_envs.robots.robot import Waypoint
from lirs_envs.sensing.imu import ImuSensors
from lirs_envs.sensing.odometry import WheelJoints, WheelOdometries
from lirs_envs.sensing.sensors import IMU_STREAM, ODOMETRY_STREAM, Odometries, sensor_stream
from lirs_envs.simulation_config import SimulationConfig
from lirs_envs.walkers import WALKER_STREAM, Walkers
from lirs_wct import HeightField, Imu, Pose2, SimulationError, World
from lirs_wct.arrays import BoolArray, FloatArray, IntArray

B = TypeVar("B", bound=Bodies | SingleBody)
LONGEST = 256
"""Control updates that are remembered."""


class LateCommands:
    """Commands of N robots that take effect some control updates later.

    Attributes:
        updates: (N,) number of control updates until a command takes effect; less than `LONGEST`.
    """

    def __init__(self, count: int) -> None:
        self.updates = np.zeros(count, np.int64)
        self._given = np.zeros((count, LONGEST, 3))
        self._turn = np.zeros(count, np.int64)

    def begin(self, k: int) -> None:
        """Forget the commands of robot `k`."""
        self._given[k] = 0.0

    def delay(self, ids: IntArray, commands: FloatArray) -> FloatArray:
        """Return the commands (N, 3) that take effect in this control update of robots `ids`."""
        present, turns = np.zeros_like(commands), self._turn[ids]
        self._given[ids, turns] = commands[ids]
        present[ids] = self._given[ids, (turns - self.updates[ids]) % LONGEST]
        self._turn[ids] = (turns + 1) % LONGEST
        return present


class RobotGroup(Generic[B]):
    """Robots `rows` of a batch; row k of every array is its k-th robot.

    Attributes:
        rows: rows of the batch.
        bodies: physics.
        imu: inertial readings.
        surfaces: ground of each robot; replaceable.
        walkers: walkers around each robot; None = none; replaceable.
        waypoints: pose that each quadrotor flies to instead of its command; None = the command.
        track: odometry after each control update of the last `advance`, x, y, yaw each; None = not recorded.
        touched: (n,) whether the robot collided in the last `advance` (see `RobotModel.contact_drops`).
        physics_seconds: wall-clock seconds of the last `advance` in MuJoCo's step.
        sensor_seconds: wall-clock seconds of the last `advance` in gyro and odometry.
    """

    def __init__(self, config: SimulationConfig, rows: range, bodies: B, world: World) -> None:
        robot, noise, body, count = config.robot, config.noise, bodies.body, len(rows)
        self.rows, self.bodies, self._config = rows, bodies, config
        self.surfaces: list[HeightField] = [world.surface] * count
        self.walkers = [make_walkers(world, config) for _ in rows]
        self.touched: BoolArray = np.zeros(count, np.bool_)
        self.physics_seconds = self.sensor_seconds = 0.0
        self.imu = ImuSensors(noise.imu, count)
        self.track: list[list[float]] | None = None
        self.waypoints: list[Waypoint | None] = [None] * count
        self._late: LateCommands | None = None
        views = bodies.views
        self._control = make_controllers(robot, body.actuators, views, self.surfaces, self.waypoints)
        self._odometry: WheelOdometries | Odometries
        if robot.flies or noise.odometry.method == "ekf":
            self._odometry = Odometries(robot, noise, views)
        else:
            left, right = (np.array(joints, np.int64) for joints in (body.left_angles, body.right_angles))
            joints = WheelJoints(left, right, robot.wheel_radius)
            self._odometry = WheelOdometries(joints, noise.odometry, count)

    @property
    def odometry(self) -> FloatArray:
        """(n, 3) `T_odom_base`: x, y, yaw, meters and radians."""
        return self._odometry.pose

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
        """Replace the ground of robot `k` and the walkers around it.

        Raises:
            SimulationError: the world has no free ground for walkers.
        """
        self.surfaces[k] = world.surface
        self.walkers[k] = make_walkers(world, self._config)

    def place(self, k: int, world: World, start: Pose2, seed: int) -> None:
        """Put robot `k` at rest on the ground, and the walkers around it on new paths.

        Raises:
            SimulationError: it cannot stand there.
        """
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

    def begin(self, k: int, seed: int, dt: float) -> None:
        """Start robot `k` where it stands; its readings come every `dt` seconds."""
        bodies = self.bodies
        self.imu.begin(k, bodies.qpos, bodies.qvel, sensor_stream(seed, IMU_STREAM))
        self._odometry.begin(k, bodies.qpos, sensor_stream(seed, ODOMETRY_STREAM))
        self._control.begin(k)
        if self._late is not None:
            self._late.begin(k)
        self.imu.read(np.array((k,)), bodies.qpos, bodies.specific_force(), dt)
        self.touched[k] = False

    def advance(self, ids: IntArray, commands: FloatArray) -> dict[int, str]:
        """Drive robots for one period; return the errors of robots that diverged.

        The odometry of a diverged robot keeps its last value.

        Args:
            ids: robots of the group, sorted.
            commands: (n, 3) speeds ahead, m/s, turn rates, rad/s, climbs, m/s.
        """
        bodies, imu = self.bodies, self.imu
        touched, odometry = np.zeros(bodies.count, np.bool_), self.odometry.copy()
        some = ids.astype(np.int32) if len(ids) < bodies.count else None
        failed: dict[int, str] = {}
        self.physics_seconds = self.sensor_seconds = 0.0
        for steps in bodies.body.substeps:
            dt = steps * bodies.body.timestep
            present = commands if self._late is None else self._late.delay(ids, commands)
            self._control.update(ids, present, imu.rates, dt, bodies.ctrl)
            begun = clock()
            self._walk(ids, dt)
            failed |= bodies.step(some, steps)
            self.physics_seconds += clock() - begun
            bodies.add_touching(touched, dt)
            begun = clock()
            imu.read_rates(ids, bodies.qvel)
            self._odometry.integrate(ids, bodies.qpos, imu.rates, imu.attitude, dt)
            if self.track is not None:
                self.track.append(self.odometry[0].tolist())
            self.sensor_seconds += clock() - begun
        self.touched[ids] = touched[ids]
        stopped = {*failed, *ids[bodies.find_diverged()[ids]].tolist()}
        for k in stopped:
            self.odometry[k] = odometry[k]
        return {k: failed.get(k, "") or bodies.divergence(k) for k in stopped}

    def read(self, ids: IntArray, dt: float) -> None:
        """Read attitude, specific force and odometry, `dt` seconds after the last reading."""
        self.imu.read(ids, self.bodies.qpos, self.bodies.specific_force(), dt)
        self._odometry.read(ids)

    def reading(self, k: int, stamp: float) -> tuple[Pose2, Imu]:
        """Return the last `T_odom_base` and inertial reading of robot `k`."""
        return Pose2(*self.odometry[k].tolist()), self.imu.reading(k, stamp)

    def _walk(self, ids: IntArray, dt: float) -> None:
        """Advance the walkers before the robots' next step."""
        for k in ids.tolist() if self._config.actors else ():
            walkers, (x, y) = self.walkers[k], self.bodies.qpos[k, :2].tolist()
            if walkers is not None:
                walkers.advance(dt, x, y)
                self.bodies.mocap_pos[k] = walkers.touchable


def make_groups(
    config: SimulationConfig, body: RobotModel, world: World, count: int, *, threads: int, own_models: bool
) -> list[RobotGroup[Bodies]]:
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
    """Return the walkers of a config in a world; None = it has none.

    Raises:
        SimulationError: the world has no free ground.
    """
    if not config.actors:
        return None
    props = [footprint(prop) for prop in config.props]
    return Walkers(world, config.actors, config.robot.radius, props, bodies=config.walker_bodies)
