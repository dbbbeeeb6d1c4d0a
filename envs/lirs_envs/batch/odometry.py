"""Wheel odometry of N robots: the kernel of a single robot for each row."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lirs_envs.sensing.odometry import DistanceNoises, OdometryConfig, mean_angle, reckoned_pose
from lirs_wct.arrays import FloatArray, IntArray, Vector3
from lirs_wct.kernels import njit


class WheelJoints(NamedTuple):
    """Addresses of the driven wheels' angles in `qpos`, and the wheel radius, meters."""

    left: IntArray
    right: IntArray
    radius: float


class WheelOdometries:
    """Odometry `T_odom_base` of N robots: distance from the wheels, heading from the gyro.

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
        self._used_up = integrate_wheels(
            ids,
            (qpos, rates, attitude),
            self._joints,
            (noises.scale, noises.normals, noises.used),
            noises.parameters,
            dt,
            self._angles,
            self.pose,
        )

    def read(self, ids: IntArray) -> None:
        """Do nothing: the pose is always up to date."""


@njit(cache=True, nogil=True)
def integrate_wheels(
    ids: IntArray,
    motion: tuple[FloatArray, FloatArray, FloatArray],
    joints: WheelJoints,
    noise: tuple[FloatArray, FloatArray, IntArray],
    parameters: tuple[float, float],
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
    scale, normals, used = noise
    for n in range(len(ids)):
        i = ids[n]
        left, right = mean_angle(qpos[i], joints.left), mean_angle(qpos[i], joints.right)
        turned = ((left - angles[i, 0]) + (right - angles[i, 1])) / 2
        measured = ((rates[i, 0], rates[i, 1], rates[i, 2]), attitude[i, 0], attitude[i, 1])
        at: Vector3 = (pose[i, 0], pose[i, 1], pose[i, 2])
        pose[i, 0], pose[i, 1], pose[i, 2] = reckoned_pose(
            at,
            (scale[i : i + 1], normals[i], used[i : i + 1]),
            parameters,
            turned * joints.radius,
            measured,
            dt,
        )
        angles[i, 0], angles[i, 1] = left, right
        used_up |= used[i] == normals.shape[1]
    return used_up
