"""A bag, ROS 2 or ROS 1, as a log: scans, the odometry at them, inertial readings, the laser's mount."""

from __future__ import annotations

import math
import warnings
from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from lirs_wct.errors import SourceError
from lirs_wct.formats.carmen.lines import Message
from lirs_wct.formats.carmen.log import CarmenLog
from lirs_wct.formats.carmen.odometry import odometry_of
from lirs_wct.formats.carmen.stamps import in_file_order
from lirs_wct.formats.rosbag.frames import Frames, pose_of
from lirs_wct.formats.rosbag.salvage import completed, is_cut
from lirs_wct.formats.rosbag.topics import Topics
from lirs_wct.geometry.pose import Pose3
from lirs_wct.geometry.scan import Imu, LaserScan

SAME_ANGLE = 1e-4
"""Radians within which angle_max agrees with the increment, both float32."""


@dataclass
class _Contents:
    """Messages as the bag holds them."""

    scans: list[Message] = field(default_factory=list)
    raw: list[Any] = field(default_factory=list)
    odometry: list[Message] = field(default_factory=list)
    base: str = ""
    imu: list[Any] = field(default_factory=list)
    frames: Frames = field(default_factory=Frames)
    skipped: Counter[str] = field(default_factory=Counter)
    cut: str = ""


def read_bag(path: Path, topics: Topics) -> CarmenLog:
    """Read a bag; of one that ends in the middle what is there, with a warning.

    Args:
        path: folder of a ROS 2 bag, one of its files (.mcap, .db3), or a ROS 1 bag (.bag).
        topics: where scans, odometry and inertial readings are.

    Raises:
        SourceError: it cannot be read, or has no such topic or no scan.
    """
    contents = _contents(path, topics)
    if contents.cut:
        warnings.warn(
            f"{path}: damaged ({contents.cut}): {len(contents.scans)} scans could be read", stacklevel=2
        )
    if not contents.scans:
        raise SourceError(f"{path}: holds no laser scan of one size")
    return _log(path, contents)


def _log(path: Path, c: _Contents) -> CarmenLog:
    laser = c.raw[0].header.frame_id
    base = c.base or c.frames.moving_base(laser)
    odometry = c.odometry or [
        Message(line, stamp, T.to_pose2()) for line, stamp, T in c.frames.odometry(base)
    ]
    repaired, skipped = Counter[str](), c.skipped
    scans, odoms, stamps = in_file_order(*_merged(c.scans, odometry))
    if stamps.moved:
        warnings.warn(f"{path}: {stamps.summary()}", stacklevel=3)
    poses, track = odometry_of([m.stamp for m in scans], scans, odoms, repaired)
    mount = c.frames.mount(base, laser)
    if mount is None:
        repaired[
            f"no transform from {base or 'the base'} to {laser}: the laser is taken to be at the base"
        ] = 1
    found = [_scan(raw, m.stamp, mount or Pose3()) for raw, m in zip(c.raw, scans, strict=True)]
    readings = [reading for raw in c.imu if (reading := _imu(raw, c.frames, base)) is not None]
    if len(readings) < len(c.imu):
        skipped["inertial reading without an attitude"] = len(c.imu) - len(readings)
    return CarmenLog(
        tuple(found),
        tuple(poses),
        track,
        stamps,
        skipped=dict(skipped),
        repaired=dict(repaired),
        laser=c.raw[0].__msgtype__.rpartition("/")[2],
        imu=tuple(readings),
    )


def _contents(path: Path, topics: Topics) -> _Contents:
    """Return the messages of the topics, in the order of the bag."""
    contents = _Contents()
    begun = False
    # The parsers of damaged binary data raise whatever the bytes lead to.
    try:
        with ExitStack() as stack:
            files = _files(path, stack, contents)
            reader = stack.enter_context(AnyReader(files, default_typestore=get_typestore(Stores.ROS2_JAZZY)))
            kinds = {name: info.msgtype or "" for name, info in reader.topics.items()}
            scan, odometry, imu = topics.found(path, kinds)
            wanted = {scan, odometry, imu, "/tf", "/tf_static"}
            connections = [c for c in reader.connections if c.topic in wanted]
            begun = True
            for line, (connection, _, data) in enumerate(reader.messages(connections)):
                message = reader.deserialize(data, connection.msgtype)
                if connection.topic == scan:
                    _add_scan(contents, line, message)
                elif connection.topic == odometry:
                    contents.base = message.child_frame_id.lstrip("/")
                    contents.odometry.append(_odometry(line, message))
                elif connection.topic == imu:
                    contents.imu.append(message)
                else:
                    contents.frames.add(line, message, static=connection.topic == "/tf_static")
    except SourceError as error:
        raise (SourceError(f"{error} (damaged: {contents.cut})") if contents.cut else error) from None
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        if not begun:
            raise SourceError(f"{path}: not a bag that can be read: {reason}") from error
        contents.cut = reason
    return contents


def _files(path: Path, stack: ExitStack, contents: _Contents) -> list[Path]:
    """Return what the library opens: a folder with metadata; its files where it or an end is missing."""
    files = sorted(p for p in path.iterdir() if p.suffix in (".mcap", ".db3")) if path.is_dir() else [path]
    cut = [p for p in files if p.suffix == ".mcap" and is_cut(p)]
    if not cut:
        return [path] if (path / "metadata.yaml").is_file() else files
    contents.cut = f"{', '.join(p.name for p in cut)}: its end is missing"
    return [stack.enter_context(completed(p)) if p in cut else p for p in files]


def _add_scan(contents: _Contents, line: int, message: Any) -> None:
    """Keep a scan of as many beams as the first; count another."""
    ranges = np.asarray(message.ranges, np.float32)
    if contents.raw and len(ranges) != len(contents.raw[0].ranges):
        contents.skipped["scan of another number of beams than the first"] += 1
        return
    contents.scans.append(Message(line, _stamp(message), None, None, ranges))
    contents.raw.append(message)


def _odometry(line: int, message: Any) -> Message:
    pose = message.pose.pose
    return Message(line, _stamp(message), pose_of(pose.position, pose.orientation).to_pose2())


def _merged(scans: list[Message], odoms: list[Message]) -> tuple[list[Message], list[Message]]:
    """Number messages by stamp where those of each topic rise: topics come with different delays."""

    def rises(found: list[Message]) -> bool:
        return all(a.stamp < b.stamp for a, b in pairwise(found))

    if not (rises(scans) and rises(odoms)):
        return scans, odoms
    order = sorted([*odoms, *scans], key=lambda m: m.stamp)
    numbered = [replace(m, line=k) for k, m in enumerate(order)]
    return [m for m in numbered if len(m.ranges)], [m for m in numbered if not len(m.ranges)]


def _scan(raw: Any, stamp: float, mount: Pose3) -> LaserScan:
    n = len(raw.ranges)
    first, step, last = _angle(raw.angle_min), _angle(raw.angle_increment), _angle(raw.angle_max)
    if n > 1 and abs(first + step * (n - 1) - last) < SAME_ANGLE:
        # Rounding of the increment would add up over the beams.
        step = (last - first) / (n - 1)
    ranges = np.asarray(raw.ranges, np.float32)
    return LaserScan(
        ranges,
        first,
        step,
        _decimal(raw.range_min),
        _decimal(raw.range_max),
        stamp,
        mount,
        float(raw.time_increment),
    )


def _decimal(value: float) -> float:
    """Return the shortest decimal that a float32 may have been made of: 0.1 for 0.10000000149."""
    return float(str(np.float32(value)))


def _angle(value: float) -> float:
    """Return the angle of whole ten-thousandths of a degree that a float32 was made of; else the float32.

    Mappers tell trajectories apart by less than what the messages round away.
    """
    exact = math.radians(round(math.degrees(value), 4))
    return exact if np.float32(exact) == np.float32(value) else float(value)


def _imu(raw: Any, frames: Frames, base: str) -> Imu | None:
    """Return a reading in the base's axes; None where it has no attitude."""
    if raw.orientation_covariance[0] == -1:
        return None
    q = raw.orientation
    sensor = Pose3(0.0, 0.0, 0.0, q.w, q.x, q.y, q.z)
    mounted = frames.mount(base, raw.header.frame_id) or Pose3()
    turn = mounted.rotation
    attitude = sensor @ Pose3(0, 0, 0, mounted.qw, mounted.qx, mounted.qy, mounted.qz).inverse()
    w, a = raw.angular_velocity, raw.linear_acceleration
    rates = (turn @ np.array((w.x, w.y, w.z))).tolist()
    force = (turn @ np.array((a.x, a.y, a.z))).tolist()
    return Imu(
        attitude.roll,
        attitude.pitch,
        (rates[0], rates[1], rates[2]),
        (force[0], force[1], force[2]),
        _stamp(raw),
    )


def _stamp(message: Any) -> float:
    stamp = message.header.stamp
    return float((stamp.sec * 1_000_000_000 + stamp.nanosec) / 1e9)
