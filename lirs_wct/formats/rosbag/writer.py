"""A drive as a ROS 2 bag: sensors, frames, truth and map on the topics that a robot has them on.

The frames are REP 105's: map -> odom -> base_link -> laser. Stamps are simulated time. Chunks are closed
at 1 MiB *after* the message that fills them, so that a chunk holds every message whole, a large map too.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import chain, pairwise
from pathlib import Path
from typing import Final, Literal, get_args

import numpy as np
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import StoragePlugin, Writer

from lirs_wct.arrays import FloatArray
from lirs_wct.files import atomic_folder
from lirs_wct.formats.rosbag.messages import (
    BASE,
    LASER,
    MAP,
    ODOM,
    Message,
    Messages,
    body_velocity,
    nanoseconds,
)
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.pose import Pose2, Pose3
from lirs_wct.geometry.scan import Imu, LaserScan

Storage = Literal["mcap", "sqlite3"]
STORAGES: tuple[Storage, ...] = get_args(Storage)
TOPICS = {
    "/clock": "rosgraph_msgs/msg/Clock",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/odom": "nav_msgs/msg/Odometry",
    "/imu": "sensor_msgs/msg/Imu",
    "/scan": "sensor_msgs/msg/LaserScan",
    "/ground_truth": "geometry_msgs/msg/PoseStamped",
    "/map": "nav_msgs/msg/OccupancyGrid",
}
"""Topics and their types."""
LATCHED = ("/tf_static", "/map")
"""Topics whose last message is for who comes later, too."""
VERSION: Final = 9
"""Of `metadata.yaml`: that of ROS 2 Jazzy."""


@dataclass(frozen=True, kw_only=True)
class Drive:
    """What a bag is written of; as many of each as there are scans.

    Attributes:
        scans: of the lidar.
        odometry: `T_odom_base`.
        imu: readings of the inertial unit.
        truth: `T_map_base`, from the simulator; the map frame is the first base pose in the plane.
        estimates: `T_map_base`, a mapper's answers; empty = none, then nothing ties odom to a map.
        grid: the mapper's map, in the map frame; None = none.
    """

    scans: Sequence[LaserScan]
    odometry: Sequence[Pose2]
    imu: Sequence[Imu]
    truth: Sequence[Pose3]
    estimates: Sequence[Pose2] = ()
    grid: OccupancyGrid | None = None


def write_bag(folder: Path, drive: Drive, storage: Storage = "mcap") -> None:
    """Write a drive as a bag folder, whole or not at all, in place of an older one.

    Raises:
        OutputError: the folder cannot be written.
    """
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    with atomic_folder(folder) as temporary:
        # The library names the file by the folder, and wants to make it.
        made = temporary / folder.name
        with Writer(made, version=VERSION, storage_plugin=plugin) as writer:
            _write(writer, drive)
        for file in made.iterdir():
            shutil.move(file, temporary / f".{file.name}")
        made.rmdir()
        for file in temporary.iterdir():
            file.rename(temporary / file.name[1:])


def _write(writer: Writer, drive: Drive) -> None:
    """Write all messages in the order of time."""
    messages = Messages()
    connections = {
        topic: writer.add_connection(
            topic, kind, typestore=messages.store, offered_qos_profiles=[_qos(topic in LATCHED)]
        )
        for topic, kind in TOPICS.items()
        if topic != "/map" or drive.grid is not None
    }

    def write(topic: str, stamp: float, message: Message) -> None:
        writer.write(connections[topic], nanoseconds(stamp), messages.encoded(message))

    first, last = drive.scans[0], drive.scans[-1]
    write("/tf_static", first.stamp, messages.transforms(first.stamp, {(BASE, LASER): first.T_base_laser}))
    velocities, period = _velocities(drive), _period(drive)
    for k in range(len(drive.scans)):
        _write_tick(write, messages, drive, k, velocities[k], period)
    if drive.grid is not None:
        write("/map", last.stamp, messages.map(last.stamp, drive.grid))


def _write_tick(
    write: Callable[[str, float, Message], None],
    messages: Messages,
    drive: Drive,
    k: int,
    velocity: FloatArray,
    period: float,
) -> None:
    """Write what belongs to scan k; the frames come before what is measured in them."""
    scan, T_odom_base = drive.scans[k], drive.odometry[k]
    edges = {(ODOM, BASE): Pose3.from_pose2(T_odom_base)}
    if drive.estimates:
        edges[MAP, ODOM] = Pose3.from_pose2(drive.estimates[k] @ T_odom_base.inverse())
    t = scan.stamp
    write("/clock", t, messages.clock(t))
    write("/tf", t, messages.transforms(t, edges))
    write("/odom", t, messages.odometry(t, T_odom_base, velocity))
    write("/imu", t, messages.imu(drive.imu[k]))
    write("/scan", t, messages.scan(scan, period))
    write("/ground_truth", t, messages.pose(t, drive.truth[k]))


def _velocities(drive: Drive) -> list[FloatArray]:
    """Return the velocity of the base over the period before each scan, by odometry; at first it stands."""
    steps = (
        body_velocity(a, b, later.stamp - earlier.stamp)
        for (a, b), (earlier, later) in zip(pairwise(drive.odometry), pairwise(drive.scans), strict=True)
    )
    return list(chain((np.zeros(3),), steps))


def _period(drive: Drive) -> float:
    """Return the usual time from scan to scan, seconds; 0 of a single one."""
    steps = np.diff([scan.stamp for scan in drive.scans])
    return float(np.median(steps)) if len(steps) else 0.0


def _qos(latched: bool) -> Qos:
    """Return what the publisher offers: reliable, and where latched the last message for late subscribers."""
    never = QosTime(0, 0)
    return Qos(
        QosHistory.KEEP_LAST,
        1 if latched else 10,
        QosReliability.RELIABLE,
        QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE,
        never,
        never,
        QosLiveliness.AUTOMATIC,
        never,
        False,
    )
