"""Reading of a log, and of what comes with it: inertial readings, relations and trajectories."""

from __future__ import annotations

import codecs
import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from lirs_validation.config import MapConfig
from lirs_validation.experiment.mapper_under_test import MapperUnderTest
from lirs_validation.metrics.mapped_log import RelativePoseConstraint
from lirs_validation.metrics.trajectory import MAX_GAP, associated
from lirs_wct import ConfigError, FloatArray, Imu, Pose2, SourceError, Trajectory
from lirs_wct.files import read_gzipped, readable_lines
from lirs_wct.formats.carmen_log import read_carmen
from lirs_wct.formats.drive_files import read_imu, read_mount, read_tum
from lirs_wct.formats.laser_log import LaserLog, LineStamps
from lirs_wct.formats.rosbag.topics import Topics
from lirs_wct.sources.source import is_bag
from slam_baselines.mapper import ALL_CLOUD_MAPPERS, MAPPERS

Truth = tuple[tuple[RelativePoseConstraint, ...] | None, Trajectory | None]
"""True relations and reference trajectory of a log; None where they are not given."""


def read_log(config: MapConfig, *, clouds: bool = False) -> LaserLog:
    """Read the log with the config's laser options; of a bag, clouds if requested."""
    path = Path(config.log)
    topics = (config.scan_topic, config.odom_topic, config.imu_topic)
    if is_bag(path):
        if config.fov is not None:
            raise ConfigError(f"{path}: the messages of a bag say their field of view themselves")
        from lirs_wct.formats.rosbag.reader import read_bag

        others = ", ".join(MAPPERS if clouds else ALL_CLOUD_MAPPERS)
        names = Topics(*topics, clouds, others)
        return read_bag(path, names, range_max=config.range_max, time=config.time)
    if any(topics) or config.time != "header":
        raise ConfigError(f"{path}: topics and --time can be given for a ROS bag only, this is none")
    fov = None if config.fov is None else math.radians(config.fov)
    return read_carmen(path, fov=fov, range_max=config.range_max)


def check_log(config: MapConfig, mapper: MapperUnderTest, log: LaserLog) -> None:
    """Check that a log holds the data that the mapper needs."""
    if mapper.reads_clouds:
        if mapper.reads_inertial and log.inertial is None:
            raise SourceError(
                f"{config.log}: {config.mapper} needs inertial readings: name their topic by --imu-topic"
            )
        return
    if not any(scan.hits.any() for scan in log.scans):
        raise SourceError(f"{config.log}: none of its {len(log.scans)} scans met anything within range")
    if mapper.requires_odometry and log.odometry[0] is None:
        raise SourceError(
            f"{config.log}: holds no odometry (or one that never changes), {config.mapper} needs it; "
            "hector maps without"
        )


def inertial_readings(config: MapConfig, log: LaserLog) -> list[Imu | None]:
    """Return the inertial reading at each scan; None without one within 0.02 s."""
    readings: list[Imu | None] = [None] * len(log.stamps)
    held = log.imu if config.imu is None else read_imu(Path(config.imu))
    if not held:
        return readings
    found = sorted(held, key=lambda reading: reading.stamp)
    stamps = np.array([reading.stamp for reading in found])
    for scan, reading in zip(*associated(log.stamps, stamps), strict=True):
        readings[scan] = found[reading]
    if not any(readings):
        raise SourceError(
            f"{config.imu or config.imu_topic}: other stamps: none of its {len(found)} readings lies "
            f"within {MAX_GAP} s of one of the log's {len(log.stamps)} scans"
        )
    return readings


def with_recorded_mount(config: MapConfig, log: LaserLog) -> LaserLog:
    """Return the log with the laser's mount of the comment, height and tilt included."""
    T_base_laser = read_mount(Path(config.log))
    if T_base_laser is None:
        return log
    return replace(log, scans=tuple(replace(scan, T_base_laser=T_base_laser) for scan in log.scans))


def read_truth(config: MapConfig) -> Truth:
    """Read the relations and the reference trajectory, where they are given."""
    relations, reference = config.relations, config.reference
    return (
        None if relations is None else read_constraints(Path(relations)),
        None if reference is None else read_reference(Path(reference)),
    )


def read_constraints(path: Path) -> tuple[RelativePoseConstraint, ...]:
    """Read `stamp1 stamp2 x y z roll pitch yaw` lines, gzipped or not."""
    data = read_gzipped(path)
    try:
        lines = [line.split() for line in data.decode().splitlines()]
        rows = [[float(field) for field in line] for line in lines if line and line[0][0] != "#"]
    except ValueError as error:
        raise SourceError(f"{path}: not readable as relations: {error}") from error
    if not rows:
        raise SourceError(f"{path}: holds no relation (stamp1 stamp2 x y z roll pitch yaw)")
    if any(len(row) != 8 or not np.isfinite(row).all() for row in rows):
        raise SourceError(f"{path}: a relation needs 8 numbers (stamp1 stamp2 x y z roll pitch yaw)")
    return tuple(RelativePoseConstraint(r[0], r[1], Pose2(r[2], r[3], r[7])) for r in rows)


def read_trajectory(path: Path, scans: FloatArray | None = None) -> Trajectory:
    """Read a trajectory from a TUM, EuRoC or KITTI file, or a bag.

    A bag holds transforms from map to base_link, or a topic of poses; BAG:/TOPIC names it. A KITTI file lacks
    the stamps of the scans (n,), seconds.
    """
    path, topic = _split_topic(path)
    if is_bag(path):
        from lirs_wct.formats.rosbag.frames import read_poses

        return read_poses(path, topic)
    if topic is not None:
        raise ConfigError(f"{path}: a topic can be given for a ROS bag only, this is none")
    return read_tum(path, scans)


def _split_topic(path: Path) -> tuple[Path, str | None]:
    """Return bag and topic of a text such as `run.mcap:/pose`."""
    bag, colon, topic = str(path).partition(":/")
    return (path, None) if not colon or path.exists() else (Path(bag), f"/{topic}")


def read_reference(path: Path) -> Trajectory:
    """Read a reference trajectory.

    The file is a TUM or EuRoC file, a bag or BAG:/TOPIC, or a CARMEN log with corrected poses (as of a pose
    graph's nodes).
    """
    bag, topic = _split_topic(path)
    if is_bag(bag) or topic is not None:
        return read_trajectory(path)
    if _begins_with_a_number(path):
        return read_tum(path)
    track = read_carmen(path).track
    if len(track) == 0:
        raise SourceError(f"{path}: holds no poses that change, a reference trajectory does")
    return track


def _begins_with_a_number(path: Path) -> bool:
    """Return whether a file begins with a number, after comments."""
    for line in readable_lines(path):
        tokens = line.removeprefix(codecs.BOM_UTF8).replace(b",", b" ").split(None, 1)
        if tokens and not tokens[0].startswith(b"#"):
            try:
                float(tokens[0])
            except ValueError:
                return False
            return True
    return False


def truth_in_time(truth: Truth, lines: LineStamps) -> Truth:
    """Return relations and reference with repaired stamps instead of logged ones.

    Of reference poses with the same stamp, the first stays.
    """
    relations, reference = truth
    if lines.moved and relations:
        logged = np.array([(r.stamp_a, r.stamp_b) for r in relations])
        pairs = zip(relations, lines.repaired_at(logged).tolist(), strict=True)
        relations = tuple(replace(relation, stamp_a=a, stamp_b=b) for relation, (a, b) in pairs)
    if lines.moved and reference is not None:
        stamps, first = np.unique(lines.repaired_at(reference.stamps), return_index=True)
        reference = Trajectory(stamps, reference.positions[first], reference.quaternions[first])
    return relations, reference
