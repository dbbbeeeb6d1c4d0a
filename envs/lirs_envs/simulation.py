"""One robot in one world, stepped from lidar scan to lidar scan, without Gymnasium."""

from __future__ import annotations

import math
import time
from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from lirs_envs.batch.bodies import SingleBody
from lirs_envs.batch.robot_group import RobotGroup
from lirs_envs.collisions import Collisions
from lirs_envs.lidar.lidar import BaseVelocity, Lidar
from lirs_envs.lidar.ray_casting import Caster, WalkerCaster, make_caster
from lirs_envs.placement import check_fit, resolve_start
from lirs_envs.robot_model import RobotModel
from lirs_envs.robots.robot import Twist, Waypoint, check_command
from lirs_envs.sensing.inertial import InertialUnit
from lirs_envs.sensing.sensors import INERTIAL_STREAM, LIDAR_STREAM, FaultInjector, Observation, sensor_stream
from lirs_envs.simulation_config import SimulationConfig
from lirs_envs.walkers import Walkers
from lirs_wct import ConfigError, HeightField, Pose2, Pose3, SimulationError, World
from lirs_wct.arrays import BoolArray, Float32Array, FloatArray
from lirs_wct.checks import check_seed
from lirs_wct.contact.grid import ContactGrid
from lirs_wct.ground import Terrain

ROW = np.zeros(1, np.int64)
"""The row of a single robot."""


TRACK_RATE = 50.0
"""Aimed rate of the odometry between scans, Hz."""


@dataclass
class Timing:
    """Wall-clock seconds of each `advance`: in MuJoCo's step, and in all sensors."""

    physics: array[float] = field(default_factory=lambda: array("d"))
    sensors: array[float] = field(default_factory=lambda: array("d"))


@dataclass(frozen=True)
class PhysicsReplay:
    """The recorded controls through MuJoCo's step alone.

    Attributes:
        seconds: wall-clock time.
        simulated: simulated time, seconds.
        T_world_base: last pose.
    """

    seconds: float
    simulated: float
    T_world_base: Pose3

    @property
    def rtf(self) -> float:
        """Simulated seconds over wall-clock seconds."""
        return self.simulated / self.seconds


class Simulation:
    """A robot with its sensors in a world; `reset` comes first.

    Attributes:
        config: robot, sensors and props.
        preset: specification of the lidar.
        period: time between two scans, seconds; one `advance`.
        body: MuJoCo's model of robot and world.
        caster: ray caster of the lidar against world and props; usable by custom sensors. A new terrain has
            a new caster.
        timing: wall-clock seconds since the reset.

    Args:
        seed: seed of all random numbers; same seed and same commands, same bytes.

    Raises:
        ConfigError: the seed is no whole number from 0 up, or robot, props or contact geometry do not fit the
            world.
    """

    def __init__(self, world: World, config: SimulationConfig, *, seed: int = 0) -> None:
        check_fit(world, config.robot)
        check_seed(seed)
        self.world = world
        self.config = config
        self.robot = config.robot
        self.preset = config.preset
        self.period = self.preset.period
        self.body = RobotModel(world, config, self.period)
        self._bodies = SingleBody(config.robot, self.body, record_motion=config.inertial is not None)
        self._inertial = None
        if config.inertial is not None:
            self._inertial = InertialUnit(config.inertial, self.body.timestep, self.body.gravity)
        self._row = RobotGroup(config, range(1), self._bodies, world)
        self._commands = np.zeros((1, 3))
        self.caster = self._make_caster()
        self._seed = seed
        self._begin()

    def _make_caster(self) -> Caster:
        config, data = self.config, self.body.data
        return make_caster(self.world, config.rays, bool(config.props), data, self.walkers)

    @property
    def walkers(self) -> Walkers | None:
        """Moving obstacles; None = there are none."""
        return self._row.walkers[0]

    def _begin(self) -> None:
        """Restart records, noise and odometry at the robot's present pose."""
        config, preset = self.config, self.preset
        lidar = sensor_stream(self._seed, LIDAR_STREAM)
        noise = config.noise.of_lidar(preset)
        rolling_scan = config.noise.rolls(preset)
        mount = self.robot.T_base_laser
        self._faults = None
        if config.noise.faults.any:
            self._faults = FaultInjector(config.noise.faults, self.period, preset.rings, self._seed)
        self._lidar = Lidar(preset, self.caster, mount, lidar, noise, rolling_scan=rolling_scan)
        self._row.begin(0, self._seed, self.period)
        filtered = self.robot.flies or config.noise.odometry.method == "ekf"
        self._row.track = None if config.inertial is None or filtered else []
        self._bodies.clear()
        if self._inertial is not None:
            self._inertial.begin(self._bodies.motion(), sensor_stream(self._seed, INERTIAL_STREAM))
        self._initial_state: FloatArray | None = None
        self._initial_walkers = None if self.walkers is None else self.walkers.state()
        self.timing = Timing()

    def reset(self, start: Pose2 | None = None, *, seed: int | None = None) -> Observation:
        """Place the robot at rest on the ground; restart time, records and odometry.

        Args:
            start: start pose; None = the config's, or else the world's first.
            seed: seed of the noise; None = the former one, which repeats the same run.

        Raises:
            ConfigError: the pose is not finite, or the seed no whole number from 0 up.
            SimulationError: the robot cannot stand there.
        """
        self._initial_state = None
        start = resolve_start(self.world, self.config.start if start is None else start)
        seed = self._seed if seed is None else seed
        check_seed(seed)
        self._row.place(0, self.world, start, seed)
        self._seed = seed
        self._begin()
        self._initial_state = self.body.state()
        return self._observe()

    def replace_terrain(self, heights: Float32Array, spawn_poses: Sequence[Pose2] = ()) -> None:
        """Replace the ground of the world; call `reset` next.

        Contact ground, lidar surface and possible start poses change together. A new simulation of the same
        ground gives the same results, bit for bit.

        Args:
            heights: (rows, cols) float32 meters, row 0 = north; as many nodes as the world has.
            spawn_poses: start poses on the new ground.

        Raises:
            ConfigError: the config has no height range, or the heights do not fit it or the world.
        """
        if self.config.height_range is None:
            raise ConfigError("a terrain can be replaced where the simulation's config has a height_range")
        former = self.world.surface
        surface = HeightField(heights.copy(), former.cell, former.origin)
        self.body.replace_surface(surface)
        self.world = replace(self.world, ground=Terrain(surface), spawn_poses=tuple(spawn_poses))
        self._row.replace_world(0, self.world)
        self.caster = self._make_caster()
        self._initial_state = None

    def advance(self, command: Twist | Waypoint) -> Observation:
        """Drive for one lidar period; return the sensor readings at its end.

        Raises:
            ConfigError: the command is not finite.
            SimulationError: the simulation diverged, or was never reset.
        """
        if self._initial_state is None:
            raise SimulationError("a simulation must be reset before it is advanced")
        check_command(self.robot, command)
        row = self._row
        row.waypoints[0] = command if isinstance(command, Waypoint) else None
        self._commands[0] = (command.v, command.omega, command.climb) if isinstance(command, Twist) else 0.0
        failed = row.advance(ROW, self._commands)
        if failed:
            raise SimulationError(failed[0])
        begun = time.perf_counter()
        row.read(ROW, self.period)
        observation = self._observe()
        self.timing.physics.append(row.physics_seconds)
        self.timing.sensors.append(row.sensor_seconds + time.perf_counter() - begun)
        return observation

    def _observe(self) -> Observation:
        body, lidar, stamp = self.body, self._lidar, self.time
        velocity = BaseVelocity(body.velocity(), body.rates()) if lidar.time_increment else None
        odometry, imu = self._row.reading(0, stamp)
        inertial = None if self._inertial is None else self._inertial.read(self._bodies.take_motion())
        track = self._odometry_track(stamp)
        if self.preset.rings == 1:
            scan, cloud = lidar.scan(self.T_world_base, stamp, velocity), None
        else:
            scan, cloud = lidar.sweep(self.T_world_base, stamp, velocity)
        if self._faults is not None:
            scan, cloud = self._faults.scan(scan, cloud)
            odometry = self._faults.odometry(odometry, imu)
            track = () if self._faults.faults.slip else track
        return Observation(scan, odometry, imu, cloud, inertial, track)

    def _odometry_track(self, stamp: float) -> tuple[tuple[float, Pose2], ...]:
        """Return and forget stamps and `T_odom_base` near TRACK_RATE since the last scan, without its own."""
        if not self._row.track:
            return ()
        poses, self._row.track = self._row.track, []
        ends = stamp - self.period + self.body.timestep * np.cumsum(self.body.substeps)
        every = max(1, round(len(poses) / (TRACK_RATE * self.period)))
        chosen = range(len(poses) - 1 - every, -1, -every)
        return tuple((float(ends[k]), Pose2(*poses[k])) for k in reversed(chosen))

    @property
    def T_world_base(self) -> Pose3:  # noqa: N802  a frame pair
        """True pose of base_link."""
        return self.body.pose()

    @property
    def time(self) -> float:
        """Seconds since the reset."""
        return len(self._bodies.contacts.penetrations) // len(self.body.substeps) * self.period

    @property
    def imu_rate(self) -> float | None:
        """Inertial readings a second, Hz; None without `SimulationConfig.inertial`."""
        return None if self._inertial is None else self._inertial.rate

    @property
    def tipped(self) -> bool:
        """Whether the robot tilts by more than 60 deg or lies on its back."""
        return self.body.tipped

    @property
    def off_world(self) -> bool:
        """Whether base_link is beyond the world's border."""
        (x, y), (west, south, east, north) = self.body.qpos[:2].tolist(), self.world.surface.bounds
        return not (west <= x <= east and south <= y <= north)

    @property
    def walker_beams(self) -> BoolArray | None:
        """(beams,) mask of the last scan's beams that hit a walker; None without walkers."""
        met = self.caster.met if isinstance(self.caster, WalkerCaster) else None
        return None if met is None else met[self.preset.horizon_beams].copy()

    @property
    def walker_points(self) -> BoolArray | None:
        """(n,) mask of the last cloud's points on a walker. None without walkers or cloud."""
        if not isinstance(self.caster, WalkerCaster) or self.preset.rings == 1:
            return None
        return self.caster.met[self._lidar.returned]

    @property
    def contact(self) -> ContactGrid:
        """Contact grid of the wheels, with its deviation from the lidar's surface."""
        return self.body.contact

    @property
    def collisions(self) -> Collisions:
        """Contacts since the reset."""
        return self._bodies.contacts.statistics()

    @property
    def controls(self) -> FloatArray:
        """(n, 2) wheel speeds, left and right, rad/s, or (n, rotors) thrusts, newtons.

        There is one row per control update.
        """
        return self._bodies.controls[:, [side[0] for side in self.body.actuators]]

    def replay(self, *, reference: bool = False, seconds: float = math.inf) -> PhysicsReplay:
        """Send the recorded controls through MuJoCo's step alone; the simulation stays as it is.

        Args:
            seconds: simulated time of the replay from the reset on, rounded up to whole periods, if the drive
                was longer.
            reference: whether to use the reference physics (see `RobotModel.replay`), in which the robot may
                take another path.

        Raises:
            SimulationError: nothing was driven since the reset, or the reference physics diverged.
        """
        if self._initial_state is None or not self._bodies.contacts.penetrations:
            raise SimulationError("nothing was driven since the reset: there is nothing to replay")
        walkers = self.walkers
        present = None if walkers is None else walkers.state()
        if walkers is not None and self._initial_walkers is not None:
            walkers.restore(self._initial_walkers)
        try:
            periods = math.ceil(min(self.time, seconds) / self.period - 1e-9)
            controls = self._bodies.controls[: periods * len(self.body.substeps)]
            spent, pose = self.body.replay(self._initial_state, controls, walkers, reference=reference)
        finally:
            if walkers is not None and present is not None:
                walkers.restore(present)
        return PhysicsReplay(spent, periods * self.period, pose)
