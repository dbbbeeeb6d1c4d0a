"""Dead reckoning in space: planar odometry, lifted by the attitude from gravity."""

from __future__ import annotations

from collections.abc import Sequence

from lirs_wct.arrays import FloatArray
from lirs_wct.geometry import Imu, Pose2, Pose3


def climb(dx: float, dy: float, up: FloatArray) -> float:
    """Return the rise of a step on an inclined plane, meters.

    A robot on wheels moves in the plane of its x and y axes, so that up . (dx, dy, rise) = 0.

    Args:
        dx: horizontal step along x of a level frame, meters.
        dy: along y.
        up: (3,) z axis of the robot in that frame, of any length; upward.
    """
    return float(-(up[0] * dx + up[1] * dy) / max(up[2], 0.1))


def spatial_odometry(odometry: Sequence[Pose2], readings: Sequence[Imu | None]) -> list[Pose3]:
    """Return poses in space by planar odometry and attitude.

    Position and yaw in the plane are the odometry's. Roll and pitch are those of the inertial readings, 0
    without one. The height adds up the climbs, with the mean attitude of a step's two ends.

    Args:
        odometry: `T_odom_base` in the plane.
        readings: inertial readings at the same stamps.
    """
    poses: list[Pose3] = []
    for planar, imu in zip(odometry, readings, strict=True):
        roll, pitch = (0.0, 0.0) if imu is None else (imu.roll, imu.pitch)
        pose = Pose3.from_rpy(planar.x, planar.y, 0.0, roll, pitch, planar.yaw)
        if poses:
            last = poses[-1]
            up = (last.rotation + pose.rotation)[:, 2]
            z = last.z + climb(pose.x - last.x, pose.y - last.y, up)
            pose = Pose3(pose.x, pose.y, z, *pose.quaternion.tolist())
        poses.append(pose)
    return poses
