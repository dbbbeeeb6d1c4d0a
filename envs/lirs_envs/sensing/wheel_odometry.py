"""Odometry by wheels and gyro, with the errors of distance and heading."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal, get_args

import numpy as np

from lirs_envs.robots.control import WheelJoints, mean_angle
from lirs_wct.arrays import Vector3
from lirs_wct.errors import Checked, check_field, limited, one_of
from lirs_wct.geometry import FloatArray, IntArray, njit

Method = Literal["gyro", "ekf"]
METHODS: tuple[Method, ...] = get_args(Method)
BLOCK = 256
"""Number of random numbers drawn at once: a single draw would cost as much as the rest of the update."""


@dataclass(frozen=True, kw_only=True)
class OdometryConfig(Checked, of="the odometry"):
    """Noise and method of odometry; slip comes from the simulation and adds to the noise.

    Attributes:
        scale_sigma: Standard deviation of the distance's scale error, which varies while the robot drives.
        scale_length: Correlation length of the scale error, meters (first-order Gauss-Markov process).
        scale_bias: Constant scale error of the distance, as of a wrong wheel radius.
        method: `gyro` = distance from the wheels, heading from the gyro; `ekf` = a Kalman filter over both,
            which estimates the gyro's bias where the wheels measure the turn (at rest, or with one axle).
    """

    scale_sigma: float = limited(0.02, "[0, 1)")
    scale_length: float = limited(5.0, "(0, inf)", "m")
    scale_bias: float = limited(0.0, "(-1, 1)")
    method: Method = check_field(one_of(METHODS), default="gyro")


class DistanceNoises:
    """Scale errors of the distances of N robots: first-order Gauss-Markov processes over the distance driven.

    Attributes:
        scale: (N,) present scale error.
        slip: (N,) share by which distances are too long on top of it.
        normals: (N, n) coming normal numbers.
        used: (N,) number of used normal numbers.
        parameters: Standard deviation, correlation length, meters, and constant error.

    Args:
        updates: Largest number of distances between two calls of `draw`.
    """

    def __init__(self, config: OdometryConfig, count: int, updates: int = 1) -> None:
        self.parameters = (float(config.scale_sigma), float(config.scale_length), float(config.scale_bias))
        self._rngs = [np.random.default_rng(0) for _ in range(count)]
        self.normals = np.zeros((count, BLOCK + updates))
        self.used = np.full(count, BLOCK + updates)
        self.scale, self.slip = np.zeros(count), np.zeros(count)

    def begin(self, i: int, rng: np.random.Generator) -> None:
        """Draw a new scale error of robot `i` from its random stream."""
        self._rngs[i], self.used[i], self.slip[i] = rng, self.normals.shape[1], 0.0
        self.draw(np.array((i,)), 1)
        self.scale[i], self.used[i] = self.parameters[0] * self.normals[i, self.used[i]], self.used[i] + 1

    def draw(self, ids: IntArray, updates: int) -> None:
        """Draw the next normal numbers where fewer than `updates` are left."""
        end = self.normals.shape[1]
        for i in ids[self.used[ids] > end - updates].tolist():
            normals, used = self.normals[i], self.used[i]
            normals[used - BLOCK : end - BLOCK] = normals[used:].copy()
            self._rngs[i].standard_normal(out=normals[end - BLOCK :])
            self.used[i] -= BLOCK


@njit
def measured_distance(
    scale: FloatArray,
    normals: FloatArray,
    used: IntArray,
    distance: float,
    parameters: tuple[float, float, float],
) -> float:
    """Return a measured distance, meters, with the next normal number; `scale` and `used` are (1,)."""
    sigma, length, constant = parameters
    keep = math.exp(-abs(distance) / length)
    scale[0] = keep * scale[0] + sigma * math.sqrt(1 - keep * keep) * normals[used[0]]
    used[0] += 1
    meters: float = distance * (1 + constant + scale[0])
    return meters


@njit
def yaw_rate(rates: Vector3, roll: float, pitch: float) -> float:
    """Return the yaw rate (R = Rz Ry Rx) from rates about the base's axes, rad/s."""
    rate: float = (rates[1] * math.sin(roll) + rates[2] * math.cos(roll)) / max(math.cos(pitch), 0.1)
    return rate


@njit
def integrated_pose(pose: Vector3, forward: float, turn: float) -> Vector3:
    """Return x, y, yaw after a short motion along an arc.

    The motion is meters forward while turning by radians, less than a full turn.

    An angle less 2 pi is exact in the range of one full turn, as the remainder is.
    """
    x, y, yaw = pose
    middle = yaw + turn / 2
    yaw += turn
    if yaw > math.pi:
        yaw -= math.tau
    elif yaw <= -math.pi:
        yaw += math.tau
    return x + forward * math.cos(middle), y + forward * math.sin(middle), yaw


class WheelOdometries:
    """Odometry `T_odom_base` of N robots that drive: distance from the wheels, heading from the gyro.

    The yaw of skid-steered wheels is useless (they slip by design), which is why robots of this kind fuse the
    gyro; its noise and bias are the IMU's. The distance is projected into the plane by the IMU's attitude.

    Attributes:
        pose: (N, 3) x, y, yaw, meters and radians.
        integrate: Function that adds the motion of the last `dt` seconds (see `_integrate_wheels`).
    """

    integrate: Callable[[IntArray, FloatArray, FloatArray, FloatArray, float], None]

    def __init__(self, joints: WheelJoints, config: OdometryConfig, count: int, updates: int = 1) -> None:
        self._joints, self._updates = joints, updates
        self._noises = noises = DistanceNoises(config, count, updates)
        self._angles, self.pose = np.zeros((count, 2)), np.zeros((count, 3))
        # No method: a call of one takes as long as the kernel.
        self.integrate = partial(
            _integrate_wheels,
            joints,
            (noises.scale, noises.normals, noises.used, noises.slip),
            noises.parameters,
            self._angles,
            self.pose,
        )

    def begin(self, i: int, qpos: FloatArray, rng: np.random.Generator) -> None:
        """Begin the odometry of robot `i` where it stands."""
        self._noises.begin(i, rng)
        self._angles[i] = mean_angle(qpos[i], self._joints.left), mean_angle(qpos[i], self._joints.right)
        self.pose[i] = 0.0

    def set_slip(self, i: int, share: float) -> None:
        """Lengthen the measured distance by a share, until robot `i` begins again."""
        self._noises.slip[i] = share

    def read(self, ids: IntArray) -> None:
        """Draw the random numbers of the next period; the poses are always up to date."""
        self._noises.draw(ids, self._updates)


@njit
def _integrate_wheels(
    joints: WheelJoints,
    noise: tuple[FloatArray, FloatArray, IntArray, FloatArray],
    parameters: tuple[float, float, float],
    angles: FloatArray,
    pose: FloatArray,
    ids: IntArray,
    qpos: FloatArray,
    rates: FloatArray,
    attitude: FloatArray,
    dt: float,
) -> None:
    """Add the motion since the last update to `pose` (N, 3); update wheel `angles` (N, 2)."""
    scale, normals, used, slip = noise
    for n in range(len(ids)):
        i = ids[n]
        left, right = mean_angle(qpos[i], joints.left), mean_angle(qpos[i], joints.right)
        turned = ((left - angles[i, 0]) + (right - angles[i, 1])) / 2
        driven = turned * joints.radius * (1.0 + slip[i])
        meters = measured_distance(scale[i : i + 1], normals[i], used[i : i + 1], driven, parameters)
        roll, pitch = attitude[i, 0], attitude[i, 1]
        turn = yaw_rate((rates[i, 0], rates[i, 1], rates[i, 2]), roll, pitch) * dt
        at: Vector3 = (pose[i, 0], pose[i, 1], pose[i, 2])
        pose[i, 0], pose[i, 1], pose[i, 2] = integrated_pose(at, meters * math.cos(pitch), turn)
        angles[i, 0], angles[i, 1] = left, right
