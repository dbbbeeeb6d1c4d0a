"""Laser scans with odometry as a gzipped CARMEN log of `ROBOTLASER1` messages.

Each message states start angle, field of view, resolution and largest range, so that no reader has to assume
180 degrees. Ranges have steps of a millimeter. No return is the largest range or more, too near is 0, and
invalid is 81.91, the code of a SICK.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lirs_wct.arrays import Float32Array, IntArray
from lirs_wct.files import write_gzipped
from lirs_wct.formats.carmen.laser import mount_comment
from lirs_wct.geometry import LaserScan, Pose2

INVALID = 81.91
"""Code of an invalid measurement, meters."""
HOST = "lirs-wct"
HEADER = (
    "# CARMEN log: ROBOTLASER1 laser_type start_angle field_of_view angular_resolution maximum_range\n"
    "#   accuracy remission_mode num_readings [ranges] num_remissions laser_x laser_y laser_theta\n"
    "#   robot_x robot_y robot_theta laser_tv laser_rv forward_safety_dist side_safety_dist turn_axis\n"
    "#   timestamp host logger_timestamp\n"
    "# meters, radians, seconds since the start; the robot's pose is its odometry\n"
)


def write_log(path: Path, scans: Iterable[tuple[LaserScan, Pose2]]) -> None:
    """Write scans and their odometry `T_odom_base`; the same data give the same bytes.

    Messages hold only the planar part of the laser's mount (x, y, yaw); a comment holds all of it.

    Raises:
        OutputError: the file cannot be written.
    """
    with write_gzipped(path) as zipped:
        zipped.write(HEADER.encode())
        for k, (scan, T_odom_base) in enumerate(scans):
            if k == 0:
                zipped.write(mount_comment(scan.T_base_laser).encode())
            zipped.write(_message(scan, T_odom_base))


def _message(scan: LaserScan, T_odom_base: Pose2) -> bytes:
    n = len(scan.ranges)
    laser = T_odom_base @ scan.T_base_laser.to_pose2()
    fov = scan.angle_increment * (n - 1)
    farthest = scan.limits[1]
    geometry = f"{scan.angle_min:.9f} {fov:.9f} {scan.angle_increment:.12f} {farthest:.3f}"
    poses = f"{_pose(laser)} {_pose(T_odom_base)}"
    stamp = f"{scan.stamp:.6f}"
    before, after = f"ROBOTLASER1 0 {geometry} 0 0 {n}", f" 0 {poses} 0 0 0 0 0 {stamp} {HOST} {stamp}\n"
    texts = _formatted_ranges(math.ceil(farthest * 1000) + 1)
    ranges = texts[_millimeters(scan.ranges, len(texts) - 2)].tobytes().translate(None, b"\0")
    return before.encode() + ranges + after.encode()


def _pose(pose: Pose2) -> str:
    return f"{pose.x:.6f} {pose.y:.6f} {pose.yaw:.8f}"


def _millimeters(ranges: Float32Array, most: int) -> IntArray:
    """Return (n,) millimeters; `most` = no return, -1 = invalid.

    A hit stays below `most`, since that means no return.
    """
    finite = np.isfinite(ranges)
    mm = np.clip(np.rint(np.where(finite, ranges, 0) * 1000.0), 0, most - 1).astype(np.int64)
    mm[ranges == np.inf] = most
    mm[np.isnan(ranges)] = -1
    return mm


@cache
def _formatted_ranges(millimeters: int) -> NDArray[np.bytes_]:
    """Return texts of ranges by millimeter, a space before each; the last is "invalid"."""
    return np.array([*(f" {mm / 1000:.3f}" for mm in range(millimeters)), f" {INVALID:.2f}"], np.bytes_)
