"""Robots in worlds, stepped together, without Gymnasium."""

from __future__ import annotations

import math
import time
from array import array
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from functools import partial
from numbers import Real
from os import getpid
from typing import Any, Literal

import mujoco
import numpy as np

from lirs_envs.lidar.lidar import Lidars
from lirs_envs.lidar.ray_casting import Caster, WalkerCaster, make_caster
from lirs_envs.robot_group import RobotGroup, SingleBody, make_groups
from lirs_envs.robot_model import TIPPED, Collisions, RobotModel
from lirs_envs.robots.robot import Robot, Twist, Waypoint
from lirs_envs.sensing.sensors import LIDAR_STREAM, FaultInjector, Observation, sensor_stream
from lirs_envs.simulation_config import SimulationConfig, check_fit, resolve_start
from lirs_wct import ConfigError, Imu, Pose2, Pose3, SimulationError, World
from lirs_wct.arrays import BoolArray, FloatArray, IntArray, njit
from lirs_wct.contact.spec import write_heights
from lirs_wct.errors import check_seed

ROW = np.zeros(1, np.int64)
"""The row of a single robot."""
PARTS = 4
"""Number of parts of each thread's scans: scans take different times."""
NOT_RESET = "a simulation must be reset before it is advanced"


@dataclass
class Timing:
    """Wall-clock seconds of each `advance`: in MuJoCo's step, and in sensors and control."""

    physics: array[float] = field(default_factory=lambda: array("d"))
    sensors: array[float] = field(default_factory=lambda: array("d"))


@dataclass(frozen=True)
class PhysicsReplay:
    """The recorded controls through MuJoCo's step alone.

    Attributes:
        seconds: Wall-clock time.
        simulated: Simulated time, seconds.
        T_world_base: Last pose.
    """

    seconds: float
    simulated: float
    T_world_base: Pose3

    @property
    def rtf(self) -> float:
        """Simulated seconds over wall-clock seconds."""
        return self.simulated / self.seconds


class Simulation:
    """N robots of one kind with their sensors, each alone in its world.

    Array row i is robot i. A robot's results do not depend on the other robots, their number or the threads.

    By default there is one robot, which is driven by `reset` and `advance` from scan to scan, and whose
    contacts and controls are recorded. Several are driven by `place` and `drive`; of a lidar with rings they
    have the planar scan alone.

    Attributes:
        worlds: World of each robot.
        period: Time of one `advance` or `drive`, seconds.
        body: MuJoCo's model of robot and world; own models may differ in friction, mass and heights.
        groups: Groups of robots; one thread at a time drives a group.
        single: Physics of the one robot.
        places: Group and row in it of each robot.
        states: True state of each robot, live; the positions hold those of the props as well.
        casters: Ray caster of each robot's lidar against world and props; usable by custom sensors.
        lidar_noise: Noise of each robot's lidar from its next start on.
        ranges: (N, beams) float32 of the last scans (see `LaserScan`).
        T_world_base: (N, 7) x, y, z, qw, qx, qy, qz of the last valid pose of each robot.
        errors: Reason why each robot cannot go on; empty = it can.
        timing: Wall-clock seconds of each `advance` since the reset.
        mishap: Mishap of the one robot, which ends its drive; empty = none.

    Args:
        world: World of all robots, until `replace_terrain`.
        seed: Seed of all random numbers of `reset`; same seed and same commands, same bytes.
        count: Number of robots, N, in a batch of MuJoCo; None = one, which steps alone.
        period: Seconds; None = that of the lidar.
        own_models: Whether each robot of a batch has a MuJoCo model of its own (see `Bodies`).

    Raises:
        ConfigError: the seed is no whole number from 0 up, or robot, props or contact geometry do not fit the
            world.
    """

    def __init__(
        self,
        world: World,
        config: SimulationConfig,
        *,
        seed: int = 0,
        count: int | None = None,
        period: float | None = None,
        threads: int = 1,
        own_models: bool = False,
    ) -> None:
        check_fit(world, config.robot)
        check_seed(seed)
        self.config, self.robot, self._seed = config, config.robot, seed
        self.preset = config.preset if count is None else config.preset.planar
        self.period = self.preset.period if period is None else period
        self._in_step = self.period == self.preset.period  # each period ends with a scan
        self.body = RobotModel(world, config, self.period, contact_sensors=count is not None)
        if count is None:
            self.single = SingleBody(config.robot, self.body)
            self.groups = [RobotGroup(config, range(1), self.single, world)]
        else:
            own_models = own_models or config.height_range is not None
            self.groups = make_groups(config, self.body, world, count, threads=threads, own_models=own_models)
        self.places = [(group, k) for group in self.groups for k in range(len(group.rows))]
        self.worlds = [world] * len(self.places)
        self.states = [view for group in self.groups for view in group.bodies.views]
        self._make_casters()
        self._make_rows()
        self._threads = WorkThreads(threads)

    def _make_casters(self) -> None:
        config = self.config
        data = self._ray_data = [self.body.data] * self.count
        # A batch has no data for MuJoCo's rays.
        self._copies_rays = bool(config.props or config.rays == "mujoco") and self.body not in self.states
        if self._copies_rays:
            data[:] = [mujoco.MjData(view.model) for view in self.states]
        first = self._make_caster(0)
        alone = self._copies_rays or config.actors
        self.casters = [first, *((self._make_caster(i) if alone else first) for i in range(1, self.count))]

    def _make_rows(self) -> None:
        config, count = self.config, self.count
        self._bounds = np.array([world.surface.bounds for world in self.worlds])
        self.lidar_noise = [config.noise.of_lidar(config.preset)] * count
        rolls = config.noise.rolls(self.preset)
        self._lidars = Lidars(self.preset, config.robot.T_base_laser, count, rolling_scan=rolls)
        self.ranges = self._lidars.ranges
        self._faults: dict[int, FaultInjector] = {}
        self._slipped = np.zeros((count, 3))
        self._stamps = np.zeros(count)
        self._ticks = np.zeros(count, np.int64)
        self.errors = [NOT_RESET] * count
        self.T_world_base: FloatArray = np.tile((0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0), (count, 1))
        self.timing = Timing()
        self.mishap: Literal["", "tipped", "off world"] = ""

    @property
    def count(self) -> int:
        """Number of robots, N."""
        return len(self.worlds)

    def _make_caster(self, i: int) -> Caster:
        group, k = self.places[i]
        props = bool(self.config.props)
        return make_caster(self.worlds[i], self.config.rays, props, self._ray_data[i], group.walkers[k])

    def close(self) -> None:
        """End the threads; later calls run in the calling thread."""
        self._threads.close()

    def replace_terrain(self, world: World, i: int = 0) -> None:
        """Replace the world of robot `i`; a reset comes next.

        Contact ground, lidar surface and possible start poses change together. A new simulation in the same
        world gives the same results, bit for bit.

        Raises:
            ConfigError: the config has no height range, or the heights do not fit it or the former world.
        """
        if self.config.height_range is None:
            raise ConfigError(f"the world {self.worlds[i].name!r} cannot be replaced: it has no height range")
        group, k = self.places[i]
        write_heights(group.bodies.models[k], world.surface, self.config.height_range)
        group.bodies.models_changed()
        self.worlds[i], self._bounds[i], self.errors[i] = world, world.surface.bounds, NOT_RESET
        group.replace_world(k, world)
        self.casters[i] = self._make_caster(i)

    def place(self, i: int, start: Pose2, seed: int) -> None:
        """Place robot `i` at rest on the ground; restart its time, odometry and noise.

        Raises:
            SimulationError: it cannot stand there.
        """
        group, k = self.places[i]
        self.errors[i] = NOT_RESET
        group.place(k, self.worlds[i], start, seed)
        row = np.array((i,))
        _read_poses(row, group.rows.start, group.bodies.qpos, self.T_world_base)
        self._lidars.begin(i, self.casters[i], self.lidar_noise[i], sensor_stream(seed, LIDAR_STREAM))
        if self.config.noise.faults.any:
            self._faults[i] = FaultInjector(self.config.noise.faults, self.preset, seed)
        group.begin(k, seed)
        self._ticks[i], self.errors[i] = 0, ""
        self._slip(row)
        self._scan(row)

    def drive(
        self, ids: IntArray, commands: FloatArray, after_scan: Callable[[IntArray], None] | None = None
    ) -> None:
        """Drive robots `ids`, sorted, for one period.

        A robot that diverges has its `errors` entry set and keeps its readings.

        Commands (N, 3) are speeds ahead, m/s, turn rates, rad/s, climbs, m/s; beyond the robot's limits they
        are clipped. `after_scan` gets the rows of robots with a new scan, perhaps from several threads at a
        time.
        """
        threads = self._threads.count
        share = -(-len(ids) // (PARTS * threads if threads > 1 else 1))

        def scan(rows: IntArray) -> tuple[()]:
            self._scan(rows)
            if after_scan is not None:
                after_scan(rows)
            return ()

        def drive(group: RobotGroup) -> list[Work]:
            due = self._drive_group(group, ids, commands)
            return [partial(scan, due[k : k + share]) for k in range(0, len(due), share)]

        self._threads.run([partial(drive, group) for group in self.groups])

    def _drive_group(self, group: RobotGroup, ids: IntArray, commands: FloatArray) -> IntArray:
        """Drive the robots of a group that are among `ids`; return rows due for scans."""
        first = group.rows.start
        local = ids
        if len(self.groups) > 1:
            local = ids[(ids >= first) & (ids < group.rows.stop)] - first
        if not len(local):
            return local
        for k, error in group.advance(local, commands[first : group.rows.stop]).items():
            self.errors[first + k] = error
        if any(self.errors):
            local = np.array([k for k in local.tolist() if not self.errors[first + k]], np.int64)
        rows = local + first
        _read_poses(rows, first, group.bodies.qpos, self.T_world_base)
        self._ticks[rows] += 1
        self._slip(rows)
        if self._in_step:
            return rows
        scans, ticks = self.period * self.preset.rate, self._ticks[rows]
        # Robots whose lidar has begun a new scan in the period.
        due: IntArray = rows[np.floor(ticks * scans + 1e-9) > np.floor((ticks - 1) * scans + 1e-9)]
        return due

    def _slip(self, rows: IntArray) -> None:
        """Note the odometry with the slip of the faults."""
        for i in rows.tolist() if self._faults else ():
            group, k = self.places[i]
            odometry, (roll, pitch) = Pose2(*group.odometry[k].tolist()), group.imu.attitude[k].tolist()
            self._slipped[i] = self._faults[i].odometry(odometry, roll, pitch).as_array()

    def _scan(self, rows: IntArray) -> None:
        for i in rows.tolist() if self._copies_rays else ():
            data = self._ray_data[i]
            group, k = self.places[i]
            data.qpos[:], data.mocap_pos[:] = group.bodies.qpos[k], group.bodies.mocap_pos[k]
        lidars, self._stamps[rows] = self._lidars, self._ticks[rows] * self.period
        lidars.scan(rows, self.T_world_base, self.states, self._stamps)
        for i in rows.tolist() if self._faults else ():
            lidars.ranges[i], lidars.clouds[i] = self._faults[i].scan(lidars.ranges[i], lidars.clouds[i])

    @property
    def odometry(self) -> FloatArray:
        """(N, 3) `T_odom_base`: x, y, yaw, meters and radians."""
        return self._slipped if self._faults else np.concatenate([group.odometry for group in self.groups])

    @property
    def attitude(self) -> FloatArray:
        """(N, 2) measured roll and pitch, radians."""
        return np.concatenate([group.imu.attitude for group in self.groups])

    @property
    def touched(self) -> BoolArray:
        """(N,) whether the robot collided in the last period (see `RobotModel.contact_drops`)."""
        return np.concatenate([group.touched for group in self.groups])

    def pose(self, i: int = 0) -> Pose3:
        """Return the last valid `T_world_base` of robot `i`."""
        return Pose3(*self.T_world_base[i].tolist())

    def time(self, i: int = 0) -> float:
        """Return the seconds since robot `i` was reset."""
        return float(self._ticks[i] * self.period)

    def walkers(self, i: int = 0) -> FloatArray:
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

    def reading(self, i: int = 0) -> Observation:
        """Return the last sensor readings of robot `i` as arguments of a mapper."""
        group, k = self.places[i]
        now, faults, imu = self.time(i), self._faults.get(i), group.imu
        odometry = group.odometry[k] if faults is None else self._slipped[i]
        tracked = self.config.inertial and self._ticks[i] and not (faults and faults.faults.slip)
        (roll, pitch), rates, force = (a[k].tolist() for a in (imu.attitude, imu.rates, imu.force))
        return Observation(
            self._lidars.reading(i, float(self._stamps[i])),
            Pose2(*odometry.tolist()),
            Imu(roll, pitch, tuple(rates), tuple(force), now),
            self._lidars.clouds[i],
            group.inertial[k],
            group.track(k, now) if tracked else (),
        )

    def reset(self, start: Pose2 | None = None, *, seed: int | None = None) -> Observation:
        """Place the one robot at rest on the ground; restart time, records and odometry.

        Args:
            start: Start pose; None = the config's, or else the world's first.
            seed: Seed of the noise; None = the former one, which repeats the same run.

        Raises:
            ConfigError: the pose is not finite, or the seed no whole number from 0 up.
            SimulationError: the robot cannot stand there.
        """
        self.errors[0] = NOT_RESET
        start = resolve_start(self.worlds[0], self.config.start if start is None else start)
        seed = self._seed if seed is None else seed
        check_seed(seed)
        self.place(0, start, seed)
        self._seed, self.timing, self.mishap = seed, Timing(), ""
        self.single.clear()
        walkers = self.groups[0].walkers[0]
        self._initial = self.body.state(), None if walkers is None else walkers.copy()
        return self.reading()

    def advance(self, command: Twist | Waypoint) -> Observation:
        """Drive the one robot for one period; return the sensor readings at its end.

        Raises:
            ConfigError: the command is not finite.
            SimulationError: the simulation diverged, or was never reset.
        """
        if self.errors[0]:
            raise SimulationError(self.errors[0])
        _check_command(self.robot, command)
        begun, group = time.perf_counter(), self.groups[0]
        group.waypoints[0] = command if isinstance(command, Waypoint) else None
        twist = (command.v, command.omega, command.climb) if isinstance(command, Twist) else (0.0, 0.0, 0.0)
        self.drive(ROW, np.array((twist,), np.float64))
        if self.errors[0]:
            raise SimulationError(self.errors[0])
        self.mishap = "tipped" if self.find_tipped()[0] else "off world" if self.off_world()[0] else ""
        observation = self.reading()
        self.timing.physics.append(group.physics_seconds)
        self.timing.sensors.append(time.perf_counter() - begun - group.physics_seconds)
        return observation

    @property
    def imu_rate(self) -> float | None:
        """Inertial readings a second, Hz; None without `SimulationConfig.inertial`."""
        return self.groups[0].imu_rate

    @property
    def walker_beams(self) -> BoolArray | None:
        """(beams,) mask of the one robot's last beams that hit a walker; None without walkers."""
        caster = self.casters[0]
        return caster.met[self.preset.horizon_beams].copy() if isinstance(caster, WalkerCaster) else None

    @property
    def walker_points(self) -> BoolArray | None:
        """(n,) mask of the last cloud's points on a walker. None without walkers or cloud."""
        caster = self.casters[0]
        if not isinstance(caster, WalkerCaster) or self.preset.rings == 1:
            return None
        return caster.met[self._lidars.lidars[0].returned]

    @property
    def collisions(self) -> Collisions:
        """Contacts of the one robot since the reset."""
        return self.single.collisions

    @property
    def controls(self) -> FloatArray:
        """(n, 2) wheel speeds, left and right, rad/s, or (n, rotors) thrusts, newtons, of n updates."""
        return self.single.controls[:, [side[0] for side in self.body.actuators]]

    def replay(self, *, reference: bool = False, seconds: float = math.inf) -> PhysicsReplay:
        """Send the recorded controls through MuJoCo's step alone; the simulation stays as it is.

        Args:
            seconds: Simulated time of the replay from the reset on, rounded up to whole periods, if the drive
                was longer.
            reference: Whether to use the reference physics (see `RobotModel.replay`), in which the robot may
                take another path.

        Raises:
            SimulationError: nothing was driven since the reset, or the reference physics diverged.
        """
        if self.errors[0] or not self._ticks[0]:
            raise SimulationError("nothing was driven since the reset: there is nothing to replay")
        initial, walkers = self._initial
        walkers = None if walkers is None else walkers.copy()
        periods = math.ceil(min(self.time(), seconds) / self.period - 1e-9)
        controls = self.single.controls[: periods * len(self.body.substeps)]
        spent, pose = self.body.replay(initial, controls, walkers, reference=reference)
        return PhysicsReplay(spent, periods * self.period, pose)


def _check_command(robot: Robot, command: object) -> None:
    if isinstance(command, Waypoint) and not robot.flies:
        raise ConfigError(f"{robot.name} drives: it takes a Twist, got {command}")
    if not isinstance(command, Twist | Waypoint):
        raise ConfigError(f"a command must be a Twist or a Waypoint, got {command!r}")
    c = command
    numbers: list[object] = [c.v, c.omega, c.climb] if isinstance(c, Twist) else [c.x, c.y, c.z, c.yaw]
    if not all(isinstance(n, Real) and math.isfinite(n) for n in numbers):
        raise ConfigError(f"a command must be finite, got {command}")


@njit
def _read_poses(rows: IntArray, first: int, qpos: FloatArray, out: FloatArray) -> None:
    """Fill rows of (N, 7) with x, y, z, qw, qx, qy, qz; row `first` is row 0 of the positions (n, nq)."""
    for i in rows:
        q = qpos[i - first]
        w, x, y, z = q[3], q[4], q[5], q[6]
        norm = math.sqrt(w * w + x * x + y * y + z * z)
        out[i, 0], out[i, 1], out[i, 2] = q[0], q[1], q[2]
        out[i, 3], out[i, 4], out[i, 5], out[i, 6] = w / norm, x / norm, y / norm, z / norm


Work = Callable[[], Sequence[Any]]
"""A piece of work; it returns the pieces that depend on it."""


class WorkThreads:
    """Pool of `count` threads; a forked or copied process makes its own."""

    def __init__(self, count: int) -> None:
        self.count = count
        self._pool: ThreadPoolExecutor | None = None
        self._pid = getpid()

    def __reduce__(self) -> tuple[Any, ...]:
        return WorkThreads, (self.count,)

    def close(self) -> None:
        """End the threads; later work runs in the calling thread."""
        if self._pool is not None and self._pid == getpid():
            self._pool.shutdown()
        self._pool, self.count = None, 1

    def run(self, pieces: Sequence[Work]) -> None:
        """Do pieces of work, and the pieces that they return, until all are done.

        Several pieces may run at the same time.
        """
        if self.count == 1:
            for piece in pieces:
                self.run(piece())
            return
        if self._pool is None or self._pid != getpid():  # Threads do not survive a fork.
            self._pool, self._pid = ThreadPoolExecutor(self.count), getpid()
        pool = self._pool
        waiting: set[Future[Sequence[Any]]] = {pool.submit(piece) for piece in pieces}
        try:
            while waiting:
                done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                for future in done:
                    waiting |= {pool.submit(piece) for piece in future.result()}
        finally:
            wait(waiting)
