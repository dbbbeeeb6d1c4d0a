"""Reading a ROS 2 or ROS 1 bag as a laser log.

The log has scans, their odometry, inertial readings and the laser's mount. Trajectories come from topics of
poses, or from transforms as SLAM systems publish them.
"""

from __future__ import annotations

import math
import warnings
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lirs_wct.errors import SourceError
from lirs_wct.formats.carmen.lines import Message
from lirs_wct.formats.carmen.repairs import in_file_order, odometry_of
from lirs_wct.formats.laser_log import LaserLog
from lirs_wct.formats.rosbag.frames import Frames, pose_of, seconds
from lirs_wct.formats.rosbag.messages import BASE, MAP
from lirs_wct.formats.rosbag.open_bag import Bag, open_bag
from lirs_wct.formats.rosbag.sensor_messages import (
    BagClouds,
    BeamGeometry,
    beams_of,
    geometry,
    ranges_of,
    records_of,
    start_of,
)
from lirs_wct.formats.rosbag.topics import (
    PATH,
    POSES,
    TRANSFORMS,
    Topics,
    list_topics,
    of_kinds,
    require_topic,
)
from lirs_wct.geometry.pose import Pose3, Trajectory
from lirs_wct.geometry.scan import Imu, ImuReadings, LaserScan

Vector = tuple[float, float, float]


CLOUD_MARK = np.zeros(1, np.float32)
"""Placeholder for the ranges of a cloud, whose points are read later."""


class _Reading(NamedTuple):
    """An inertial reading in its sensor's axes; the attitude is a wxyz quaternion, if there is one."""

    frame: str
    stamp: float
    attitude: tuple[float, float, float, float] | None
    rates: Vector
    force: Vector


@dataclass
class _Contents:
    """Content of the messages, in the order of the bag.

    Scans and inertial readings are kept as numbers. A hundred thousand message objects would slow down
    Python's garbage collector more than the reading takes.
    """

    topic: str
    clouds: bool
    laser: str = ""
    scans: list[Message] = field(default_factory=list)
    beams: list[BeamGeometry] = field(default_factory=list)
    odometry: list[Message] = field(default_factory=list)
    base: str = ""
    imu: list[_Reading] = field(default_factory=list)
    imu_sigmas: tuple[float, float] = (0.0, 0.0)
    frames: Frames = field(default_factory=Frames)
    skipped: Counter[str] = field(default_factory=Counter)
    left_out: int = 0
    repaired: Counter[str] = field(default_factory=Counter)


def read_bag(path: Path, topics: Topics) -> LaserLog:
    """Read a bag; of a damaged one the readable part, with a warning.

    Args:
        path: folder of a ROS 2 bag, one of its files (.mcap, .db3, also .zstd), or a ROS 1 bag (.bag).
        topics: topics of scans, odometry and inertial readings.

    Raises:
        SourceError: it cannot be read, or has no such topic or no scan.
    """
    with open_bag(path) as bag:
        try:
            contents = _contents(bag, topics, by_header=True)
            if _stands_still(contents.scans) or _stands_still(contents.odometry):
                bag.undecoded.clear()
                contents = _contents(bag, topics, by_header=False)
        except SourceError as error:
            damaged = f" (damaged: {'; '.join(bag.faults)})" if bag.faults else ""
            raise SourceError(f"{error}{damaged}") from None
    for topic, count in bag.undecoded.items():
        contents.skipped[f"message on {topic} that cannot be decoded"] = count
        contents.left_out += count if topic == contents.topic else 0
    if bag.faults:
        said = f"{len(contents.scans)} {'clouds' if topics.clouds else 'scans'} could be read"
        warnings.warn(f"{path}: damaged ({'; '.join(bag.faults)}): {said}", stacklevel=2)
    if not contents.scans:
        why = "; ".join(f"{count} x {reason}" for reason, count in contents.skipped.items())
        kind = "point cloud" if topics.clouds else "laser scan"
        raise SourceError(f"{path}: holds no {kind} that can be used" + (f" ({why})" if why else ""))
    return _log(path, contents)


def _stands_still(messages: list[Message]) -> bool:
    """Whether all messages have the same stamp (0 with some drivers)."""
    return len(messages) > 1 and len({m.stamp for m in messages}) == 1


def _contents(bag: Bag, topics: Topics, *, by_header: bool) -> _Contents:
    """Return the messages of the topics, in the order of the bag.

    Args:
        bag: the open bag.
        topics: topics from the user.
        by_header: whether stamps come from headers; else they are times of reception.
    """
    scan, odometry, imu = topics.choose(bag.path, bag.kinds)
    contents = _Contents(scan, topics.clouds)
    transforms = of_kinds(bag.kinds, TRANSFORMS)
    static = {name for name in transforms if name.endswith("tf_static")}
    wanted = {scan, odometry, imu, *(static if odometry else transforms)} - {None}

    for line, (topic, received, message) in enumerate(bag.messages(wanted)):
        stamp = None if by_header else received / 1e9
        if topic == scan and topics.clouds:
            _add_cloud(contents, line, message, stamp)
        elif topic == scan:
            _add_scan(contents, line, message, stamp)
        elif topic == odometry:
            contents.base = message.child_frame_id.lstrip("/")
            contents.odometry.append(_odometry(line, message, stamp))
        elif topic == imu:
            _add_reading(contents, message, stamp)
        else:
            contents.frames.add(line, message, static=topic in static, received=stamp)
    if odometry and contents.scans and _needs_transforms(contents):
        for line, (_, received, message) in enumerate(bag.messages(set(transforms) - static)):
            stamp = None if by_header else received / 1e9
            contents.frames.add(line, message, static=False, received=stamp)
    if not by_header:
        contents.repaired["header stamps all the same: times of reception are taken"] = len(contents.scans)
    return contents


def _needs_transforms(c: _Contents) -> bool:
    """Whether only /tf can provide the base frame or the laser's mount."""
    return not c.base or c.frames.mount(c.base, c.laser) is None


def _log(path: Path, c: _Contents) -> LaserLog:
    laser = c.laser
    base = c.base or c.frames.moving_base(laser)
    odometry = c.odometry or [
        Message(line, stamp, T.to_pose2()) for line, stamp, T in c.frames.odometry(base)
    ]
    repaired, skipped = c.repaired, c.skipped
    scans, odoms, stamps = in_file_order(*_number_by_stamp(c.scans, odometry))
    if stamps.moved:
        warnings.warn(f"{path}: {stamps.summary()}", stacklevel=3)
    poses, track = odometry_of(path, [m.stamp for m in scans], scans, odoms)
    mount = c.frames.mount(base, laser)
    if mount is None:
        repaired[
            f"no transform from {base or 'the base'} to {laser}: the laser is taken to be at the base"
        ] = 1
    found: list[LaserScan] = []
    clouds = None
    if c.clouds:
        clouds = BagClouds(path, c.topic, tuple(m.stamp for m in scans), mount or Pose3())
    else:
        found = [_scan(beams, m, mount or Pose3()) for beams, m in zip(c.beams, scans, strict=True)]
    mounts = {frame: c.frames.mount(base, frame) or Pose3() for frame in {reading.frame for reading in c.imu}}
    tilted = [reading for reading in c.imu if reading.attitude is not None]
    if len(tilted) < len(c.imu) and not c.clouds:
        skipped["inertial reading without an attitude"] = len(c.imu) - len(tilted)
    return LaserLog(
        tuple(found),
        tuple(poses),
        track,
        stamps,
        skipped=dict(skipped),
        repaired=dict(repaired),
        laser="PointCloud2" if c.clouds else "LaserScan",
        clouds=clouds,
        left_out=c.left_out,
        imu=tuple(_imu(reading, mounts[reading.frame]) for reading in tilted),
        inertial=_inertial(c, mounts) if c.imu else None,
    )


def _add_scan(contents: _Contents, line: int, m: Any, stamp: float | None) -> None:
    """Keep a scan with its stated beam geometry; count a scan without one."""
    ranges = ranges_of(m)
    beams = beams_of(m, len(ranges)) if len(ranges) else None
    if beams is None:
        why = "without beams" if not len(ranges) else "whose angle_min, angle_max, angle_increment disagree"
        contents.skipped[f"scan {why}"] += 1
        contents.left_out += 1
        return
    if beams.step != m.angle_increment:
        contents.repaired[f"angle_increment {m.angle_increment:g}: derived from angle_min, angle_max"] += 1
    contents.laser = contents.laser or m.header.frame_id
    time = seconds(m.header.stamp) if stamp is None else stamp
    contents.scans.append(Message(line, time, None, None, ranges))
    contents.beams.append(beams)


def _add_cloud(contents: _Contents, line: int, m: Any, stamp: float | None) -> None:
    """Keep the start time of a cloud's sweep without the points; count unusable clouds."""
    records = records_of(m)
    if records is None:
        contents.skipped["cloud without legal x, y, z, or shorter than it states"] += 1
        contents.left_out += 1
        return
    contents.laser = contents.laser or m.header.frame_id
    header = seconds(m.header.stamp)
    time = header if stamp is None else stamp
    contents.scans.append(Message(line, time + start_of(records, header), None, None, CLOUD_MARK))


def _add_reading(contents: _Contents, m: Any, stamp: float | None) -> None:
    """Keep an inertial reading, and the deviations that the first one states."""
    q, w, a = m.orientation, m.angular_velocity, m.linear_acceleration
    attitude = None if m.orientation_covariance[0] == -1 else (q.w, q.x, q.y, q.z)
    time = seconds(m.header.stamp) if stamp is None else stamp
    if not contents.imu:
        variances = m.angular_velocity_covariance[0], m.linear_acceleration_covariance[0]
        contents.imu_sigmas = math.sqrt(max(0.0, variances[0])), math.sqrt(max(0.0, variances[1]))
    contents.imu.append(_Reading(m.header.frame_id, time, attitude, (w.x, w.y, w.z), (a.x, a.y, a.z)))


def _odometry(line: int, message: Any, stamp: float | None) -> Message:
    pose = message.pose.pose
    time = seconds(message.header.stamp) if stamp is None else stamp
    return Message(line, time, pose_of(pose.position, pose.orientation).to_pose2())


def _number_by_stamp(scans: list[Message], odoms: list[Message]) -> tuple[list[Message], list[Message]]:
    """Renumber messages by stamp if the stamps of each topic rise.

    Topics arrive with different delays.
    """

    def rises(found: list[Message]) -> bool:
        return all(a.stamp < b.stamp for a, b in pairwise(found))

    if not (rises(scans) and rises(odoms)):
        return scans, odoms
    order = sorted([*odoms, *scans], key=lambda m: m.stamp)
    numbered = [Message(k, m.stamp, m.base, m.laser, m.ranges, m.config) for k, m in enumerate(order)]
    return [m for m in numbered if len(m.ranges)], [m for m in numbered if not len(m.ranges)]


def _scan(beams: BeamGeometry, message: Message, mount: Pose3) -> LaserScan:
    first, step, range_min, range_max = geometry(beams, len(message.ranges))
    return LaserScan(
        message.ranges, first, step, range_min, range_max, message.stamp, mount, beams.time_increment
    )


def _inertial(c: _Contents, mounts: Mapping[str, Pose3]) -> ImuReadings:
    """Return all readings in the base's axes, by stamp; of equal stamps the first."""
    stamps, first = np.unique([reading.stamp for reading in c.imu], return_index=True)
    chosen = [c.imu[k] for k in first]
    rates = np.array([_rotate(mounts[reading.frame], reading.rates) for reading in chosen])
    force = np.array([_rotate(mounts[reading.frame], reading.force) for reading in chosen])
    return ImuReadings(stamps, rates, force, *c.imu_sigmas)


def _imu(reading: _Reading, mounted: Pose3) -> Imu:
    """Convert a reading with attitude to the base's axes by the sensor's mount."""
    assert reading.attitude is not None, "left out before"
    attitude, rates, force = _unit(reading.attitude), reading.rates, reading.force
    if mounted.qw != 1.0:
        unmounted = Pose3(0, 0, 0, mounted.qw, mounted.qx, mounted.qy, mounted.qz).inverse()
        attitude = attitude @ unmounted
        rates, force = _rotate(mounted, rates), _rotate(mounted, force)
    return Imu(attitude.roll, attitude.pitch, rates, force, reading.stamp)


def _unit(q: tuple[float, float, float, float]) -> Pose3:
    n = math.sqrt(sum(part * part for part in q)) or 1.0
    return Pose3(0.0, 0.0, 0.0, q[0] / n, q[1] / n, q[2] / n, q[3] / n)


def _rotate(mounted: Pose3, vector: Vector) -> Vector:
    x, y, z = (mounted.rotation @ vector).tolist()
    return x, y, z


BASES = (BASE, "base_footprint")
"""Names of a robot's base frame; the first existing one is used."""


def read_poses(path: Path, topic: str | None = None, flag: str = "--topic") -> Trajectory:
    """Read the trajectory that a bag holds.

    Args:
        path: of the bag.
        topic: of odometry, stamped poses or paths, of which the last counts, or of transforms, whose map ->
            base_link is taken; None = transforms if they lead to a frame `map`, else the only topic of poses.
        flag: command-line option of the topic, for messages.

    Raises:
        SourceError: the bag cannot be read, or has no such topic, or several could be meant.
    """
    with open_bag(path) as bag:
        trajectory = _poses(bag, topic, flag)
    if bag.faults:
        said = f"{len(trajectory)} poses could be read"
        warnings.warn(f"{path}: damaged ({'; '.join(bag.faults)}): {said}", stacklevel=2)
    if len(trajectory) == 0:
        raise SourceError(f"{path}: {topic or 'it'} holds no pose")
    return trajectory


def _poses(bag: Bag, topic: str | None, flag: str) -> Trajectory:
    if topic is not None:
        require_topic(bag.path, flag, topic, (*POSES, *TRANSFORMS), bag.kinds)
        if bag.kinds[topic] in TRANSFORMS:
            return _follow_transforms(bag, required=True) or _nothing()
        return _read_topic(bag, topic)
    found = of_kinds(bag.kinds, POSES)
    in_map = _follow_transforms(bag, required=not found)
    if in_map is not None:
        return in_map
    if len(found) != 1:
        raise SourceError(f"{bag.path}: {flag} must say where its poses are; {list_topics(bag.kinds)}")
    return _read_topic(bag, found[0])


def _follow_transforms(bag: Bag, *, required: bool) -> Trajectory | None:
    """Return `T_map_base` along the bag's transforms; None if they do not connect the two.

    Raises:
        SourceError: they do not connect the two although this is required.
    """
    frames = Frames()
    topics = of_kinds(bag.kinds, TRANSFORMS)
    for line, (topic, _, message) in enumerate(bag.messages(topics)):
        frames.add(line, message, static=topic.endswith("tf_static"))
    for base in (name for wanted in BASES for name in sorted(frames.names) if _is(name, wanted)):
        if _is(frames.chain(base)[-1], MAP):
            return frames.trajectory(base)
    if required:
        held = ", ".join(sorted(frames.names)) or "none"
        raise SourceError(
            f"{bag.path}: its transforms do not lead from {MAP} to {' or '.join(BASES)}: its frames are "
            f"{held}; {list_topics(bag.kinds)}"
        )
    return None


def _is(frame: str, wanted: str) -> bool:
    """Whether a frame has a name, with or without a robot's prefix."""
    return frame.rpartition("/")[2] == wanted


def _read_topic(bag: Bag, topic: str) -> Trajectory:
    """Return the poses of a topic by stamp; of equal stamps, the later one."""
    found: dict[float, Pose3] = {}
    for _, _, message in bag.messages((topic,)):
        if bag.kinds[topic] == PATH:
            found = {}
        for each in message.poses if bag.kinds[topic] == PATH else (message,):
            pose = _innermost(each.pose)
            found[seconds(each.header.stamp)] = pose_of(pose.position, pose.orientation)
    stamps = sorted(found)
    return Trajectory.from_poses(stamps, [found[t] for t in stamps]) if stamps else _nothing()


def _innermost(pose: Any) -> Any:
    """Return the pose inside a PoseWithCovariance, else the pose itself."""
    return getattr(pose, "pose", pose)


def _nothing() -> Trajectory:
    return Trajectory.from_poses([], list[Pose3]())
