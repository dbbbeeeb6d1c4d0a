"""N robots with their sensors, each alone in a world, stepped together."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import mujoco
import numpy as np

from lirs_envs.batch.bodies import Bodies
from lirs_envs.batch.lidars import Lidars
from lirs_envs.batch.robot_group import RobotGroup, make_body, make_groups, make_walkers
from lirs_envs.batch.work_threads import Work, WorkThreads
from lirs_envs.lidar.lidar import BaseVelocity
from lirs_envs.lidar.ray_casting import Caster, make_caster
from lirs_envs.robot_model import TIPPED
from lirs_envs.sensing.sensors import Observation, sensor_streams
from lirs_envs.simulation_config import SimulationConfig
from lirs_wct import ConfigError, HeightField, LaserScan, Pose2, Pose3, World
from lirs_wct.arrays import BoolArray, Float32Array, FloatArray, IntArray
from lirs_wct.export.mjcf import write_heights

PARTS = 4
"""Number of parts of each thread's scans: scans take different times."""


class BatchSimulation:
    """N robots of one kind, each alone in its world.

    Array row i is robot i. A robot's results do not depend on the other robots, their number or the
    threads. Each thread drives a group of robots through the whole period, and then computes scans of any
    group that are due.

    Attributes:
        worlds: the world of each robot.
        config: robot and sensors.
        period: time of one `advance`, seconds.
        count: number of robots, N.
        body: the compiled model of all robots; own models may differ in friction, mass and heights.
        groups: groups of robots; one thread at a time advances a group.
        casters: ray caster of each robot's lidar.
        ranges: (N, beams) float32 of the last scans (see `LaserScan`).
        odometry: (N, 3) `T_odom_base`: x, y, yaw, meters and radians.
        attitude: (N, 2) measured roll and pitch, radians.
        touched: (N,) whether the robot collided in the last `advance` (see `RobotModel.contact_drops`).
        T_world_base: (N, 7) x, y, z, qw, qx, qy, qz of the last valid pose of each robot.
        errors: reason why each robot's simulation cannot continue; empty = it can.

    Args:
        world: world of all robots, until `replace_terrain`.
        config: robot, sensors, contact geometry.
        count: number of robots, N.
        period: seconds.
        threads: number of threads.
        own_models: whether each robot has a MuJoCo model of its own (see `Bodies`).
        height_range: lowest and highest height of replacement terrains, meters; None = no replacement.

    Raises:
        ConfigError: the noise has faults, which only a single simulation has.
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
        if config.noise.faults.any:
            raise ConfigError("faults of sensors are for one simulation, not for a batch of them")
        self.config, self.period, self.threads = config, period, threads
        self.worlds = [world] * count
        self.body = make_body(world, config, period, height_range=height_range, contact_sensors=True)
        self._height_range = height_range
        self.groups = make_groups(
            config,
            self.body,
            world,
            count,
            threads=threads,
            own_models=own_models or height_range is not None,
        )
        for group in self.groups if config.actors else ():
            group.walkers = [make_walkers(world, self.config) for _ in group.rows]
        self._places = [(group, k) for group in self.groups for k in range(len(group.rows))]
        self._ray_data: list[mujoco.MjData] = []
        if config.props or config.rays == "mujoco":
            self._ray_data = [mujoco.MjData(self.model(i)) for i in range(count)]
        first = self._make_caster(0)
        alone = self._ray_data or config.actors
        self.casters = [first, *((self._make_caster(i) if alone else first) for i in range(1, count))]
        self._make_rows(count)
        self._threads = WorkThreads(threads)

    def _make_rows(self, count: int) -> None:
        config = self.config
        self._bounds = np.array([world.surface.bounds for world in self.worlds])
        self.lidar_noise = [config.noise.of_lidar(config.preset)] * count
        self._lidars = Lidars(config, count)
        self._stamps = np.zeros(count)
        self._ticks = np.zeros(count, np.int64)
        self.errors = [""] * count
        self.T_world_base: FloatArray = np.tile((0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0), (count, 1))

    @property
    def count(self) -> int:
        """Number of robots, N."""
        return len(self.worlds)

    def model(self, i: int) -> mujoco.MjModel:
        """Return the model of robot `i`. Call `model_changed` after an edit of a robot's own model."""
        group, k = self._places[i]
        return group.bodies.models[k]

    def model_changed(self, i: int) -> None:
        """Reload the edited model of robot `i` into the physics."""
        self._places[i][0].bodies.models_changed()

    def qpos(self, i: int) -> FloatArray:
        """Return the positions (nq,) of robot `i`, live; the first seven are those of `T_world_base`."""
        group, k = self._places[i]
        return np.asarray(group.bodies.qpos[k])

    def qvel(self, i: int) -> FloatArray:
        """Return the velocities (nv,) of robot `i`, live."""
        group, k = self._places[i]
        return np.asarray(group.bodies.qvel[k])

    def set_latency(self, i: int, seconds: float) -> None:
        """Delay the commands of robot `i`, by whole control updates."""
        group, k = self._places[i]
        group.set_latency(k, seconds)

    def set_slip(self, i: int, share: float) -> None:
        """Lengthen the measured distance of robot `i` by a share, until its reset."""
        group, k = self._places[i]
        group.set_slip(k, share)

    def _make_caster(self, i: int) -> Caster:
        data = self._ray_data[i] if self._ray_data else self.body.data
        group, k = self._places[i]
        walkers = group.walkers[k] if group.walkers else None
        return make_caster(self.worlds[i], self.config.rays, bool(self.config.props), data, walkers)

    def close(self) -> None:
        """End the threads; later calls run in the calling thread."""
        self._threads.close()

    @property
    def ranges(self) -> Float32Array:
        """(N, beams) float32 of the last scans (see `LaserScan`)."""
        return self._lidars.ranges

    @property
    def odometry(self) -> FloatArray:
        """(N, 3) `T_odom_base`: x, y, yaw, meters and radians."""
        return np.concatenate([group.odometry for group in self.groups])

    @property
    def attitude(self) -> FloatArray:
        """(N, 2) measured roll and pitch, radians."""
        return np.concatenate([group.imu.attitude for group in self.groups])

    @property
    def touched(self) -> BoolArray:
        """(N,) whether the robot collided in the last `advance` (see `RobotModel.contact_drops`)."""
        return np.concatenate([group.touched for group in self.groups])

    def replace_terrain(self, i: int, world: World) -> None:
        """Replace the world of robot `i` and the heights of its ground; call `reset` next.

        Raises:
            ConfigError: the batch was made without a height range, or the heights do not fit it.
        """
        if self._height_range is None:
            raise ConfigError(f"the world {self.worlds[i].name!r} cannot be replaced: it has no height range")
        write_heights(self.model(i), world.surface, self._height_range)
        self.model_changed(i)
        group, k = self._places[i]
        self.worlds[i], group.surfaces[k], self._bounds[i] = world, world.surface, world.surface.bounds
        if group.walkers:
            group.walkers[k] = make_walkers(world, self.config)
        self.casters[i] = self._make_caster(i)

    def reset(self, i: int, start: Pose2, seed: int) -> None:
        """Place robot `i` at rest on the ground; restart its time, odometry and noise.

        Raises:
            SimulationError: it cannot stand there.
        """
        group, k = self._places[i]
        self.errors[i] = "a robot must be reset before it is advanced"
        group.place(k, self.worlds[i], start, seed)
        self._read_poses(group, np.array((k,)))
        self._begin(i, seed)

    def _begin(self, i: int, seed: int) -> None:
        group, k = self._places[i]
        lidar, odometry, imu = sensor_streams(seed)
        self._lidars.begin(i, self.casters[i], self.lidar_noise[i], lidar)
        group.begin(k, odometry, imu, self.period)
        self._ticks[i], self._stamps[i], self.errors[i] = 0, 0.0, ""
        self._scan(np.array((i,)))

    def advance(
        self, ids: IntArray, commands: FloatArray, after_scan: Callable[[IntArray], None] | None = None
    ) -> None:
        """Drive robots for one period.

        A robot that diverges has its `errors` entry set and keeps its readings.

        Args:
            ids: rows of the robots, sorted.
            commands: (N, 3) speeds ahead, m/s, turn rates, rad/s, climbs, m/s; beyond the robot's limits they
                are clipped.
            after_scan: called with rows of robots that have a new scan, perhaps from several threads at a
                time.
        """
        share = -(-len(ids) // (PARTS * self.threads if self.threads > 1 else 1))

        def scan(rows: IntArray) -> tuple[()]:
            self._scan(rows)
            if after_scan is not None:
                after_scan(rows)
            return ()

        def drive(group: RobotGroup[Bodies]) -> list[Work]:
            due = self._drive(group, ids, commands)
            return [partial(scan, due[k : k + share]) for k in range(0, len(due), share)]

        self._threads.run([partial(drive, group) for group in self.groups])

    def _drive(self, group: RobotGroup[Bodies], ids: IntArray, commands: FloatArray) -> IntArray:
        """Drive the robots of a group that are among `ids`; return rows due for scans."""
        rows = group.rows
        local = ids[(ids >= rows.start) & (ids < rows.stop)] - rows.start
        if not len(local):
            return local
        for k, error in group.advance(local, commands[rows.start : rows.stop]).items():
            self.errors[rows.start + k] = error
        going = np.array([k for k in local.tolist() if not self.errors[rows.start + k]], np.int64)
        self._read_poses(group, going)
        group.read(going, self.period)
        going += rows.start
        self._ticks[going] += 1
        return going[self._scan_is_due(going)]

    def _read_poses(self, group: RobotGroup[Bodies], ids: IntArray) -> None:
        group.bodies.read_poses(ids, self.T_world_base[group.rows.start : group.rows.stop])

    def _scan_is_due(self, rows: IntArray) -> BoolArray:
        """Return whether each lidar has begun a new scan in the last period."""
        scans, ticks = self.period * self.config.preset.rate, self._ticks[rows]
        due: BoolArray = np.floor(ticks * scans + 1e-9) > np.floor((ticks - 1) * scans + 1e-9)
        return due

    def _scan(self, rows: IntArray) -> None:
        for i in rows.tolist() if self._ray_data else ():
            data = self._ray_data[i]
            group, k = self._places[i]
            data.qpos[:], data.mocap_pos[:] = group.bodies.qpos[k], group.bodies.mocap_pos[k]
        self._lidars.scan(rows, self.T_world_base, self._velocity)
        self._stamps[rows] = self._ticks[rows] * self.period

    def _velocity(self, i: int) -> BaseVelocity:
        qvel = self.qvel(i)
        x, y, z = (qvel[:3] @ self.pose(i).rotation).tolist()
        roll, pitch, yaw = qvel[3:6].tolist()
        return BaseVelocity((x, y, z), (roll, pitch, yaw))

    def pose(self, i: int) -> Pose3:
        """Return the last valid `T_world_base` of robot `i`."""
        return Pose3(*self.T_world_base[i].tolist())

    def time(self, i: int) -> float:
        """Return the seconds since robot `i` was reset."""
        return float(self._ticks[i] * self.period)

    def walkers(self, i: int) -> FloatArray:
        """Return (n, 3) centers of the walkers around robot `i`, meters."""
        group, k = self._places[i]
        return group.walkers[k].centers.copy() if group.walkers else np.zeros((0, 3))

    def surface(self, i: int) -> HeightField:
        """Return the ground of robot `i`."""
        return self.worlds[i].surface

    def find_tipped(self) -> BoolArray:
        """Return (N,) whether each robot tilts by more than 60 deg or lies on its back."""
        x, y = self.T_world_base[:, 4], self.T_world_base[:, 5]
        return np.asarray(1 - 2 * (x * x + y * y) < TIPPED)

    def off_world(self) -> BoolArray:
        """Return (N,) whether base_link of each robot is beyond its world's border."""
        place = self.T_world_base[:, :2]
        inside = (place >= self._bounds[:, :2]) & (place <= self._bounds[:, 2:])
        return np.asarray(~inside.all(axis=1))

    def reading(self, i: int) -> Observation:
        """Return the last sensor readings of robot `i` as arguments of a mapper."""
        preset, (group, k) = self.config.preset, self._places[i]
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
        return Observation(scan, Pose2(*group.odometry[k].tolist()), group.imu.reading(k, self.time(i)))
