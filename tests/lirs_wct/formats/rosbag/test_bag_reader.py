"""Bags as read: what was written comes back, from every kind of bag, and damage is said."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.interfaces import Connection
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from lirs_wct.errors import SourceError
from lirs_wct.formats import STORAGES, Storage
from lirs_wct.formats.rosbag.messages import BagDrive
from lirs_wct.formats.rosbag.reader import read_bag
from lirs_wct.formats.rosbag.topics import Topics
from lirs_wct.formats.rosbag.writer import write_bag
from lirs_wct.geometry.pose import Pose3
from lirs_wct.sources.source import is_log
from tests.kit import refused
from tests.lirs_wct.formats.rosbag import drives

IMU = Topics(imu="/imu")


@pytest.fixture(scope="module")
def given() -> BagDrive:
    return drives.drive(100)


@pytest.mark.parametrize("storage", STORAGES)
def test_what_was_written_comes_back(given: BagDrive, tmp_path: Path, storage: Storage) -> None:
    write_bag(tmp_path / "run", given, storage)
    assert is_log(tmp_path / "run")
    (file,) = (p for p in (tmp_path / "run").iterdir() if p.suffix in (".mcap", ".db3"))
    for path in (tmp_path / "run", file):
        log = read_bag(path, IMU)
        drives.check(log, given)
        for reading, wanted in zip(log.imu, [tick.imu for tick in given.ticks], strict=True):
            assert (reading.roll, reading.pitch) == pytest.approx((wanted.roll, wanted.pitch), abs=1e-12)
            assert reading.angular_velocity == pytest.approx(wanted.angular_velocity)
            assert reading.linear_acceleration == pytest.approx(wanted.linear_acceleration)


def test_inertial_readings_without_attitude_come_back(given: BagDrive, tmp_path: Path) -> None:
    write_bag(tmp_path / "run", given)
    found = read_bag(tmp_path / "run", Topics(imu="/imu/data_raw"))
    (skipped,) = (n for why, n in found.skipped.items() if "without an attitude" in why)
    wanted = [tick.inertial for tick in given.ticks if tick.inertial is not None]
    assert (len(found.imu), len(found.inertial)) == (0, skipped)
    np.testing.assert_allclose(found.inertial.stamps, np.concatenate([w.stamps for w in wanted]), atol=1e-9)
    rates = np.concatenate([w.angular_velocity for w in wanted])
    np.testing.assert_array_equal(found.inertial.angular_velocity, rates)
    assert (found.inertial.rate_sigma, found.inertial.acceleration_sigma) == pytest.approx((0.1, 0.2))
    some = found.inertial.between(1.01, 1.04)
    assert ((some.stamps > 1.01) & (some.stamps <= 1.04)).all()
    assert len(some) == ((found.inertial.stamps > 1.01) & (found.inertial.stamps <= 1.04)).sum() > 0


def test_missing_topics_list_those_that_are_there(bag: Path) -> None:
    with pytest.raises(SourceError, match=r"--scan-topic /laser: .*/scan \(sensor_msgs/msg/LaserScan\), /tf"):
        read_bag(bag, Topics(scan="/laser"))
    with pytest.raises(SourceError, match="--imu-topic /odom: no topic of sensor_msgs/msg/Imu"):
        read_bag(bag, Topics(imu="/odom"))


def test_what_is_no_bag_is_one_line(tmp_path: Path) -> None:
    for name, content in (("a.mcap", b""), ("b.db3", b"no database" * 99), ("c.bag", b"#ROSBAG V2.0\n")):
        (tmp_path / name).write_bytes(content)
        with refused(f"{tmp_path / name}: not a bag that can be read"):
            read_bag(tmp_path / name, Topics())
    with pytest.raises(SourceError, match=r"none\.bag: no such file or folder$"):
        read_bag(tmp_path / "none.bag", Topics())


def rewritten(
    bag: Path,
    target: Path,
    *,
    without: tuple[str, ...] = (),
    change: Callable[[int, str, Any], None] = lambda *_: None,
) -> Path:
    """Copy a bag without some topics; `change` gets number, topic and message of each that is kept."""
    store = get_typestore(Stores.ROS2_JAZZY)

    def changed(k: int, connection: Connection, data: bytes) -> bytes:
        message = store.deserialize_cdr(data, connection.msgtype)
        change(k, connection.topic, message)
        return bytes(store.serialize_cdr(message, connection.msgtype))

    with Writer(target, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        drives.copy_bag(bag, writer, changed, without)
    return target


def test_odometry_comes_from_the_frames_where_no_topic_is(bag: Path, given: BagDrive, tmp_path: Path) -> None:
    drives.check(read_bag(rewritten(bag, tmp_path / "run", without=("/odom",)), IMU), given)


def test_without_odometry_and_frames_the_laser_is_at_the_base(bag: Path, tmp_path: Path) -> None:
    target = rewritten(bag, tmp_path / "run", without=("/odom", "/tf", "/tf_static"))
    log = read_bag(target, Topics())
    assert set(log.odometry) == {None}
    (repair,) = log.repaired
    assert "the laser is taken to be at the base" in repair


def test_each_scan_has_its_own_beams(bag: Path, given: BagDrive, tmp_path: Path) -> None:
    def shorten(k: int, topic: str, m: Any) -> None:
        if topic == "/scan" and k % 5:
            m.angle_min, m.ranges = m.angle_min + 10 * m.angle_increment, m.ranges[10:]

    log = read_bag(rewritten(bag, tmp_path / "run", change=shorten), Topics())
    assert len(log.scans) == len(given.ticks)
    assert (log.skipped, log.left_out) == ({}, 0)
    for k, (scan, tick) in enumerate(zip(log.scans, given.ticks, strict=True)):
        first = 10 if k % 5 else 0
        np.testing.assert_array_equal(scan.ranges, tick.scan.ranges[first:])
        np.testing.assert_allclose(scan.angles, tick.scan.angles[first:], atol=1e-6)


def test_an_increment_of_0_comes_from_the_limits(bag: Path, given: BagDrive, tmp_path: Path) -> None:
    def zero(k: int, topic: str, m: Any) -> None:
        if topic == "/scan":
            m.angle_increment = 0.0

    log = read_bag(rewritten(bag, tmp_path / "run", change=zero), Topics())
    drives.check(log, given)
    assert log.repaired == {"angle_increment 0: derived from angle_min, angle_max": len(given.ticks)}


def test_scans_without_geometry_are_left_out_and_counted(bag: Path, tmp_path: Path) -> None:
    def spoil(k: int, topic: str, m: Any, first: int) -> None:
        if topic == "/scan" and k >= first:
            m.angle_increment, m.angle_max = 0.0, m.angle_min

    some = rewritten(bag, tmp_path / "some", change=partial(spoil, first=75))
    log = read_bag(some, Topics())
    why = "scan whose angle_min, angle_max, angle_increment disagree"
    assert (len(log.scans), log.left_out, log.skipped) == (75, 25, {why: 25})
    every = rewritten(bag, tmp_path / "every", change=partial(spoil, first=0))
    with pytest.raises(SourceError, match=rf"every: holds no laser scan that can be used \(100 x {why}\)$"):
        read_bag(every, Topics())


def test_times_of_reception_replace_stamps_of_0(bag: Path, given: BagDrive, tmp_path: Path) -> None:
    def zero(k: int, topic: str, m: Any) -> None:
        if topic in ("/scan", "/imu"):
            m.header.stamp.sec = m.header.stamp.nanosec = 0

    log = read_bag(rewritten(bag, tmp_path / "run", change=zero), IMU)
    drives.check(log, given)
    assert [reading.stamp for reading in log.imu] == pytest.approx(list(log.stamps))
    assert log.repaired == {"header stamps all the same: times of reception are taken": 100}


def test_stamps_that_go_back_are_repaired_and_said(bag: Path, given: BagDrive, tmp_path: Path) -> None:
    def advance(k: int, topic: str, m: Any) -> None:
        if (k, topic) == (49, "/scan"):
            m.header.stamp.sec -= 1

    with pytest.warns(UserWarning, match="stamps go back"):
        log = read_bag(rewritten(bag, tmp_path / "run", change=advance), Topics())
    stamps = [scan.stamp for scan in log.scans]
    assert (np.diff(stamps) > 0).all()
    np.testing.assert_array_equal(log.scans[49].ranges, given.ticks[49].scan.ranges)
    assert stamps[49] == pytest.approx(
        given.ticks[49].scan.stamp, abs=0.1
    )  # one outlier is shared out among its neighbors


def test_the_first_echo_of_each_beam_counts(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    kind = "sensor_msgs/msg/MultiEchoLaserScan"
    echo, time = store.types["sensor_msgs/msg/LaserEcho"], store.types["builtin_interfaces/msg/Time"]
    beams = [echo(np.array(found, np.float32)) for found in ((1.5, 4.0), (), (2.5,))]
    with Writer(tmp_path / "run", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/echoes", kind, typestore=store)
        for k in range(3):
            header = store.types["std_msgs/msg/Header"](time(k, 0), "laser")
            message = store.types[kind](header, -0.1, 0.1, 0.1, 0.0, 0.1, 0.1, 30.0, beams, [])
            writer.write(connection, k, store.serialize_cdr(message, kind))
    for scan in read_bag(tmp_path / "run", Topics()).scans:
        np.testing.assert_array_equal(scan.ranges, np.array((1.5, np.nan, 2.5), np.float32))
        assert scan.angle_min == pytest.approx(-0.1)


@pytest.mark.parametrize("fault", ["definition", "hash"])
def test_another_type_harms_no_scan(bag: Path, given: BagDrive, tmp_path: Path, fault: str) -> None:
    target = tmp_path / "run"
    with Writer(target, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        text, rihs = ("int64 a\n---\nint64 b\n", "unknown") if fault == "definition" else ("int64 a\n", "x")
        other = writer.add_connection("/other", "my_msgs/msg/Other", msgdef=text, rihs01=rihs)
        for stamp in range(3):
            writer.write(other, stamp, bytes(12))
        drives.copy_bag(bag, writer)
    drives.check(read_bag(target, IMU), given)


MESSAGES = {
    "bag_format_v1.bag": r"its format is '#ROSRECORD V1\.2', legal is '#ROSBAG V2\.0'",
    "constants.bag": r"/constants \(test_roscpp_serialization/msg/Constants\)",
    "only_services.mcap": r"/add_two_ints/_service_event \(example_interfaces/srv/AddTwoInts_Event\)",
    "topics_and_services.db3": r"/rosout \(rcl_interfaces/msg/Log\)",
    "topics_and_services.mcap": r"/rosout \(rcl_interfaces/msg/Log\)",
    "truncated.bag": "truncated.bag: its end is missing; rosbag reindex truncated.bag makes it readable",
}


@pytest.mark.shared
@pytest.mark.parametrize("name", MESSAGES)
def test_real_bags_without_scans_say_what_they_hold(shared_data: Path, name: str) -> None:
    with refused(shared_data / "bags" / name, MESSAGES[name]):
        read_bag(shared_data / "bags" / name, Topics())


@pytest.mark.shared
@pytest.mark.parametrize(
    "name", [pytest.param("cartographer_b0_tiny.bag", marks=pytest.mark.slow), "laser_scan_matcher_demo.bag"]
)
def test_real_bags_with_scans_are_read(shared_data: Path, name: str) -> None:
    log = read_bag(shared_data / "bags" / name, Topics())
    assert len(log.scans) > 20
    assert (log.skipped, log.left_out, log.lines.moved) == ({}, 0, 0)
    assert all(scan.hits.mean() > 0.3 for scan in log.scans)


def test_scans_are_leveled_by_an_odometry_that_tilts(bag: Path, tmp_path: Path) -> None:
    def tilt(k: int, topic: str, m: Any) -> None:
        if topic == "/odom":
            pitched = Pose3.from_rpy(0, 0, 0, 0.0, 0.01 * k, 0.005 * k)
            q = m.pose.pose.orientation
            q.w, q.x, q.y, q.z = pitched.qw, pitched.qx, pitched.qy, pitched.qz

    target = rewritten(bag, tmp_path / "run", change=tilt)
    log = read_bag(target, Topics())
    assert list(log.repaired) == ["the odometry tilts by up to 56.7 deg: scans are leveled by it"]
    for k, scan in enumerate(log.scans):
        expected = Pose3.from_rpy(0, 0, 0, 0.0, 0.01 * k, 0.0) @ drives.MOUNT
        np.testing.assert_allclose(scan.T_base_laser.position, expected.position, atol=1e-3)
        assert abs(float(scan.T_base_laser.quaternion @ expected.quaternion)) > 1 - 1e-5
    with_imu = read_bag(target, IMU)
    assert with_imu.repaired == {}
    assert with_imu.scans[-1].T_base_laser == with_imu.scans[0].T_base_laser
