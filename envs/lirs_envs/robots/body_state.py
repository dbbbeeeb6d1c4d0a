"""State of a robot's body in MuJoCo, in the world frame."""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco

from lirs_envs.robots.robot import Robot
from lirs_wct.arrays import FloatArray, Vector3
from lirs_wct.geometry import Pose3


class BodyState:
    """True state of one robot, for its sensors and control.

    From positions and velocities: MuJoCo's sensors lie one step behind them.

    Attributes:
        model: compiled.
        qpos: (nq,) positions, live; the first seven are those of `T_world_base`.
        qvel: (nv,) velocities, live.
        left_angles: indices of the driven wheels' angles on the left in `qpos`.
        right_angles: the same on the right.
    """

    qpos: FloatArray
    qvel: FloatArray

    def __init__(self, model: mujoco.MjModel, robot: Robot) -> None:
        self.model = model
        self.left_angles, self.right_angles = (
            [int(model.joint(name).qposadr[0]) for name in side]
            for side in (robot.left_wheels, robot.right_wheels)
        )

    @property
    def gravity(self) -> float:
        """Gravity along -z, m/s^2."""
        return -float(self.model.opt.gravity[2])

    def pose(self) -> Pose3:
        """Return `T_world_base`."""
        return base_pose(self.qpos)

    def rates(self) -> Vector3:
        """Return the rates about x, y, z of the base, rad/s."""
        x, y, z = self.qvel[3:6].tolist()
        return x, y, z

    def velocity(self) -> Vector3:
        """Return the velocity of base_link along x, y, z of the base, m/s."""
        x, y, z = (self.qvel[:3] @ self.pose().rotation).tolist()
        return x, y, z

    def wheel_angles(self) -> tuple[float, float]:
        """Return the mean angles by which left and right wheels have turned, radians."""
        return self._mean_angle(self.left_angles), self._mean_angle(self.right_angles)

    def _mean_angle(self, joints: Sequence[int]) -> float:
        angle = self.qpos.item
        return float(sum([angle(i) for i in joints]) / max(len(joints), 1))


def base_pose(qpos: FloatArray) -> Pose3:
    """Return `T_world_base` from a state's positions (nq,)."""
    x, y, z, qw, qx, qy, qz = qpos[:7].tolist()
    norm = math.sqrt(qw * qw + qx * qx + qy * qy + qz * qz)
    return Pose3(x, y, z, qw / norm, qx / norm, qy / norm, qz / norm)
