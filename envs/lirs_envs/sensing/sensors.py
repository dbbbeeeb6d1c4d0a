"""Sensors of a robot: lidar, inertial unit and odometry, each with its own noise."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from lirs_envs.lidar.lidar import BaseVelocity, Lidar
from lirs_envs.lidar.noise import LidarNoise, NoiseLevel, lidar_noise
from lirs_envs.lidar.presets import LidarPreset
from lirs_envs.lidar.ray_casting import Caster
from lirs_envs.robot_model import RobotModel
from lirs_envs.robots.robot import Robot
from lirs_envs.sensing.ekf import EkfOdometry
from lirs_envs.sensing.imu import ImuConfig, ImuSensor
from lirs_envs.sensing.motion_sensors import motion_sensors
from lirs_envs.sensing.odometry import FlowOdometry, OdometryConfig, WheelOdometry
from lirs_wct.arrays import BoolArray
from lirs_wct.field_validators import require_type
from lirs_wct.geometry.cloud import PointCloud
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.scan import Imu, LaserScan

LIDAR_STREAM, ODOMETRY_STREAM, IMU_STREAM = 11, 12, 13
"""Random stream of each sensor: with one each, another lidar leaves the noise of the others as it was."""


@dataclass(frozen=True, slots=True)
class Observation:
    """Sensor readings at a scan's stamp.

    Attributes:
        scan: scan of the lidar; of one with rings, the ring nearest the horizon.
        odometry: `T_odom_base`.
        imu: reading of the inertial unit.
        cloud: cloud of a lidar with rings; None for a planar one.
    """

    scan: LaserScan
    odometry: Pose2
    imu: Imu
    cloud: PointCloud | None = None


@dataclass(frozen=True, kw_only=True)
class SensorNoise:
    """Errors of all sensors.

    Attributes:
        imu: noise of the inertial unit.
        odometry: noise of the wheels, and method.
        lidar: a noise level (`none`, `simulated`, `datasheet`), or noise of your own.
        rolling_scan: whether the beams of a scan are cast one after the other over its time.

    Raises:
        ConfigError: one is of the wrong type.
    """

    imu: ImuConfig = field(default_factory=ImuConfig)
    odometry: OdometryConfig = field(default_factory=OdometryConfig)
    lidar: LidarNoise | NoiseLevel = "simulated"
    rolling_scan: bool = False

    def __post_init__(self) -> None:
        require_type(self, ImuConfig, "imu", of="the sensor noise")
        require_type(self, OdometryConfig, "odometry", of="the sensor noise")
        require_type(self, LidarNoise | str, "lidar", of="the sensor noise")
        require_type(self, bool, "rolling_scan", of="the sensor noise")


class Sensors:
    """The sensors of a robot that stands still; odometry begins here."""

    def __init__(
        self,
        robot: Robot,
        body: RobotModel,
        preset: LidarPreset,
        caster: Caster,
        noise: SensorNoise,
        seed: int,
    ) -> None:
        lidar, odometry, imu = (
            np.random.default_rng((seed, stream)) for stream in (LIDAR_STREAM, ODOMETRY_STREAM, IMU_STREAM)
        )
        self._body = body
        ranges = noise.lidar if isinstance(noise.lidar, LidarNoise) else lidar_noise(preset, noise.lidar)
        self._lidar = Lidar(
            preset, caster, robot.T_base_laser, lidar, ranges, rolling_scan=noise.rolling_scan
        )
        self._imu = ImuSensor(noise.imu, imu)
        self._motion = motion_sensors(body, self._imu, make_odometry(robot, noise, odometry))
        pose = body.pose()
        self._attitude = (pose.roll, pose.pitch)

    @property
    def yaw_rate(self) -> float:
        """The gyro's last reading about z, rad/s."""
        return self._motion.yaw_rate

    @property
    def returned(self) -> BoolArray:
        """(rings * beams,) which beams have a point in the last cloud."""
        return self._lidar.returned

    def integrate_odometry(self, dt: float) -> None:
        """Read gyro and wheels, or gyro and optical flow, after `dt` seconds."""
        self._motion.update(self._attitude, dt)

    def observe(self, stamp: float, dt: float) -> Observation:
        """Read all sensors; `dt` is the time since the last observation, seconds."""
        body = self._body
        T_world_base = body.pose()
        imu = self._imu.read(T_world_base, self._motion.rates, body.specific_force(), stamp, dt)
        self._attitude = (imu.roll, imu.pitch)
        velocity = BaseVelocity(body.velocity(), body.rates()) if self._lidar.time_increment else None
        if self._lidar.preset.rings == 1:
            return Observation(self._lidar.scan(T_world_base, stamp, velocity), self._motion.read(), imu)
        scan, cloud = self._lidar.sweep(T_world_base, stamp, velocity)
        return Observation(scan, self._motion.read(), imu, cloud)


def make_odometry(robot: Robot, noise: SensorNoise, rng: np.random.Generator) -> WheelOdometry | FlowOdometry:
    """Return the odometry of a robot."""
    if robot.flies:
        return FlowOdometry(noise.odometry, rng)
    if noise.odometry.method == "ekf":
        return EkfOdometry(robot, noise.odometry, rng, noise.imu)
    return WheelOdometry(robot, noise.odometry, rng)
