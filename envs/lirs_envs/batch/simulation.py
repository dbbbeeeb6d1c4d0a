"""N robots with their sensors, each alone in a world, stepped together."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import mujoco
import numpy as np

from lirs_envs.batch.bodies import Bodies
from lirs_envs.batch.lidars import Lidars
from lirs_envs.batch.robot_group import RobotGroup, make_groups
from lirs_envs.batch.work_threads import Work, WorkThreads
from lirs_envs.lidar.ray_casting import Caster, make_caster
from lirs_envs.robot_model import TIPPED, RobotModel
from lirs_envs.sensing.sensors import LIDAR_STREAM, Observation, sensor_stream
from lirs_envs.simulation_config import SimulationConfig
from lirs_wct import ConfigError, Pose2, Pose3, World
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
        body: the compiled model of all robots; own models may differ in friction, mass and heights.
        groups: groups of robots; one thread at a time advances a group.
        places: group and row in it of each robot.
        bodies: model, positions and velocities of each robot, live.
        casters: ray caster of each robot's lidar.
        T_world_base: (N, 7) x, y, z, qw, qx, qy, qz of the last valid pose of each robot.
        errors: reason why each robot's simulation cannot continue; empty = it can.

    Args:
        world: world of all robots, until `replace_terrain`.
        config: robot, sensors, contact geometry.
        count: number of robots, N.
        period: seconds.
        threads: number of threads.
        own_models: whether each robot has a MuJoCo model of its own (see `Bodies`).

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
    ) -> None:
        if config.noise.faults.any:
            raise ConfigError("faults of sensors are for one simulation, not for a batch of them")
        self.config, self.period, self.threads = config, period, threads
        self.worlds = [world] * count
        self.body = RobotModel(world, config, period, contact_sensors=True)
        own_models = own_models or config.height_range is not None
        self.groups = make_groups(config, self.body, world, count, threads=threads, own_models=own_models)
        self.places = [(group, k) for group in self.groups for k in range(len(group.rows))]
        self.bodies = [body for group in self.groups for body in group.bodies.views]
        self._ray_data: list[mujoco.MjData] = []
        if config.props or config.rays == "mujoco":
            self._ray_data = [mujoco.MjData(body.model) for body in self.bodies]
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

    def _make_caster(self, i: int) -> Caster:
        data = self._ray_data[i] if self._ray_data else self.body.data
        group, k = self.places[i]
        return make_caster(self.worlds[i], self.config.rays, bool(self.config.props), data, group.walkers[k])

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
            ConfigError: the config has no height range, or the heights do not fit it.
        """
        if self.config.height_range is None:
            raise ConfigError(f"the world {self.worlds[i].name!r} cannot be replaced: it has no height range")
        write_heights(self.bodies[i].model, world.surface, self.config.height_range)
        group, k = self.places[i]
        group.bodies.models_changed()
        self.worlds[i], self._bounds[i] = world, world.surface.bounds
        group.replace_world(k, world)
        self.casters[i] = self._make_caster(i)

    def reset(self, i: int, start: Pose2, seed: int) -> None:
        """Place robot `i` at rest on the ground; restart its time, odometry and noise.

        Raises:
            SimulationError: it cannot stand there.
        """
        group, k = self.places[i]
        self.errors[i] = "a robot must be reset before it is advanced"
        group.place(k, self.worlds[i], start, seed)
        self._read_poses(group, np.array((k,)))
        self._begin(i, seed)

    def _begin(self, i: int, seed: int) -> None:
        group, k = self.places[i]
        self._lidars.begin(i, self.casters[i], self.lidar_noise[i], sensor_stream(seed, LIDAR_STREAM))
        group.begin(k, seed, self.period)
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
            group, k = self.places[i]
            data.qpos[:], data.mocap_pos[:] = group.bodies.qpos[k], group.bodies.mocap_pos[k]
        self._lidars.scan(rows, self.T_world_base, self.bodies)
        self._stamps[rows] = self._ticks[rows] * self.period

    def pose(self, i: int) -> Pose3:
        """Return the last valid `T_world_base` of robot `i`."""
        return Pose3(*self.T_world_base[i].tolist())

    def time(self, i: int) -> float:
        """Return the seconds since robot `i` was reset."""
        return float(self._ticks[i] * self.period)

    def walkers(self, i: int) -> FloatArray:
        """Return (n, 3) centers of the walkers around robot `i`, meters."""
        group, k = self.places[i]
        walkers = group.walkers[k]
        return np.zeros((0, 3)) if walkers is None else walkers.centers.copy()

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
        group, k = self.places[i]
        scan = self._lidars.reading(i, float(self._stamps[i]))
        return Observation(scan, *group.reading(k, self.time(i)))
