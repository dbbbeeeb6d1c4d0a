"""Motion sensors of a robot: gyro and odometry, read after every control update."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from lirs_envs.robot_model import RobotModel
from lirs_envs.sensing.imu import ImuSensor, next_rates
from lirs_envs.sensing.odometry import FlowOdometry, WheelOdometry, mean_angle, reckoned_pose
from lirs_wct.arrays import FloatArray, IntArray, Vector3
from lirs_wct.geometry.pose import Pose2, Pose3
from lirs_wct.kernels import njit

Readings = tuple[Vector3, float, float]
"""Rates about x, y, z of the base, rad/s, roll and pitch, radians, as measured."""


class MovingBody(Protocol):
    """True state that odometry measures."""

    def pose(self) -> Pose3:
        """Return `T_world_base`."""

    def velocity(self) -> Vector3:
        """Return the velocity along the body's axes, m/s."""

    def wheel_angles(self) -> tuple[float, float]:
        """Return the mean angles by which left and right wheels have turned, radians."""


class MotionSensors:
    """Gyro and odometry of any kind; both begin here.

    Attributes:
        odometry: odometry of the robot.

    Args:
        body: model of the moving robot.
        gyro: gyro of the inertial unit.
        odometry: odometry of the robot.
    """

    def __init__(self, body: RobotModel, gyro: ImuSensor, odometry: WheelOdometry | FlowOdometry) -> None:
        self._body, self._gyro, self.odometry = body, gyro, odometry
        self._wheel_angles = body.wheel_angles()
        self._rates = gyro.rates(body.rates())

    @property
    def yaw_rate(self) -> float:
        """The gyro's last reading about z, rad/s."""
        return self._rates[2]

    @property
    def rates(self) -> Vector3:
        """The gyro's last readings about x, y, z of the base, rad/s."""
        return self._rates

    def update(self, attitude: tuple[float, float], dt: float) -> None:
        """Read the gyro, and add the motion of the last `dt` seconds.

        Args:
            attitude: measured roll and pitch, radians.
            dt: seconds.
        """
        self._rates = self._gyro.rates(self._body.rates())
        readings = (self._rates, *attitude)
        self._wheel_angles = add_motion(self.odometry, self._body, readings, self._wheel_angles, dt)

    def read(self) -> Pose2:
        """Return `T_odom_base`."""
        return self.odometry.read()


class WheelAndGyroSensors(MotionSensors):
    """Gyro and wheel odometry with `WheelOdometry.update` in one kernel."""

    def __init__(self, body: RobotModel, gyro: ImuSensor, odometry: WheelOdometry) -> None:
        super().__init__(body, gyro, odometry)
        self._joints = np.array(body.left_angles), np.array(body.right_angles)
        self._draws = gyro.units.draw_rate_errors, odometry.noise.draw
        radius, noise = odometry.robot.wheel_radius, odometry.noise
        self._parameters = (radius, *noise.parameters)
        self._noise = gyro.units.rate_errors, gyro.units.rates_left, noise.scale, noise.normals, noise.used
        # x, y, yaw; mean angles of left and right wheels; rates: as plain numbers they would be packed and
        # unpacked at every call.
        self._motion = np.array((*odometry.pose.as_array(), *self._wheel_angles, *self._rates))
        self._used_up = True

    @property
    def yaw_rate(self) -> float:
        """The gyro's last reading about z, rad/s."""
        rate: float = self._motion.item(7)
        return rate

    @property
    def rates(self) -> Vector3:
        """The gyro's last readings about x, y, z of the base, rad/s."""
        x, y, z = self._motion[5:].tolist()
        return x, y, z

    def update(self, attitude: tuple[float, float], dt: float) -> None:
        """Read the gyro, and add the motion of the last `dt` seconds (see `MotionSensors`)."""
        if self._used_up:
            for draw in self._draws:
                draw()
        body = self._body
        state = body.qpos, body.qvel, *attitude
        self._used_up = _reckon(state, self._joints, self._noise, self._parameters, dt, self._motion)

    def read(self) -> Pose2:
        """Return `T_odom_base`."""
        x, y, yaw = self._motion[:3].tolist()
        self.odometry.pose = Pose2(x, y, yaw)
        return self.odometry.pose


def motion_sensors(
    body: RobotModel, gyro: ImuSensor, odometry: WheelOdometry | FlowOdometry
) -> MotionSensors:
    """Return the motion sensors of a robot with this odometry."""
    if type(odometry) is WheelOdometry:
        return WheelAndGyroSensors(body, gyro, odometry)
    return MotionSensors(body, gyro, odometry)


def add_motion(
    odometry: WheelOdometry | FlowOdometry,
    body: MovingBody,
    readings: Readings,
    wheel_angles: tuple[float, float],
    dt: float,
) -> tuple[float, float]:
    """Add the motion since the last update to odometry; return the wheel angles.

    Args:
        odometry: odometry of the robot.
        body: its true state.
        readings: rates, roll and pitch.
        wheel_angles: at the last update, left and right, radians.
        dt: seconds since then.
    """
    if isinstance(odometry, FlowOdometry):
        odometry.update(body.pose(), body.velocity(), *readings, dt)
        return wheel_angles
    left, right = body.wheel_angles()
    left_turned, right_turned = left - wheel_angles[0], right - wheel_angles[1]
    odometry.update((left_turned + right_turned) / 2, *readings, dt, right_turned - left_turned)
    return left, right


@njit(cache=True, nogil=True)
def _reckon(
    state: tuple[FloatArray, FloatArray, float, float],
    joints: tuple[IntArray, IntArray],
    noise: tuple[FloatArray, IntArray, FloatArray, FloatArray, IntArray],
    parameters: Vector3,
    dt: float,
    motion: FloatArray,
) -> bool:
    """Read gyro and wheels; return whether the errors of one of them are used up.

    Args:
        state: true positions (nq,) and velocities (nv,), measured roll and pitch, radians.
        joints: indices of the left and right wheel angles in the positions.
        noise: errors of the gyro (1, n, 3) and how many are left (1,) (see `next_rates`); of the distance
            its scale error (1,), normal numbers (1, n) and how many are used (1,) (see `measured_distance`).
        parameters: radius of the wheels, meters; of the distance's noise.
        dt: seconds since the last update.
        motion: (8,) x, y, yaw, mean angles of left and right wheels, rates; updated in place.
    """
    qpos, qvel, roll, pitch = state
    errors, left_over, scale, normals, used = noise
    radius, sigma, length = parameters
    rates = next_rates(errors[0], left_over, (qvel[3], qvel[4], qvel[5]))
    motion[5], motion[6], motion[7] = rates
    left, right = mean_angle(qpos, joints[0]), mean_angle(qpos, joints[1])
    turned = ((left - motion[3]) + (right - motion[4])) / 2
    motion[3], motion[4] = left, right
    motion[0], motion[1], motion[2] = reckoned_pose(
        (motion[0], motion[1], motion[2]),
        (scale, normals[0], used),
        (sigma, length),
        turned * radius,
        (rates, roll, pitch),
        dt,
    )
    return bool(left_over[0] == 0 or used[0] == normals.shape[1])
