"""Messages between a drive and its mapper's process: batches of scans and answers as plain arrays."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any

import numpy as np

from lirs_wct.arrays import Float32Array, FloatArray
from lirs_wct.geometry.pose import Pose2, Pose3
from lirs_wct.geometry.scan import Imu, LaserScan

_PLANE = attrgetter("x", "y", "yaw")
_SPACE = attrgetter("x", "y", "z", "qw", "qx", "qy", "qz")


@dataclass(frozen=True, slots=True)
class ScanBatch:
    """Scans of one lidar, with odometry and inertial readings.

    Attributes:
        lidar: a scan without ranges; holds the fields that all scans share.
        ranges: (n, beams) float32 meters.
        numbers: (n, 13) float64: stamp; odometry x, y, yaw; the inertial reading's row.
    """

    lidar: LaserScan
    ranges: Float32Array
    numbers: FloatArray


def pack_updates(updates: Sequence[tuple[Any, ...]]) -> ScanBatch | Sequence[tuple[Any, ...]]:
    """Return the message of some updates; clouds and updates without odometry or IMU are sent one by one."""
    first = updates[0][0]
    if not isinstance(first, LaserScan) or any(None in update for update in updates):
        return updates
    ranges = np.stack([scan.ranges for scan, _, _ in updates])
    numbers = np.array([(scan.stamp, *_PLANE(odometry), *imu.row) for scan, odometry, imu in updates])
    return ScanBatch(replace(first, ranges=first.ranges[:0]), ranges, numbers)


def unpack_updates(batch: ScanBatch | Sequence[tuple[Any, ...]]) -> Iterator[tuple[Any, ...]]:
    """Yield the arguments of each update."""
    if not isinstance(batch, ScanBatch):
        yield from batch
        return
    for ranges, (stamp, x, y, yaw, *imu) in zip(batch.ranges, batch.numbers.tolist(), strict=True):
        yield replace(batch.lidar, ranges=ranges, stamp=stamp), Pose2(x, y, yaw), Imu.from_row(*imu)


def pack_pose(pose: Pose2 | Pose3) -> tuple[float, ...]:
    """Return the numbers of a pose, three in the plane, seven in space."""
    numbers: tuple[float, ...] = (_PLANE if isinstance(pose, Pose2) else _SPACE)(pose)
    return numbers


def unpack_pose(numbers: tuple[float, ...]) -> Pose2 | Pose3:
    """Return the pose of such numbers."""
    return Pose2(*numbers) if len(numbers) == 3 else Pose3(*numbers)
