"""A drive of a few scans with every kind of reading, and a map larger than a chunk of MCAP."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection

from lirs_wct.formats.laser_log import LaserLog
from lirs_wct.formats.rosbag.messages import BagDrive, BagTick, SensorErrors
from lirs_wct.geometry import OccupancyGrid
from lirs_wct.geometry.pose import Pose2, Pose3
from lirs_wct.geometry.scan import Imu, ImuReadings, LaserScan, PointCloud

ERRORS = SensorErrors(
    scale=0.02, scale_length=5.0, rate=0.1, rate_bias=0.2, update=0.01, attitude=0.3, acceleration=0.4
)
MOUNT = Pose3.from_rpy(0.22, -0.01, 0.32, 0.0, 0.02, 0.1)


def drive(scans: int = 5) -> BagDrive:
    rng = np.random.default_rng(3)
    stamps = [1.0 + 0.02 * k for k in range(scans)]
    ranges = rng.uniform(0.2, 20.0, (scans, 31)).astype(np.float32)
    ranges[:, 0], ranges[:, 1], ranges[:, 2] = np.inf, -np.inf, np.nan
    xyz = rng.uniform(-20, 20, (scans, 8, 3)).astype(np.float32)
    ring = np.repeat(np.arange(4, dtype=np.uint16), 2)
    time = np.tile(np.array((0, 0.05), np.float32), 4)
    intensity = np.linspace(0, 255, 8, dtype=np.float32)
    column = np.tile(np.array((0, 2), np.uint16), 4)
    p = rng.uniform(0, 1, (1100, 1000))
    p[0, :10] = np.nan
    ticks = [
        BagTick(
            scan=LaserScan(ranges[k], -1.5, 0.1, 0.1, 30.0, t, MOUNT),
            odometry=Pose2(0.01 * k, -0.002 * k, 0.005 * k),
            imu=Imu(0.001 * k, -0.002 * k, (0.1, 0.2, 0.25), (0.3, 0.4, 9.7), t),
            truth=Pose3.from_rpy(0.011 * k, 0.0, 0.5, 0.01, 0.02, 0.005 * k),
            cloud=PointCloud(xyz[k], ring, time, t, MOUNT, intensity, column, (4, 3)),
            estimate=Pose2(0.0105 * k, -0.001 * k, 0.0052 * k),
            inertial=readings(t, k) if k else None,
        )
        for k, t in enumerate(stamps)
    ]
    grid = OccupancyGrid.from_probability(p, 0.05, Pose2(-20, -21, 0.1))
    return BagDrive(ticks=ticks, grid=grid, errors=ERRORS)


def readings(stamp: float, k: int) -> ImuReadings:
    """Return two inertial readings, the last one at a stamp."""
    return ImuReadings(stamp - np.array((0.01, 0.0)), np.full((2, 3), float(k)), np.ones((2, 3)), 0.1, 0.2)


def check(log: LaserLog, given: BagDrive, count: int | None = None) -> None:
    """Compare scans and odometry with those of the drive's first `count` ticks, or of all."""
    ticks = given.ticks[:count]
    assert len(log.scans) == len(ticks)
    for scan, tick in zip(log.scans, ticks, strict=True):
        wanted = tick.scan
        np.testing.assert_array_equal(scan.ranges, wanted.ranges)
        np.testing.assert_allclose(scan.angles, wanted.angles, atol=2e-7)
        assert scan.stamp == pytest.approx(wanted.stamp, abs=1e-9)
        assert (scan.range_min, scan.range_max) == (0.1, 30.0)
        np.testing.assert_allclose(scan.T_base_laser.quaternion, MOUNT.quaternion)
        np.testing.assert_allclose(scan.T_base_laser.position, MOUNT.position)
    for pose, tick in zip(log.odometry, ticks, strict=True):
        np.testing.assert_allclose(pose.as_array(), tick.odometry.as_array(), atol=1e-9)


def copy_bag(
    bag: Path,
    writer: Any,
    change: Callable[[int, Connection, bytes], bytes | None] = lambda _scan, _connection, data: data,
    without: tuple[str, ...] = (),
) -> None:
    """Copy a bag through a writer of ROS 2, without some topics.

    `change` gets the number of the scan, from 0, the connection and the data of each message, and returns the
    data to write, or None to leave the message out.
    """
    scan = -1
    with AnyReader([bag]) as reader:
        made = {
            c.topic: writer.add_connection(c.topic, c.msgtype, typestore=reader.typestore)
            for c in reader.connections
            if c.topic not in without
        }
        for connection, stamp, data in reader.messages():
            scan += connection.topic == "/clock"  # begins what belongs to a scan
            changed = change(scan, connection, data) if connection.topic in made else None
            if changed is not None:
                writer.write(made[connection.topic], stamp, changed)
