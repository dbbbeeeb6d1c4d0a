"""Reading a ROS 2 or ROS 1 bag as a laser log.

The log has scans, their odometry, inertial readings and the laser's mount.
"""

from __future__ import annotations

import math
import warnings
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lirs_wct.errors import SourceError
from lirs_wct.formats import Clock, range_codes
from lirs_wct.formats.laser_log import LaserLog, LineStamps, LogTopic, Message, in_file_order, odometry_of
from lirs_wct.formats.rosbag.frames import Frames, Step, is_finite, one_source, pose_of, seconds
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
from lirs_wct.formats.rosbag.topics import ODOMETRY, TRANSFORMS, Topics, list_topics, of_kinds, of_robot
from lirs_wct.geometry import Imu, ImuReadings, LaserScan, Pose3, Trajectory

Vector = tuple[float, float, float]


MIN_COMMON_TIME = 0.1
"""Smallest time that topics share, of the shorter one's."""
MAX_LATE_SHARE, GAP_PERIODS, STAMP_STEP = 0.01, 1.5, 1e-6
"""Largest share of late messages; length of the gap of one, in periods; seconds between equal stamps."""
MAX_EDGE = 0.5
"""Longest time from a scan to the first or last pose of the odometry, seconds."""
MIN_TILT = math.radians(0.5)
"""Smallest roll or pitch of the odometry by which scans are leveled."""
MAX_MOUNT_DISTANCE = 30.0
"""Largest distance of a laser from the base, meters."""
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

    names: tuple[str, str | None, str | None]
    clouds: bool
    lasers: list[str] = field(default_factory=list)
    scans: list[Message] = field(default_factory=list)
    beams: list[BeamGeometry] = field(default_factory=list)
    odometry: list[Step] = field(default_factory=list)
    odometry_frames: tuple[str, str] = ("", "")
    imu: list[_Reading] = field(default_factory=list)
    imu_sigmas: tuple[float, float] = (0.0, 0.0)
    frames: Frames = field(default_factory=Frames)
    received: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    skipped: Counter[str] = field(default_factory=Counter)
    left_out: int = 0
    repaired: Counter[str] = field(default_factory=Counter)

    @property
    def stamps(self) -> tuple[list[float], ...]:
        """Stamps of the scans, of the odometry and of the inertial readings, seconds."""
        return [m.stamp for m in self.scans], [m[1] for m in self.odometry], [m.stamp for m in self.imu]

    def add_scan(self, line: int, m: Any, stamp: float) -> bool:
        """Keep a scan with its stated beam geometry; count a scan without one."""
        ranges = ranges_of(m)
        beams = beams_of(m, len(ranges)) if len(ranges) else None
        if beams is None:
            why = "whose angle_min, angle_max, angle_increment disagree" if len(ranges) else "without beams"
            self.skipped[f"scan {why}"] += 1
            self.left_out += 1
            return False
        if not math.isfinite(m.time_increment):
            self.repaired[f"time_increment {m.time_increment:g}: 0 is taken"] += 1
        if beams.step != m.angle_increment:
            self.repaired[f"angle_increment {m.angle_increment:g}: derived from angle_min, angle_max"] += 1
        self.lasers.append(m.header.frame_id)
        self.scans.append(Message(line, stamp, None, None, ranges))
        self.beams.append(beams)
        return True

    def add_cloud(self, line: int, m: Any, stamp: float) -> bool:
        """Keep the start time of a cloud's sweep without the points; count unusable clouds."""
        records = records_of(m)
        if records is None:
            self.skipped["cloud without legal x, y, z, or shorter than it states"] += 1
            self.left_out += 1
            return False
        self.lasers.append(m.header.frame_id)
        start = stamp + start_of(records, seconds(m.header.stamp))
        self.scans.append(Message(line, start, None, None, CLOUD_MARK))
        return True

    def add_odometry(self, line: int, m: Any, stamp: float) -> bool:
        """Keep a pose of the odometry; count one that is not finite."""
        T = pose_of(m.pose.pose.position, m.pose.pose.orientation)
        if not is_finite(T):
            self.skipped["pose that is not finite"] += 1
            return False
        self.odometry_frames = m.header.frame_id.lstrip("/"), m.child_frame_id.lstrip("/")
        self.odometry.append((line, stamp, T))
        return True

    def add_reading(self, _: int, m: Any, stamp: float) -> bool:
        """Keep an inertial reading, and the deviations that the first one states."""
        q, w, a = m.orientation, m.angular_velocity, m.linear_acceleration
        attitude = None if m.orientation_covariance[0] == -1 else (q.w, q.x, q.y, q.z)
        if not math.isfinite(sum((q.w, q.x, q.y, q.z, w.x, w.y, w.z, a.x, a.y, a.z))):
            self.skipped["inertial reading that is not finite"] += 1
            return False
        if not self.imu:
            variances = m.angular_velocity_covariance[0], m.linear_acceleration_covariance[0]
            self.imu_sigmas = math.sqrt(max(0.0, variances[0])), math.sqrt(max(0.0, variances[1]))
        self.imu.append(_Reading(m.header.frame_id, stamp, attitude, (w.x, w.y, w.z), (a.x, a.y, a.z)))
        return True


def read_bag(
    path: Path, topics: Topics, *, range_max: float | None = None, time: Clock = "header"
) -> LaserLog:
    """Read a bag; of a damaged one the readable part, with a warning.

    The path is a folder of a ROS 2 bag, one of its files (.mcap, .db3, also .zstd), or a ROS 1 bag (.bag).
    From `range_max` on, meters, ranges are no return; by default as the readings show. Stamps are times of
    reception also where headers are of no use.
    """
    with open_bag(path) as bag:
        try:
            contents = _contents(bag, topics, by_header=time == "header")
            fault = _time_fault(contents) if time == "header" else ""
            if fault:
                bag.undecoded.clear()
                stamps, received = contents.stamps[0], contents.received[contents.names[0]]
                lag = float(np.median(np.subtract(received, stamps))) if len(set(stamps)) > 1 else 0.0
                contents = _contents(bag, topics, by_header=False, lag=lag)
                contents.repaired[f"{fault}: times of reception are taken"] = len(contents.scans)
        except SourceError as error:
            damaged = f" (damaged: {'; '.join(bag.faults)})" if bag.faults else ""
            raise SourceError(f"{error}{damaged}") from None
    for topic, count in bag.undecoded.items():
        contents.skipped[f"message on {topic} that cannot be decoded"] = count
        contents.left_out += count if topic == contents.names[0] else 0
    if bag.faults:
        said = f"{len(contents.scans)} {'clouds' if topics.clouds else 'scans'} could be read"
        warnings.warn(f"{path}: damaged ({'; '.join(bag.faults)}): {said}", stacklevel=2)
    if not contents.scans:
        why = "; ".join(f"{count} x {reason}" for reason, count in contents.skipped.items())
        kind = "point cloud" if topics.clouds else "laser scan"
        raise SourceError(f"{path}: holds no {kind} that can be used" + (f" ({why})" if why else ""))
    return _log(path, contents, range_max)


def _time_fault(contents: _Contents) -> str:
    """Return why the header stamps are of no use; empty if they are."""
    scans, *others = contents.stamps
    if any(len(stamps) > 1 and len(set(stamps)) == 1 for stamps in (scans, others[0])):
        return "header stamps all the same"  # 0 with some drivers
    for name, stamps in zip(("odometry", "inertial readings"), others, strict=True):
        if scans and stamps and _common(scans, stamps) < MIN_COMMON_TIME:
            return f"scans and {name} share no time by their headers"
    return ""


def _common(a: Sequence[float], b: Sequence[float]) -> float:
    """Return the seconds that two topics share, as a share of the shorter one."""
    few = 0 if all((np.diff(stamps) >= 0).all() for stamps in (a, b)) else 1  # percent with damaged stamps
    (a0, a1), (b0, b1) = (np.percentile(stamps, (few, 100 - few)).tolist() for stamps in (a, b))
    shorter = min(a1 - a0, b1 - b0)
    return (min(a1, b1) - max(a0, b0)) / shorter if shorter > 0 else float(a0 <= b1 and b0 <= a1)


def _contents(bag: Bag, topics: Topics, *, by_header: bool, lag: float = 0.0) -> _Contents:
    """Return the messages of the topics, in the order of the bag.

    Without `by_header`, stamps are times of reception. The lag is that of the scans' clock to that of
    reception, seconds; unless it is 0, scans keep their stamps.
    """
    scan, odometry, imu = names = topics.choose(bag.path, bag.kinds)
    contents = _Contents(names, topics.clouds)
    transforms = of_robot(scan, of_kinds(bag.kinds, TRANSFORMS))
    static = {name for name in transforms if name.endswith("tf_static")}
    wanted = {scan, odometry, imu, *(static if odometry else transforms)} - {None}
    add = {
        imu: contents.add_reading,
        odometry: contents.add_odometry,
        scan: contents.add_cloud if topics.clouds else contents.add_scan,
    }
    for line, (topic, received, message) in enumerate(bag.messages(wanted)):
        stamp = None if by_header else received / 1e9 - lag
        if topic not in add:
            contents.frames.add(line, message, static=topic in static, received=stamp)
            continue
        if stamp is None or (topic == scan and lag):
            stamp = seconds(message.header.stamp)
        if add[topic](line, message, stamp):
            contents.received[topic].append(received / 1e9)
    base, lasers = contents.odometry_frames[1], set(contents.lasers)
    unplaced = not base or any(contents.frames.mounts(base, laser, ()) is None for laser in lasers)
    if odometry and contents.scans and (not contents.odometry or unplaced):  # only /tf can tell
        for line, (_, received, message) in enumerate(bag.messages(set(transforms) - static)):
            stamp = None if by_header else received / 1e9 - lag
            contents.frames.add(line, message, static=False, received=stamp)
    if not contents.odometry and contents.scans:
        base = contents.frames.base(contents.lasers[0])
        contents.odometry, parent = contents.frames.odometry(base)
        contents.odometry_frames = parent, base
        if not contents.odometry and odometry is None and len(of_kinds(bag.kinds, (ODOMETRY,))) > 1:
            raise SourceError(f"{bag.path}: --odom-topic must say which; {list_topics(bag.kinds)}")
    if contents.frames.skipped:
        contents.skipped["transform that is not finite"] = contents.frames.skipped
    for frame in sorted(contents.frames.disputed):
        contents.repaired[f"static transforms of {frame} differ: the last one is taken"] = 1
    return contents


def _log(path: Path, c: _Contents, range_max: float | None) -> LaserLog:
    base = _base(c)
    steps, sources = one_source(c.odometry)
    if sources > 1:
        said = f"{' -> '.join(c.odometry_frames)} has two sources: the one with more poses is taken"
        c.repaired[said] = len(c.odometry) - len(steps)
    odometry = [Message(line, stamp, T.to_pose2()) for line, stamp, T in steps]
    topics = _topics(c)
    scans, odoms, stamps = in_file_order(*_in_time(c, odometry))
    if stamps.moved:
        warnings.warn(f"{path}: {stamps.summary()}", stacklevel=3)
    poses, track = odometry_of(scans, odoms)
    mounts = _leveled(c, steps, _mounts(path, c, base, [m.stamp for m in scans]), [m.stamp for m in scans])
    clouds = BagClouds(path, c.names[0], tuple(m.stamp for m in scans), tuple(mounts)) if c.clouds else None
    sensors = {frame: c.frames.mounts(base, frame, (0.0,)) for frame in {reading.frame for reading in c.imu}}
    turned = {frame: Pose3() if mount is None else mount[0] for frame, mount in sensors.items()}
    tilted = [reading for reading in c.imu if reading.attitude is not None]
    if len(tilted) < len(c.imu) and not c.clouds:
        c.skipped["inertial reading without an attitude"] = len(c.imu) - len(tilted)
    log = LaserLog(
        () if c.clouds else tuple(_scans(path, c, scans, mounts, range_max)),
        tuple(poses),
        track,
        stamps,
        skipped=dict(c.skipped),
        repaired=dict(c.repaired),
        laser="PointCloud2" if c.clouds else "LaserScan",
        clouds=clouds,
        left_out=c.left_out,
        imu=tuple(_imu(reading, turned[reading.frame]) for reading in tilted),
        inertial=_inertial(c, turned) if c.imu else None,
        topics=topics,
    )
    return log if c.clouds else _within_odometry(log)


def _base(c: _Contents) -> str:
    """Return the odometry's base frame if transforms lead from it to the laser, else another."""
    own, other = c.odometry_frames[1], c.frames.base(c.lasers[0])
    if own in ("", other) or c.frames.mounts(own, c.lasers[0], ()) is not None or not other:
        return own or other
    why = f"odometry of {own}, from which no transforms lead to the laser: taken for that of {other}"
    c.repaired[why] = 1
    return other


def _mounts(path: Path, c: _Contents, base: str, stamps: Sequence[float]) -> list[Pose3]:
    """Return `T_base_laser` at each scan; the scans of a topic may come from several lasers."""
    by_laser: dict[str, list[Pose3]] = {}
    for laser in sorted(set(c.lasers)):
        mounts = c.frames.mounts(base, laser, stamps)
        away = max((float(np.linalg.norm(T.position)) for T in mounts or ()), default=0.0)
        if away > MAX_MOUNT_DISTANCE:
            raise SourceError(f"{path}: transforms place {laser} {away:.4g} m from {base}: millimeters?")
        if mounts is None:
            edge = f"{base or 'the base'} to {laser}"
            why = f"no transform from {edge}: the laser is taken to be at the base"
            c.repaired[why] = c.lasers.count(laser)
        by_laser[laser] = mounts or [Pose3()] * len(stamps)
    if len(by_laser) > 1:
        c.repaired[f"scans of several lasers on {c.names[0]}: {', '.join(by_laser)}"] = len(stamps)
    return [by_laser[laser][k] for k, laser in enumerate(c.lasers)]


def _leveled(c: _Contents, steps: list[Step], mounts: list[Pose3], stamps: list[float]) -> list[Pose3]:
    """Return the mounts on the leveled base where the odometry tilts, unless an IMU has the attitude."""
    tilts = np.array([(T.roll, T.pitch) for _, _, T in steps]).reshape(-1, 2)
    if c.imu or np.abs(tilts).max(initial=0.0) < MIN_TILT:
        return mounts
    most = math.degrees(float(np.abs(tilts).max()))
    c.repaired[f"the odometry tilts by up to {most:.1f} deg: scans are leveled by it"] = len(mounts)
    roll, pitch = (np.interp(stamps, [t for _, t, _ in steps], tilt).tolist() for tilt in tilts.T)
    level = [Pose3.from_rpy(0.0, 0.0, 0.0, *angles, 0.0) for angles in zip(roll, pitch, strict=True)]
    return [T_level_base @ T for T_level_base, T in zip(level, mounts, strict=True)]


def _scans(
    path: Path, c: _Contents, messages: list[Message], mounts: list[Pose3], range_max: float | None
) -> list[LaserScan]:
    """Return the scans, with the codes of each laser decoded."""
    decoders = {}
    for laser in dict.fromkeys(c.lasers):
        own = [k for k, each in enumerate(c.lasers) if each == laser]
        try:
            *_, shortest, farthest = geometry(c.beams[own[0]], len(messages[own[0]].ranges))
            decoders[laser] = range_codes.RangeDecoder(
                [messages[k].ranges for k in own], (shortest, farthest), range_max
            )
        except ValueError as error:
            raise SourceError(f"{path}: {c.names[0]} has {error}") from None
        for code in decoders[laser].codes:
            c.repaired[code] += len(own)
    scans = []
    for m, beams, mount, laser in zip(messages, c.beams, mounts, c.lasers, strict=True):
        first, step, range_min, _ = geometry(beams, len(m.ranges))
        ranges, farthest = decoders[laser].decode(m.ranges), decoders[laser].farthest
        scans.append(
            LaserScan(ranges, first, step, range_min, farthest, m.stamp, mount, beams.time_increment)
        )
    return scans


def _within_odometry(log: LaserLog) -> LaserLog:
    """Return a log without the scans before or after its odometry, whose poses are unknown."""
    if len(log.track) < 2:
        return log
    stamps, track = log.stamps, log.track.stamps
    most = max(MAX_EDGE, 2 * float(np.median(np.diff(track))))
    inside = (stamps >= track[0] - most) & (stamps <= track[-1] + most)
    if inside.all():
        return log
    if not inside.any():
        why = "scans and odometry share no time: the odometry is left out"
        nothing = Trajectory.from_poses([], list[Pose3]())
        unknown = (None,) * len(log.odometry)
        return replace(log, odometry=unknown, track=nothing, repaired={**log.repaired, why: len(unknown)})
    kept = np.flatnonzero(inside).tolist()
    lines = log.lines
    used = ~lines.scans
    used[np.flatnonzero(lines.scans)[inside]] = True
    return replace(
        log,
        scans=tuple(log.scans[k] for k in kept),
        odometry=tuple(log.odometry[k] for k in kept),
        lines=LineStamps(lines.logged[used], lines.repaired[used], lines.scans[used]),
        skipped={**log.skipped, "scan before or after the odometry": len(stamps) - len(kept)},
    )


def _topics(c: _Contents) -> tuple[LogTopic, ...]:
    """Return the topics of scans, odometry and inertial readings, with the stamps as recorded."""
    edge = " -> ".join(c.odometry_frames)
    frames = (tuple(sorted(set(c.lasers))), (edge,), tuple(sorted({r.frame for r in c.imu})))
    names = (c.names[0], c.names[1] or "/tf", c.names[2] or "")
    return tuple(
        LogTopic(name, frame, np.array(stamps), np.array(c.received.get(name, ())))
        for name, frame, stamps in zip(names, frames, c.stamps, strict=True)
        if stamps
    )


def _in_time(c: _Contents, odometry: list[Message]) -> tuple[list[Message], list[Message]]:
    """Return scans and odometry numbered by stamp, unless a clock was set.

    Topics arrive with different delays, a few messages late or twice. Of poses with equal stamps the last
    counts; of scans with equal stamps the later ones get the next microsecond.
    """
    mixed = c.clouds and any(a.stamp >= b.stamp for a, b in pairwise(c.scans))  # they are read in this order
    if mixed or not all(map(_may_be_sorted, (c.scans, odometry))):
        return c.scans, odometry
    order = np.argsort([m.stamp for m in c.scans], kind="stable").tolist()
    if not c.clouds:
        c.beams = [c.beams[k] for k in order]
    c.lasers = [c.lasers[k] for k in order]
    scans: list[Message] = []
    for k in order:
        least = scans[-1].stamp + STAMP_STEP if scans else -math.inf
        scans.append(replace(c.scans[k], stamp=max(c.scans[k].stamp, least)))
    lines = sorted([*{m.stamp: m for m in odometry}.values(), *scans], key=lambda m: m.stamp)
    numbered = [replace(m, line=k) for k, m in enumerate(lines)]
    return [m for m in numbered if len(m.ranges)], [m for m in numbered if not len(m.ranges)]


def _may_be_sorted(topic: list[Message]) -> bool:
    """Whether messages that come too late are few and fill gaps, and have no damaged stamps."""
    stamps = np.array([m.stamp for m in topic])
    late = stamps < np.maximum.accumulate(stamps)
    if not late.any():
        return True
    long = GAP_PERIODS * float(np.median(np.diff(np.sort(stamps))))
    holes, before = ((np.diff(np.sort(found)) > long).sum() for found in (stamps, stamps[~late]))
    return bool(late.sum() <= max(1, MAX_LATE_SHARE * len(topic)) and holes < before)


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
    n = math.sqrt(sum(part * part for part in reading.attitude)) or 1.0
    attitude = Pose3(0.0, 0.0, 0.0, *(part / n for part in reading.attitude))
    rates, force = reading.rates, reading.force
    if mounted.qw != 1.0:
        unmounted = Pose3(0, 0, 0, mounted.qw, mounted.qx, mounted.qy, mounted.qz).inverse()
        attitude = attitude @ unmounted
        rates, force = _rotate(mounted, rates), _rotate(mounted, force)
    return Imu(attitude.roll, attitude.pitch, rates, force, reading.stamp)


def _rotate(mounted: Pose3, vector: Vector) -> Vector:
    x, y, z = (mounted.rotation @ vector).tolist()
    return x, y, z
