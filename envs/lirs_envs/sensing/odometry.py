"""Dead reckoning from wheels and gyro, or from optical flow and gyro. The Kalman filter is in `ekf`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import numpy as np

from lirs_wct import Pose2, Pose3
from lirs_wct.arrays import FloatArray, IntArray, Vector3, njit
from lirs_wct.checks import Checked, check_field, limited, one_of

Method = Literal["gyro", "ekf"]
METHODS: tuple[Method, ...] = get_args(Method)
BLOCK = 256
"""Random numbers per draw: a single draw would cost as much as the rest of the update."""


@dataclass(frozen=True, kw_only=True)
class OdometryConfig(Checked, of="the odometry"):
    """Noise and method of odometry; slip comes from the simulation and adds to the noise.

    Attributes:
        scale_sigma: standard deviation of the distance's scale error, which varies while the robot drives.
        scale_length: correlation length of the scale error, meters (first-order Gauss-Markov process).
        scale_bias: constant scale error of the distance, as of a wrong wheel radius.
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
        normals: (N, BLOCK) coming normal numbers.
        used: (N,) how many of them are used up.
        parameters: standard deviation, correlation length, meters, and constant error.
    """

    def __init__(self, config: OdometryConfig, count: int) -> None:
        self.parameters = (float(config.scale_sigma), float(config.scale_length), float(config.scale_bias))
        self._rngs = [np.random.default_rng(0) for _ in range(count)]
        self.normals = np.zeros((count, BLOCK))
        self.used = np.zeros(count, np.int64)
        self.scale, self.slip = np.zeros(count), np.zeros(count)

    def begin(self, i: int, rng: np.random.Generator) -> None:
        """Draw a new scale error of robot `i` from its random stream."""
        self._rngs[i], self.used[i], self.slip[i] = rng, BLOCK, 0.0
        self.draw()
        self.scale[i], self.used[i] = self.parameters[0] * self.normals[i, 0], 1

    def draw(self) -> None:
        """Draw a block of numbers where one is used up."""
        for i in np.flatnonzero(self.used == BLOCK).tolist():
            self._rngs[i].standard_normal(out=self.normals[i])
            self.used[i] = 0


class DistanceNoise(DistanceNoises):
    """The scale error of one robot's distances."""

    def __init__(self, config: OdometryConfig, rng: np.random.Generator) -> None:
        super().__init__(config, 1)
        self.begin(0, rng)

    def measure(self, distance: float) -> float:
        """Return the measured distance, meters."""
        if self.used[0] == BLOCK:
            self.draw()
        turned = distance * (1.0 + float(self.slip[0]))
        meters: float = measured_distance(self.scale, self.normals[0], self.used, turned, self.parameters)
        return meters


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
def mean_angle(qpos: FloatArray, joints: IntArray) -> float:
    """Return the mean angle of some wheels, radians, from a state's positions (nq,)."""
    total = 0.0
    for k in range(len(joints)):
        total += qpos[joints[k]]
    return total / len(joints)


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


class WheelJoints(NamedTuple):
    """Addresses of the driven wheels' angles in `qpos`, and the wheel radius, meters."""

    left: IntArray
    right: IntArray
    radius: float


class WheelOdometries:
    """Odometry `T_odom_base` of N robots that drive: distance from the wheels, heading from the gyro.

    The yaw of skid-steered wheels is useless (they slip by design), which is why robots of this kind fuse the
    gyro; its noise and bias are the IMU's. The distance is projected into the plane by the IMU's attitude.

    Attributes:
        pose: (N, 3) x, y, yaw, meters and radians.
    """

    def __init__(self, joints: WheelJoints, config: OdometryConfig, count: int) -> None:
        self._joints = joints
        self._noises = DistanceNoises(config, count)
        self._angles = np.zeros((count, 2))
        self.pose = np.zeros((count, 3))
        self._used_up = False

    def begin(self, i: int, qpos: FloatArray, rng: np.random.Generator) -> None:
        """Begin the odometry of robot `i` where it stands."""
        self._noises.begin(i, rng)
        self._angles[i] = mean_angle(qpos[i], self._joints.left), mean_angle(qpos[i], self._joints.right)
        self.pose[i] = 0.0

    def integrate(
        self, ids: IntArray, qpos: FloatArray, rates: FloatArray, attitude: FloatArray, dt: float
    ) -> None:
        """Add the motion of the last `dt` seconds. `rates` (N, 3) and `attitude` (N, 2) are measured."""
        noises = self._noises
        if self._used_up:
            noises.draw()
        self._used_up = _integrate_wheels(
            ids,
            (qpos, rates, attitude),
            self._joints,
            (noises.scale, noises.normals, noises.used, noises.slip),
            noises.parameters,
            dt,
            self._angles,
            self.pose,
        )

    def set_slip(self, i: int, share: float) -> None:
        """Lengthen the measured distance by a share, until robot `i` begins again."""
        self._noises.slip[i] = share

    def read(self, ids: IntArray) -> None:
        """Do nothing: the pose is always up to date."""


@njit
def _integrate_wheels(
    ids: IntArray,
    motion: tuple[FloatArray, FloatArray, FloatArray],
    joints: WheelJoints,
    noise: tuple[FloatArray, FloatArray, IntArray, FloatArray],
    parameters: tuple[float, float, float],
    dt: float,
    angles: FloatArray,
    pose: FloatArray,
) -> bool:
    """Add the motion since the last update to `pose` (N, 3).

    The wheel `angles` (N, 2) are updated.

    Return whether the normal numbers of one robot are used up.
    """
    used_up = False
    qpos, rates, attitude = motion
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
        used_up |= used[i] == normals.shape[1]
    return used_up


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
        """Add the motion since the last update; none in no time (`dt` 0).

        Args:
            T_world_base: true pose.
            velocity: true, along x, y, z of the base, m/s.
            rates: measured rates about x, y, z of the base, rad/s.
            roll: measured attitude, radians.
            pitch: measured attitude, radians.
            dt: seconds.
        """
        east, north, _ = (T_world_base.rotation @ np.array(velocity) * dt).tolist()
        c, s = math.cos(T_world_base.yaw), math.sin(T_world_base.yaw)
        distance = math.hypot(east, north)
        scale = self.noise.measure(distance) / distance if distance > 0 else 1.0
        turn = yaw_rate(rates, roll, pitch) * dt
        # Axes of the true yaw: the camera's picture turns with the body.
        moved = Pose2((c * east + s * north) * scale, (c * north - s * east) * scale, turn)
        self.pose = self.pose @ moved
