"""Odometry of single robots: optical flow and gyro, or a Kalman filter over wheels and gyro.

The state of the filter is (x, y, yaw, bias of the gyro, scale error of the wheels). Between two readings the
measured short increments are summed. The filter takes the sum as one motion (its control), corrected by its
estimates of bias and scale. This is table 7.2 of Thrun, Burgard and Fox, "Probabilistic Robotics", 2005, with
the two errors as further states. Wheels that measure the turn also make the bias observable.

A skid-steered robot that turns on a slope slides down it. Dry friction opposes the direction of the slip.
Wheels that already slip at speed s therefore react to a small side load like a damper, with mu m g / (2 s) on
average over the directions of the slip. The pull m g sin(slope) balances it at 2 s sin(slope) / mu.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lirs_envs.robots.control import BodyState
from lirs_envs.robots.robot import Robot
from lirs_envs.sensing.imu import ImuConfig
from lirs_envs.sensing.wheel_odometry import (
    DistanceNoises,
    OdometryConfig,
    integrated_pose,
    measured_distance,
    yaw_rate,
)
from lirs_wct import ConfigError, Pose2, Pose3
from lirs_wct.arrays import FloatArray, IntArray, Vector3
from lirs_wct.errors import Checked, limited


class DistanceNoise(DistanceNoises):
    """The scale error of one robot's distances."""

    def __init__(self, config: OdometryConfig, rng: np.random.Generator) -> None:
        super().__init__(config, 1)
        self.begin(0, rng)

    def measure(self, distance: float) -> float:
        """Return the measured distance, meters."""
        if self.used[0] == self.normals.shape[1]:
            self.draw(np.zeros(1, np.int64), 1)
        turned = distance * (1.0 + float(self.slip[0]))
        meters: float = measured_distance(self.scale, self.normals[0], self.used, turned, self.parameters)
        return meters


class Odometry:
    """Odometry `T_odom_base` of one robot; its frame is the base's pose at creation."""

    def __init__(self, config: OdometryConfig, rng: np.random.Generator) -> None:
        self.config = config
        self.pose = Pose2()
        self.noise = DistanceNoise(config, rng)

    def read(self) -> Pose2:
        """Return `T_odom_base` after all updates."""
        return self.pose


class FlowOdometry(Odometry):
    """Odometry of a flying robot: velocity by a downward camera, heading by gyro.

    The velocity has the scale error of the config, as an optical flow has by its height.
    """

    def update(
        self, T_world_base: Pose3, velocity: Vector3, rates: Vector3, roll: float, pitch: float, dt: float
    ) -> None:
        """Add the motion since the last update by the true velocity along the base's axes, m/s.

        Rates, rad/s, roll and pitch, radians, are measured.
        """
        east, north, _ = (T_world_base.rotation @ np.array(velocity) * dt).tolist()
        c, s = math.cos(T_world_base.yaw), math.sin(T_world_base.yaw)
        distance = math.hypot(east, north)
        scale = self.noise.measure(distance) / distance if distance > 0 else 1.0
        turn = yaw_rate(rates, roll, pitch) * dt
        # Axes of the true yaw: the camera's picture turns with the body.
        moved = Pose2((c * east + s * north) * scale, (c * north - s * east) * scale, turn)
        self.pose = self.pose @ moved


X, Y, YAW, BIAS, SCALE = range(5)
BIAS_ROW = np.eye(5)[BIAS : BIAS + 1]


@dataclass(frozen=True, kw_only=True)
class EkfConfig(Checked, of="the odometry filter"):
    """Process noise beyond the sensors' own noise; standard deviations.

    Attributes:
        slip_forward: along the path after one meter of it, meters; grows with the root of the distance.
        slip_lateral: across the path after one meter of it, meters.
        slip_turning: across and along after one radian of turn, meters: the point that a robot turns about
            is never quite base_link.
        slide: gain of the slide down a slope, by the formula above. On the spot it is up to twice as large,
            in wide bends nearly nothing.
        drift: random part of the slide while skidding, after one meter of slide, meters.
        tilt: error of the turn after one radian of it, from an attitude that is not quite right, radians.
        wheel_rate: error of the wheels' turn rate on one driven axle, rad/s.
        wheel_rate_relative: the part that grows with the rate, rad/s each rad/s.
        gate: largest normalized innovation that is accepted, in deviations: wheels may spin or be dragged.
        rest: turn rate of the wheels below which the robot stands, rad/s.
    """

    slip_forward: float = limited(0.01, "[0, inf)")
    slip_lateral: float = limited(0.01, "[0, inf)")
    slip_turning: float = limited(0.02, "[0, inf)")
    slide: float = limited(2.0, "[0, inf)")
    drift: float = limited(0.35, "[0, inf)")
    tilt: float = limited(0.003, "[0, inf)")
    wheel_rate: float = limited(0.05, "[0, inf)")
    wheel_rate_relative: float = limited(0.05, "[0, inf)")
    gate: float = limited(3.0, "[0, inf)")
    rest: float = limited(1e-3, "[0, inf)")


class EkfOdometry(Odometry):
    """Odometry whose pose comes from the filter.

    Args:
        robot: robot with the wheels.
        rng: random generator of the noise; the filter itself draws nothing.
        imu: noise of the gyro.
        filter_config: errors that the filter expects beyond those.
    """

    def __init__(
        self,
        robot: Robot,
        config: OdometryConfig,
        rng: np.random.Generator,
        imu: ImuConfig,
        filter_config: EkfConfig | None = None,
    ) -> None:
        # Its package needs all of SciPy's statistics, 20 MB, and other odometry does not.
        from filterpy.kalman import ExtendedKalmanFilter

        super().__init__(config, rng)
        if robot.flies:
            raise ConfigError(f"wheel odometry needs a robot with wheels, got {robot.name!r}")
        self.robot = robot
        self.filter_config = filter_config or EkfConfig()
        self._imu = imu
        # Slip of a wheel a radian of turn: along the wheel by the skid factor's surplus, across by the base.
        along = robot.track * (robot.skid_factor - 1) / 2
        self._slip_radius = math.hypot(along, robot.wheelbase / 2)
        self._filter = ExtendedKalmanFilter(dim_x=5, dim_z=1)
        self._filter.x = np.zeros(5)
        self._filter.P = np.diag((0.0, 0.0, 0.0, imu.rate_bias**2, config.scale_sigma**2))
        self._clear()

    @property
    def state(self) -> FloatArray:
        """(5,) x, y, yaw, bias of the gyro in rad/s, scale error of the wheels."""
        return np.array(self._filter.x)

    @property
    def covariance(self) -> FloatArray:
        """(5, 5) of the state."""
        return np.array(self._filter.P)

    def read(self) -> Pose2:
        """Filter the increments since the last reading; return `T_odom_base`."""
        if self._time > 0.0:
            self._predict()
            self._measure_bias()
            self._clear()
            x, y, yaw = self._filter.x[:3].tolist()
            self.pose = Pose2(x, y, math.remainder(yaw, math.tau))
        return self.pose

    def _clear(self) -> None:
        self._moved = Pose2()
        self._drifted = 0.0
        self._time = self._distance = self._turned = self._wheels_turned = self._wheel_distance = 0.0
        self._readings = 0

    def update(
        self, turned: float, rates: Vector3, roll: float, pitch: float, dt: float, difference: float = 0.0
    ) -> None:
        """Add the motion since the last update.

        Args:
            turned: Mean angle by which the wheels have turned, radians.
            rates: Measured rates about x, y, z of the base, rad/s.
            roll: Measured roll, radians.
            pitch: Measured pitch, radians.
            dt: Seconds since the last update.
            difference: Angle by which the right wheels have turned more than the left ones, radians.
        """
        robot = self.robot
        distance = self.noise.measure(turned * robot.wheel_radius)
        wheel_turn = difference * robot.wheel_radius / (robot.track * robot.skid_factor)
        turn, moved = yaw_rate(rates, roll, pitch) * dt, self._moved
        forward = distance * math.cos(pitch)
        self._moved = Pose2(*integrated_pose((moved.x, moved.y, moved.yaw), forward, turn))
        if self._slip_radius and turn:
            slide = self.filter_config.slide * self._slip_radius * abs(turn) / robot.friction
            ahead, left = slide * math.sin(pitch), -slide * math.sin(roll)
            self._moved = self._moved @ Pose2(ahead, left)
            self._drifted += math.hypot(ahead, left)
        self._time += dt
        self._distance += abs(distance)
        self._turned += turn
        self._wheels_turned += wheel_turn
        self._wheel_distance += abs(distance) + abs(wheel_turn) * robot.radius
        self._readings += 1

    def _predict(self) -> None:
        """Move by the summed motion, less the estimated errors by bias and scale.

        With (a, b) the summed motion in the frame of its start, the bias turns it by half of the turn of
        the end: an even rate is assumed.
        """
        f, a, b = self._filter, self._moved.x, self._moved.y
        bias, scale = float(f.x[BIAS]), float(f.x[SCALE])
        half = -bias * self._time / 2
        yaw = float(f.x[YAW]) + half
        c, s = math.cos(yaw), math.sin(yaw)
        east, north = c * a - s * b, s * a + c * b
        keep = math.exp(-self._distance / self.config.scale_length)
        F = np.eye(5)
        F[X, YAW], F[Y, YAW] = -north * (1 - scale), east * (1 - scale)
        F[X, BIAS], F[Y, BIAS] = north * self._time / 2, -east * self._time / 2
        F[X, SCALE], F[Y, SCALE] = -east, -north
        F[YAW, BIAS], F[SCALE, SCALE] = -self._time, keep
        f.x = np.array(
            (
                f.x[X] + east * (1 - scale),
                f.x[Y] + north * (1 - scale),
                f.x[YAW] + self._turned - bias * self._time,
                bias,
                keep * scale,
            )
        )
        f.P = F @ f.P @ F.T + self._process_noise(c, s, 1 - keep * keep)

    def _process_noise(self, c: float, s: float, renewed: float) -> FloatArray:
        e, turned = self.filter_config, self._turned
        pivot = e.slip_turning**2 * abs(turned) + e.drift**2 * self._drifted
        ahead, aside = e.slip_forward**2 * self._distance + pivot, e.slip_lateral**2 * self._distance + pivot
        white = self._imu.rate_sigma**2 * self._time**2 / max(self._readings, 1)
        Q = np.zeros((5, 5))
        Q[X, X], Q[Y, Y] = c * c * ahead + s * s * aside, s * s * ahead + c * c * aside
        Q[X, Y] = Q[Y, X] = c * s * (ahead - aside)
        Q[YAW, YAW] = white + e.tilt**2 * turned**2
        Q[SCALE, SCALE] = renewed * self.config.scale_sigma**2
        return Q

    def _measure_bias(self) -> None:
        """Compare the gyro with the wheels.

        The comparison is exact at rest, useful on one axle and useless where wheels skid.
        """
        e, rate = self.filter_config, self._wheels_turned / self._time
        sigma = self._imu.rate_sigma / math.sqrt(self._readings)
        if self._wheel_distance / self._time >= e.rest * self.robot.wheel_radius:
            if self.robot.wheelbase > 0:
                return
            sigma = math.hypot(sigma, e.wheel_rate + e.wheel_rate_relative * abs(rate))
        measured = np.array((self._turned / self._time - rate,))
        variance = max(sigma, 1e-9) ** 2
        f = self._filter
        if abs(measured[0] - f.x[BIAS]) > e.gate * math.sqrt(f.P[BIAS, BIAS] + variance):
            return
        R = np.array(((variance,),))
        f.update(measured, lambda x: BIAS_ROW, lambda x: x[BIAS : BIAS + 1], R)


class Odometries:
    """Odometry `T_odom_base` of N robots with one object each: optical flow, or the Kalman filter.

    Attributes:
        pose: (N, 3) x, y, yaw, meters and radians.
        of: Odometry of each robot that has begun.
    """

    def __init__(
        self, robot: Robot, config: OdometryConfig, imu: ImuConfig, bodies: Sequence[BodyState]
    ) -> None:
        self._robot, self._config, self._imu, self._bodies = robot, config, imu, bodies
        self.of: dict[int, EkfOdometry | FlowOdometry] = {}
        self._angles = [(0.0, 0.0)] * len(bodies)
        self.pose = np.zeros((len(bodies), 3))

    def begin(self, i: int, qpos: FloatArray, rng: np.random.Generator) -> None:
        """Begin the odometry of robot `i` where it stands."""
        if self._robot.flies:
            self.of[i] = FlowOdometry(self._config, rng)
        else:
            self.of[i] = EkfOdometry(self._robot, self._config, rng, self._imu)
        self._angles[i] = self._bodies[i].wheel_angles()
        self.pose[i] = 0.0

    def integrate(
        self, ids: IntArray, qpos: FloatArray, rates: FloatArray, attitude: FloatArray, dt: float
    ) -> None:
        """Add the motion of the last `dt` seconds. `rates` (N, 3) and `attitude` (N, 2) are measured."""
        for i in ids.tolist():
            odometry, body = self.of[i], self._bodies[i]
            x, y, z = rates[i].tolist()
            roll, pitch = attitude[i].tolist()
            readings = ((x, y, z), roll, pitch, dt)
            if isinstance(odometry, FlowOdometry):
                odometry.update(body.pose(), body.velocity(), *readings)
            else:
                left, right = body.wheel_angles()
                left_turned, right_turned = left - self._angles[i][0], right - self._angles[i][1]
                self._angles[i] = left, right
                odometry.update((left_turned + right_turned) / 2, *readings, right_turned - left_turned)

    def set_slip(self, i: int, share: float) -> None:
        """Lengthen the measured distance by a share, until robot `i` begins again."""
        self.of[i].noise.slip[0] = share

    def read(self, ids: IntArray) -> None:
        """Update the poses of robots `ids`."""
        for i in ids.tolist():
            self.pose[i] = self.of[i].read().as_array()
