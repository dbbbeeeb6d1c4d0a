"""Odometry by an extended Kalman filter: wheels and gyro, and what is wrong with both.

The state is (x, y, yaw, bias of the gyro, scale error of the wheels). Between two readings the short pieces
of way are summed as the sensors tell them; the filter then takes the sum as one motion (its control),
corrected by what it believes about bias and scale (Thrun, Burgard and Fox, "Probabilistic Robotics", 2005,
table 7.2, with the two errors as further states). Where the wheels tell the turn, the bias is measured.

A skid-steered robot that turns on a slope slides down it: dry friction opposes the direction of the slip, so
that wheels which slip at speed s already carry a small load sideways like a damper, mu m g / (2 s) on average
over the directions of the slip. The pull m g sin(slope) is in balance with it at 2 s sin(slope) / mu.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from lirs_envs.robots.robot import Robot
from lirs_envs.sensing.imu import ImuConfig
from lirs_envs.sensing.odometry import Odometry, OdometryConfig, Way, integrated
from lirs_wct.arrays import FloatArray
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.pose import Pose2

X, Y, YAW, BIAS, SCALE = range(5)
BIAS_ROW = np.eye(5)[BIAS : BIAS + 1]


@dataclass(frozen=True, kw_only=True)
class EkfConfig:
    """What the filter expects beyond the sensors' own noise; standard deviations.

    Attributes:
        slip_ahead: after one metre, along the way, metres; grows with the root of the way.
        slip_aside: after one metre, across it.
        slip_turning: across and along, after one radian of turn, metres: the point that a robot turns about
            is never quite base_link.
        slide: gain of the slide down a slope, by the formula above. On the spot it is up to twice as large,
            in wide bends nearly nothing.
        drift: of the slide down a slope while skidding, after one metre of it, metres.
        tilt: error of the turn after one radian of it, from an attitude that is not quite right, radians.
        wheel_rate: of the wheels' turn rate on one driven axle, rad/s.
        wheel_rate_relative: the part that grows with the rate, rad/s each rad/s.
        gate: innovations beyond so many deviations are not believed: wheels that spin or are dragged.
        rest: turn of the wheels below which the robot stands, radians a second.

    Raises:
        ConfigError: a figure is negative or not finite.
    """

    slip_ahead: float = 0.01
    slip_aside: float = 0.01
    slip_turning: float = 0.02
    slide: float = 2.0
    drift: float = 0.35
    tilt: float = 0.003
    wheel_rate: float = 0.05
    wheel_rate_relative: float = 0.05
    gate: float = 3.0
    rest: float = 1e-3

    def __post_init__(self) -> None:
        for item in fields(self):
            if not 0 <= getattr(self, item.name) < math.inf:
                raise ConfigError(
                    f"odometry filter: {item.name} must be a finite number of at least 0, "
                    f"got {getattr(self, item.name)}"
                )


class EkfOdometry(Odometry):
    """Odometry whose pose comes from the filter.

    Args:
        robot: whose wheels.
        config: their noise.
        rng: of the noise; the filter itself draws nothing.
        imu: noise of the gyro.
        expects: what else may go wrong.
    """

    def __init__(
        self,
        robot: Robot,
        config: OdometryConfig,
        rng: np.random.Generator,
        imu: ImuConfig,
        expects: EkfConfig | None = None,
    ) -> None:
        super().__init__(robot, config, rng)
        self.expects = expects or EkfConfig()
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
        """Let the filter take what was added since the last reading; return `T_odom_base`."""
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
        self._time = self._length = self._turned = self._wheels_turned = self._wheel_way = 0.0
        self._readings = 0

    def _add(self, way: Way) -> None:
        turn, length = way.turn, abs(way.length)
        self._moved = integrated(self._moved, way.ahead, turn)
        if self._slip_radius and turn:
            slide = self.expects.slide * self._slip_radius * abs(turn) / self.robot.friction
            ahead, left = slide * math.sin(way.pitch), -slide * math.sin(way.roll)
            self._moved = self._moved @ Pose2(ahead, left)
            self._drifted += math.hypot(ahead, left)
        self._time += way.dt
        self._length += length
        self._turned += turn
        self._wheels_turned += way.wheel_turn
        self._wheel_way += length + abs(way.wheel_turn) * self.robot.radius
        self._readings += 1

    def _predict(self) -> None:
        """Move by the summed way, less what bias and scale have put into it.

        With (a, b) the summed way in the frame of its start, the bias turns it by half of what it turns the
        end: the way was driven at an even rate.
        """
        f, a, b = self._filter, self._moved.x, self._moved.y
        bias, scale = float(f.x[BIAS]), float(f.x[SCALE])
        half = -bias * self._time / 2
        yaw = float(f.x[YAW]) + half
        c, s = math.cos(yaw), math.sin(yaw)
        east, north = c * a - s * b, s * a + c * b
        keep = math.exp(-self._length / self.config.scale_length)
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
        e, turned = self.expects, self._turned
        pivot = e.slip_turning**2 * abs(turned) + e.drift**2 * self._drifted
        ahead, aside = e.slip_ahead**2 * self._length + pivot, e.slip_aside**2 * self._length + pivot
        white = self._imu.rate_sigma**2 * self._time**2 / max(self._readings, 1)
        Q = np.zeros((5, 5))
        Q[X, X], Q[Y, Y] = c * c * ahead + s * s * aside, s * s * ahead + c * c * aside
        Q[X, Y] = Q[Y, X] = c * s * (ahead - aside)
        Q[YAW, YAW] = white + e.tilt**2 * turned**2
        Q[SCALE, SCALE] = renewed * self.config.scale_sigma**2
        return Q

    def _measure_bias(self) -> None:
        """Compare the gyro with the wheels: exact at rest, useful on one axle, useless where wheels skid."""
        e, rate = self.expects, self._wheels_turned / self._time
        sigma = self._imu.rate_sigma / math.sqrt(self._readings)
        if self._wheel_way / self._time >= e.rest * self.robot.wheel_radius:
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
