"""Bags as read: what was written comes back, from every kind of bag, and damage is said."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="the extra [ros] is not installed")

from lirs_wct.errors import SourceError
from lirs_wct.formats.laser_log import LaserLog
from lirs_wct.formats.rosbag.library import STORAGES, Storage
from lirs_wct.formats.rosbag.reader import read_bag
from lirs_wct.formats.rosbag.topics import Topics
from lirs_wct.formats.rosbag.writer import Drive, write_bag
from lirs_wct.sources.source import is_log
from tests.lirs_wct.formats.rosbag import drives

IMU = Topics(imu="/imu")


@pytest.fixture(scope="module")
def given() -> Drive:
    return drives.drive(400)


@pytest.fixture(scope="module")
def bag(given: Drive, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bags") / "run"
    write_bag(folder, given)
    return folder


def check(log: LaserLog, given: Drive) -> None:
    assert len(log.scans) == len(given.ticks)
    for scan, tick in zip(log.scans, given.ticks, strict=True):
        wanted = tick.scan
        np.testing.assert_array_equal(scan.ranges, wanted.ranges)
        np.testing.assert_allclose(scan.angles, wanted.angles, atol=2e-7)
        assert scan.stamp == pytest.approx(wanted.stamp, abs=1e-9)
        assert (scan.range_min, scan.range_max) == (0.1, 30.0)
        np.testing.assert_allclose(scan.T_base_laser.quaternion, drives.MOUNT.quaternion)
        np.testing.assert_allclose(scan.T_base_laser.position, drives.MOUNT.position)
    for pose, tick in zip(log.odometry, given.ticks, strict=True):
        assert pose is not None
        np.testing.assert_allclose(pose.as_array(), tick.odometry.as_array(), atol=1e-9)


@pytest.mark.parametrize("storage", STORAGES)
def test_what_was_written_comes_back(given: Drive, tmp_path: Path, storage: Storage) -> None:
    write_bag(tmp_path / "run", given, storage)
    assert is_log(tmp_path / "run")
    (file,) = (p for p in (tmp_path / "run").iterdir() if p.suffix in (".mcap", ".db3"))
    for path in (tmp_path / "run", file):
        log = read_bag(path, IMU)
        check(log, given)
        for reading, wanted in zip(log.imu, [tick.imu for tick in given.ticks], strict=True):
            assert (reading.roll, reading.pitch) == pytest.approx((wanted.roll, wanted.pitch), abs=1e-12)
            assert reading.angular_velocity == pytest.approx(wanted.angular_velocity)
            assert reading.linear_acceleration == pytest.approx(wanted.linear_acceleration)


def test_ros_1_bags_are_read(bag: Path, given: Drive, tmp_path: Path) -> None:
    from rosbags.convert.converter import convert
    from rosbags.typesys import Stores, get_typestore

    target = tmp_path / "run.bag"
    convert([bag], target, "", 0, None, "none", None, get_typestore(Stores.ROS1_NOETIC), (), (), (), ())
    check(read_bag(tmp_path / "run.bag", IMU), given)


def test_a_bag_without_metadata_is_read_from_its_files(bag: Path, given: Drive, tmp_path: Path) -> None:
    shutil.copytree(bag, tmp_path / "run")
    (tmp_path / "run" / "metadata.yaml").unlink()
    check(read_bag(tmp_path / "run", IMU), given)


def test_missing_topics_list_those_that_are_there(bag: Path) -> None:
    with pytest.raises(SourceError, match=r"--scan-topic /laser: .*/scan \(sensor_msgs/msg/LaserScan\), /tf"):
        read_bag(bag, Topics(scan="/laser"))
    with pytest.raises(SourceError, match="--imu-topic /odom: no topic of sensor_msgs/msg/Imu"):
        read_bag(bag, Topics(imu="/odom"))


def test_what_is_no_bag_is_one_line(tmp_path: Path) -> None:
    for name, content in (("a.mcap", b""), ("b.db3", b"no database" * 99), ("c.bag", b"#ROSBAG V2.0\n")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(SourceError, match=f"{name}: not a bag that can be read") as caught:
            read_bag(tmp_path / name, Topics())
        assert "\n" not in str(caught.value)


def rewritten(
    bag: Path,
    target: Path,
    *,
    without: tuple[str, ...] = (),
    late: int | None = None,
    short: int | None = None,
) -> Path:
    """Copy a bag without some topics; the late-th scan is stamped a second early, the short-th cut."""
    from rosbags.highlevel import AnyReader
    from rosbags.rosbag2 import StoragePlugin, Writer

    scans = 0
    with (
        AnyReader([bag]) as reader,
        Writer(target, version=9, storage_plugin=StoragePlugin.MCAP) as writer,
    ):
        connections = {
            c.topic: writer.add_connection(c.topic, c.msgtype, typestore=reader.typestore)
            for c in reader.connections
            if c.topic not in without
        }
        for connection, stamp, data in reader.messages():
            if connection.topic == "/scan" and (scans := scans + 1) in (late, short):
                message = reader.deserialize(data, connection.msgtype)
                message.header.stamp.sec -= scans == late
                message.ranges = message.ranges[: 5 if scans == short else None]
                data = bytes(reader.typestore.serialize_cdr(message, connection.msgtype))
            if connection.topic in connections:
                writer.write(connections[connection.topic], stamp, data)
    return target


def test_odometry_comes_from_the_frames_where_no_topic_is(bag: Path, given: Drive, tmp_path: Path) -> None:
    check(read_bag(rewritten(bag, tmp_path / "run", without=("/odom",)), IMU), given)


def test_without_odometry_and_frames_the_laser_is_at_the_base(bag: Path, tmp_path: Path) -> None:
    target = rewritten(bag, tmp_path / "run", without=("/odom", "/tf", "/tf_static"))
    log = read_bag(target, Topics())
    assert set(log.odometry) == {None}
    (repair,) = log.repaired
    assert "the laser is taken to be at the base" in repair


def test_a_scan_of_another_size_is_left_out_and_counted(bag: Path, given: Drive, tmp_path: Path) -> None:
    log = read_bag(rewritten(bag, tmp_path / "run", short=7), Topics())
    assert len(log.scans) == len(given.ticks) - 1
    assert log.skipped == {"scan of another number of beams than the first": 1}


def test_stamps_that_go_back_are_repaired_and_said(bag: Path, given: Drive, tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="stamps go back"):
        log = read_bag(rewritten(bag, tmp_path / "run", late=200), Topics())
    stamps = [scan.stamp for scan in log.scans]
    assert (np.diff(stamps) > 0).all()
    np.testing.assert_array_equal(log.scans[199].ranges, given.ticks[199].scan.ranges)
    assert stamps[199] == pytest.approx(
        given.ticks[199].scan.stamp, abs=0.1
    )  # one outlier is shared out among its neighbors
