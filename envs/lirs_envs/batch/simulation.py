"""N robots with their sensors, each alone in a world, stepped together."""

from __future__ import annotations

import math
from collections.abc import Callable

import mujoco
import numpy as np

from lirs_envs.actors.walkers import TOUCHABLE, WALKER_STREAM, Walkers
from lirs_envs.batch.bodies import Bodies
from lirs_envs.batch.control import DifferentialDrives, WheelActuators
from lirs_envs.batch.imu import ImuReadings
from lirs_envs.batch.lidars import Lidars
from lirs_envs.batch.odometry import WheelJoints, WheelOdometries
from lirs_envs.batch.per_robot import FlightControllers, Odometries
from lirs_envs.batch.row_threads import RowThreads
from lirs_envs.lidar.casters import make_caster
from lirs_envs.lidar.lidar import BaseVelocity
from lirs_envs.lidar.noise import LidarNoise, lidar_noise
from lirs_envs.lidar.ray_casting import Caster
from lirs_envs.placement import MAX_SETTLING_DISTANCE, standing_pose
from lirs_envs.props import footprint
from lirs_envs.robot_model import TIPPED, RobotModel, is_tipped
from lirs_envs.sensing.sensors import IMU_STREAM, LIDAR_STREAM, ODOMETRY_STREAM, Observation
from lirs_envs.simulation_config import SimulationConfig
from lirs_wct.arrays import BoolArray, Float32Array, FloatArray, IntArray
from lirs_wct.errors import ConfigError, SimulationError
from lirs_wct.export.mjcf import write_heights
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.geometry.pose import Pose2, Pose3
from lirs_wct.geometry.scan import Imu, LaserScan
from lirs_wct.world import World


class BatchSimulation:
    """N robots of one kind, each alone in a world; row i of every array is robot i's.

    What happens to a robot does not depend on the others, on their number or on the threads.

    Attributes:
        worlds: of each robot.
        config: robot and sensors.
        period: time of one `advance`, seconds.
        bodies: physics.
        casters: what each robot's lidar sees.
        ranges: (N, beams) float32 of the last scans (see `LaserScan`).
        odometry: (N, 3) `T_odom_base`: x, y, yaw, metres and radians.
        attitude: (N, 2) measured roll and pitch, radians.
        touched: (N,) whether the robot's body (not a wheel) touched anything in the last `advance`.
        T_world_base: (N, 7) x, y, z, qw, qx, qy, qz of the last valid pose of each robot.
        errors: of each robot, why its simulation cannot go on; empty = it can.

    Args:
        world: of all robots, until `replace_terrain`.
        config: robot, sensors, contact geometry.
        count: number of robots, N.
        period: seconds.
        threads: number of threads.
        own_models: whether each robot has a MuJoCo model of its own (see `Bodies`).
        height_range: of the terrains that may replace the world's, metres; None = the world stays.
    """

    def __init__(
        self,
        world: World,
        config: SimulationConfig,
        *,
        count: int,
        period: float,
        threads: int = 1,
        own_models: bool = False,
        height_range: tuple[float, float] | None = None,
    ) -> None:
        self.config, self.period, self.threads = config, period, threads
        self.worlds = [world] * count
        body = RobotModel(
            world,
            config.robot,
            period,
            props=config.props,
            contact_geometry=config.contact_geometry,
            mujoco_rays=config.rays == "mujoco",
            actors=self._walker_bodies,
            height_range=height_range,
            contact_sensors=True,
        )
        self._height_range = height_range
        self.bodies = Bodies(
            config.robot, body, count, threads, own_models=own_models or height_range is not None
        )
        self._ray_data: list[mujoco.MjData] = []
        if config.props or config.rays == "mujoco":
            self._ray_data = [mujoco.MjData(model) for model in self.bodies.models]
        self._walkers = [self._make_walkers(world) for _ in range(count if config.actors else 0)]
        first = self._make_caster(0)
        alone = self._ray_data or self._walkers
        self.casters = [first, *((self._make_caster(i) if alone else first) for i in range(1, count))]
        self._make_sensors(count)
        self._threads = RowThreads(threads)

    def _make_sensors(self, count: int) -> None:
        config, body = self.config, self.bodies.body
        robot, noise = config.robot, config.noise
        self._surfaces = [world.surface for world in self.worlds]
        self._bounds = np.array([surface.bounds for surface in self._surfaces])
        self._imu = ImuReadings(noise.imu, count)
        self._control: DifferentialDrives | FlightControllers
        self._odometry: WheelOdometries | Odometries
        if robot.flies:
            self._control = FlightControllers(self.bodies, self._surfaces)
        else:
            self._control = DifferentialDrives(robot, WheelActuators(*map(_indices, body.actuators)), count)
        if robot.flies or noise.odometry.method == "ekf":
            self._odometry = Odometries(self.bodies, noise)
        else:
            joints = WheelJoints(_indices(body.left_angles), _indices(body.right_angles), robot.wheel_radius)
            self._odometry = WheelOdometries(joints, noise.odometry, count)
        self.lidar_noise: list[LidarNoise] = [
            noise.lidar if isinstance(noise.lidar, LidarNoise) else lidar_noise(config.preset, noise.lidar)
        ] * count
        self._lidars = Lidars(config, count)
        self._stamps = np.zeros(count)
        self._ticks = np.zeros(count, np.int64)
        self.touched: BoolArray = np.zeros(count, np.bool_)
        self.errors = [""] * count
        self.T_world_base: FloatArray = np.tile((0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0), (count, 1))

    @property
    def _walker_bodies(self) -> int:
        """How many walkers MuJoCo has a body of: its own rays are to meet all of them."""
        actors = self.config.actors
        return actors if self.config.rays == "mujoco" else min(actors, TOUCHABLE)

    def _make_walkers(self, world: World) -> Walkers:
        config = self.config
        props = [footprint(prop) for prop in config.props]
        return Walkers(world, config.actors, config.robot.radius, props, bodies=self._walker_bodies)

    def _make_caster(self, i: int) -> Caster:
        data = self._ray_data[i] if self._ray_data else self.bodies.body.data
        walkers = self._walkers[i] if self._walkers else None
        return make_caster(self.worlds[i], self.config.rays, bool(self.config.props), data, walkers)

    def close(self) -> None:
        """End the threads; whatever comes after runs in one."""
        self._threads.close()

    @property
    def ranges(self) -> Float32Array:
        """(N, beams) float32 of the last scans (see `LaserScan`)."""
        return self._lidars.ranges

    @property
    def odometry(self) -> FloatArray:
        """(N, 3) `T_odom_base`: x, y, yaw, metres and radians."""
        return self._odometry.pose

    @property
    def attitude(self) -> FloatArray:
        """(N, 2) measured roll and pitch, radians."""
        return self._imu.attitude

    def replace_terrain(self, i: int, world: World) -> None:
        """Set robot `i` into another world, whose heights its ground takes; a reset comes next.

        Raises:
            ConfigError: the batch was made without a height range, or the heights do not fit it.
        """
        if self._height_range is None:
            raise ConfigError(f"the world {self.worlds[i].name!r} cannot be replaced: it has no height range")
        write_heights(self.bodies.models[i], world.surface, self._height_range)
        self.bodies.models_changed()
        self.worlds[i], self._surfaces[i], self._bounds[i] = world, world.surface, world.surface.bounds
        if self._walkers:
            self._walkers[i] = self._make_walkers(world)
        self.casters[i] = self._make_caster(i)

    def reset(self, i: int, start: Pose2, seed: int) -> None:
        """Set robot `i` at rest on the ground; its time, odometry and noise begin anew.

        Raises:
            SimulationError: it cannot stand there.
        """
        bodies, robot = self.bodies, self.config.robot
        self.errors[i] = "a robot must be reset before it is advanced"
        T_world_base, touchable = standing_pose(self.worlds[i], robot, start), None
        if self._walkers:
            self._walkers[i].reset(start, np.random.default_rng((seed, WALKER_STREAM)))
            touchable = self._walkers[i].touchable
        bodies.settle(i, T_world_base, touchable)
        divergence = bodies.divergence(i)
        if divergence:
            raise SimulationError(divergence)
        bodies.read_poses(np.array((i,)), self.T_world_base)
        there = self.pose(i)
        if math.hypot(there.x - start.x, there.y - start.y) > MAX_SETTLING_DISTANCE or is_tipped(there):
            raise SimulationError(
                f"{robot.name} does not stay at ({start.x:.2f}, {start.y:.2f}): "
                f"it slid or tipped to ({there.x:.2f}, {there.y:.2f})"
            )
        self._begin(i, seed)

    def _begin(self, i: int, seed: int) -> None:
        bodies, row = self.bodies, np.array((i,))
        lidar, odometry, imu = (
            np.random.default_rng((seed, stream)) for stream in (LIDAR_STREAM, ODOMETRY_STREAM, IMU_STREAM)
        )
        self._lidars.begin(i, self.casters[i], self.lidar_noise[i], lidar)
        self._imu.begin(i, bodies.qpos, bodies.qvel, imu)
        self._odometry.begin(i, bodies.qpos, odometry)
        self._control.begin(i)
        self._imu.read(row, bodies.qpos, bodies.specific_force(), self.period)
        self._ticks[i], self._stamps[i] = 0, 0.0
        self.errors[i], self.touched[i] = "", False
        self._scan(row)

    def advance(
        self, ids: IntArray, commands: FloatArray, after_scan: Callable[[IntArray], None] | None = None
    ) -> None:
        """Drive robots for one period; those that diverge have their `errors` set and keep their readings.

        Args:
            ids: rows of the robots, sorted.
            commands: (N, 3) speeds ahead, m/s, turn rates, rad/s, climbs, m/s; beyond the robot's limits they
                are clipped.
            after_scan: called with rows of robots that have a new scan, perhaps from several threads at a
                time.
        """
        bodies, imu = self.bodies, self._imu
        touched, odometry = np.zeros(bodies.count, np.bool_), self.odometry.copy()
        some = ids.astype(np.int32) if len(ids) < bodies.count else None
        failed: dict[int, str] = {}
        for steps in bodies.body.substeps:
            dt = steps * bodies.body.timestep
            self._control.update(ids, commands, imu.rates, dt, bodies.ctrl)
            self._walk(ids, dt)
            failed |= bodies.step(some, steps)
            bodies.add_touching(touched)
            imu.read_rates(ids, bodies.qvel)
            self._odometry.integrate(ids, bodies.qpos, imu.rates, imu.attitude, dt)
        for i in {*failed, *ids[bodies.diverged()[ids]].tolist()}:
            self.errors[i] = failed.get(i, "") or bodies.divergence(i)
            self.odometry[i] = odometry[i]
        going = np.array([i for i in ids.tolist() if not self.errors[i]], np.int64)
        bodies.read_poses(going, self.T_world_base)
        imu.read(going, bodies.qpos, bodies.specific_force(), self.period)
        self._odometry.read(going)
        self.touched[ids] = touched[ids]
        self._ticks[going] += 1
        self._scan_all(going[self._scan_is_due(going)], after_scan)

    def _walk(self, ids: IntArray, dt: float) -> None:
        """Let the walkers walk, before the robots' next step."""
        for i in ids.tolist() if self._walkers else ():
            x, y = self.bodies.qpos[i, :2].tolist()
            self._walkers[i].advance(dt, x, y)
            self.bodies.mocap_pos[i] = self._walkers[i].touchable

    def _scan_is_due(self, rows: IntArray) -> BoolArray:
        """Whether lidars, at their own rate, have begun another scan in the last period."""
        scans, ticks = self.period * self.config.preset.rate, self._ticks[rows]
        due: BoolArray = np.floor(ticks * scans + 1e-9) > np.floor((ticks - 1) * scans + 1e-9)
        return due

    def _scan_all(self, due: IntArray, after_scan: Callable[[IntArray], None] | None) -> None:
        def work(rows: IntArray) -> None:
            self._scan(rows)
            if after_scan is not None:
                after_scan(rows)

        self._threads.run(work, due)

    def _scan(self, rows: IntArray) -> None:
        for i in rows.tolist() if self._ray_data else ():
            data = self._ray_data[i]
            data.qpos[:], data.mocap_pos[:] = self.bodies.qpos[i], self.bodies.mocap_pos[i]
        self._lidars.scan(rows, self.T_world_base, self._velocity)
        self._stamps[rows] = self._ticks[rows] * self.period

    def _velocity(self, i: int) -> BaseVelocity:
        x, y, z = (self.bodies.qvel[i, :3] @ self.pose(i).rotation).tolist()
        roll, pitch, yaw = self.bodies.qvel[i, 3:6].tolist()
        return BaseVelocity((x, y, z), (roll, pitch, yaw))

    def pose(self, i: int) -> Pose3:
        """Return the last valid `T_world_base` of robot `i`."""
        return Pose3(*self.T_world_base[i].tolist())

    def time(self, i: int) -> float:
        """Return the seconds since robot `i` was reset."""
        return float(self._ticks[i] * self.period)

    def walkers(self, i: int) -> FloatArray:
        """Return (n, 3) middles of the walkers around robot `i`, metres."""
        return self._walkers[i].centers.copy() if self._walkers else np.zeros((0, 3))

    def surface(self, i: int) -> HeightField:
        """Return the ground of robot `i`."""
        return self._surfaces[i]

    def tipped(self) -> BoolArray:
        """(N,) whether each robot tilts by more than 60 deg or lies on its back."""
        x, y = self.T_world_base[:, 4], self.T_world_base[:, 5]
        tipped: BoolArray = np.less(1 - 2 * (x * x + y * y), TIPPED)
        return tipped

    def off_world(self) -> BoolArray:
        """(N,) whether base_link of each robot is beyond its world's border."""
        place = self.T_world_base[:, :2]
        inside = (place >= self._bounds[:, :2]) & (place <= self._bounds[:, 2:])
        return np.asarray(~inside.all(axis=1))

    def reading(self, i: int) -> Observation:
        """Return what the sensors of robot `i` read last, as a mapper takes it."""
        preset = self.config.preset
        scan = LaserScan(
            self.ranges[i].copy(),
            preset.angle_min,
            preset.angle_increment,
            preset.range_min,
            preset.range_max,
            float(self._stamps[i]),
            self.config.robot.T_base_laser,
            self._lidars.time_increment,
        )
        roll, pitch = self.attitude[i].tolist()
        rates, force = tuple(self._imu.rates[i].tolist()), tuple(self._imu.force[i].tolist())
        return Observation(
            scan, Pose2(*self.odometry[i].tolist()), Imu(roll, pitch, rates, force, self.time(i))
        )


def _indices(values: list[int]) -> IntArray:
    return np.array(values, np.int64)
