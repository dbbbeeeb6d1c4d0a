"""All that a robot perceives: laser range finder, inertial unit and odometry, each with noise of its own."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from lirs_envs.lidar.lidar import Lidar, Motion
from lirs_envs.lidar.noise import LidarNoise, NoiseLevel, lidar_noise
from lirs_envs.lidar.presets import LidarPreset
from lirs_envs.lidar.ray_casting import Caster
from lirs_envs.model import RobotModel
from lirs_envs.robots.robot import Robot
from lirs_envs.sensing.ekf import EkfOdometry
from lirs_envs.sensing.imu import ImuConfig, ImuSensor
from lirs_envs.sensing.odometry import FlowOdometry, Odometry, OdometryConfig
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.scan import Imu, LaserScan

LIDAR_STREAM, ODOMETRY_STREAM, IMU_STREAM = 11, 12, 13
"""Each sensor draws from a stream of its own, so that another preset leaves the others' noise as it was."""


@dataclass(frozen=True, slots=True)
class Observation:
    """What the robot knows at a scan's stamp: the scan, `T_odom_base`, and the inertial reading."""

    scan: LaserScan
    odometry: Pose2
    imu: Imu


@dataclass(frozen=True, kw_only=True)
class SensorNoise:
    """Noise of all sensors.

    Attributes:
        imu: of the inertial unit.
        odometry: of the wheels.
        lidar: of the LRF: a level (`none`, `simulated`, `datasheet`) or figures of your own.
        sweep: whether the beams of a scan are spread over its time.

    Raises:
        ConfigError: one is of the wrong type.
    """

    imu: ImuConfig = field(default_factory=ImuConfig)
    odometry: OdometryConfig = field(default_factory=OdometryConfig)
    lidar: LidarNoise | NoiseLevel = "simulated"
    sweep: bool = False

    def __post_init__(self) -> None:
        kinds = {"imu": ImuConfig, "odometry": OdometryConfig, "lidar": LidarNoise | str, "sweep": bool}
        for name, kind in kinds.items():
            value = getattr(self, name)
            if not isinstance(value, kind):
                words = getattr(kind, "__name__", "LidarNoise or the name of a level")
                raise ConfigError(f"noise: {name} must be a {words}, got {value!r}")


class Sensors:
    """The sensors of a robot that stands still; odometry begins here.

    Raises:
        ConfigError: the seed is negative.
    """

    def __init__(
        self,
        robot: Robot,
        body: RobotModel,
        preset: LidarPreset,
        casters: tuple[Caster, Caster | None],
        noise: SensorNoise,
        seed: int,
    ) -> None:
        if seed < 0:
            raise ConfigError(f"seed must be 0 or above, got {seed}")
        lidar, odometry, imu = (
            np.random.default_rng((seed, stream)) for stream in (LIDAR_STREAM, ODOMETRY_STREAM, IMU_STREAM)
        )
        self._body = body
        ranges = noise.lidar if isinstance(noise.lidar, LidarNoise) else lidar_noise(preset, noise.lidar)
        ground, others = casters
        self._others = None if others is None else others.ranges
        self._lidar = Lidar(preset, ground, robot.T_base_laser, lidar, ranges, sweep=noise.sweep)
        self._imu = ImuSensor(noise.imu, imu)
        self._flow = FlowOdometry(robot, noise.odometry, odometry) if robot.flies else None
        self._odometry: Odometry = self._flow or (
            EkfOdometry(robot, noise.odometry, odometry, noise.imu)
            if noise.odometry.method == "ekf"
            else Odometry(robot, noise.odometry, odometry)
        )
        self._wheel_angles = body.wheel_angles()
        self._rates = self._imu.rates(body.rates())
        pose = body.pose()
        self._attitude = (pose.roll, pose.pitch)

    @property
    def yaw_rate(self) -> float:
        """The gyro's last reading about z, rad/s."""
        return self._rates[2]

    def dead_reckon(self, dt: float) -> None:
        """Read gyro and wheels after a piece of way."""
        self._rates = self._imu.rates(self._body.rates())
        if self._flow is not None:
            self._flow.flow(self._body.pose(), self._body.velocity(), self._rates, *self._attitude, dt)
            return
        left, right = self._body.wheel_angles()
        left_turned, right_turned = left - self._wheel_angles[0], right - self._wheel_angles[1]
        turned, difference = (left_turned + right_turned) / 2, right_turned - left_turned
        self._odometry.update(turned, self._rates, *self._attitude, dt, difference)
        self._wheel_angles = left, right

    def observe(self, stamp: float, dt: float) -> Observation:
        """Scan and read; `dt` is the time since the last observation, seconds."""
        T_world_base = self._body.pose()
        imu = self._imu.read(T_world_base, self._rates, self._body.specific_force(), stamp, dt)
        self._attitude = (imu.roll, imu.pitch)
        body = self._body
        motion = Motion(body.velocity(), body.rates()) if self._lidar.time_increment else None
        scan = self._lidar.scan(T_world_base, stamp, self._others, motion)
        return Observation(scan, self._odometry.read(), imu)
