"""Bags as written: read back by a second, independent reader, field by field."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from lirs_wct.formats.rosbag.messages import BagDrive, SensorErrors, body_velocity
from lirs_wct.formats.rosbag.topics import LATCHED, TOPICS
from lirs_wct.formats.rosbag.writer import write_bag
from lirs_wct.geometry.pose import Pose2, Pose3
from tests.lirs_wct.formats.rosbag import drives


@pytest.fixture(scope="module")
def given() -> BagDrive:
    return drives.drive()


@pytest.fixture(scope="module")
def read(bag: Path) -> dict[str, list[Any]]:
    reader = pytest.importorskip("mcap_ros2.reader", reason="mcap-ros2-support is not installed")
    topics: dict[str, list[Any]] = {}
    for message in reader.read_ros2_messages(str(bag / "run.mcap")):
        topics.setdefault(message.channel.topic, []).append(message.ros_msg)
        stamp = getattr(getattr(message.ros_msg, "header", None), "stamp", None)
        if stamp is not None:
            assert message.log_time_ns == stamp.sec * 1_000_000_000 + stamp.nanosec
    return topics


def pose_of(position: Any, rotation: Any) -> Pose3:
    return Pose3(position.x, position.y, position.z, rotation.w, rotation.x, rotation.y, rotation.z)


def seconds(stamp: Any) -> float:
    return float(stamp.sec + stamp.nanosec * 1e-9)


def test_messages_are_encoded_as_the_library_encodes_them(bag: Path) -> None:
    from rosbags.highlevel import AnyReader

    found = set()
    with AnyReader([bag]) as reader:
        for connection, _, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            assert bytes(reader.typestore.serialize_cdr(message, connection.msgtype)) == bytes(data)
            found.add(connection.topic)
    assert found == set(TOPICS)


def test_every_topic_has_a_message_for_every_scan(read: dict[str, list[Any]], given: BagDrive) -> None:
    assert {topic: len(found) for topic, found in read.items()} == {
        topic: 1 if topic in LATCHED else len(given.ticks) for topic in TOPICS
    } | {"/imu/data_raw": 2 * (len(given.ticks) - 1)}


def test_scans_are_those_given(read: dict[str, list[Any]], given: BagDrive) -> None:
    for message, scan in zip(read["/scan"], [tick.scan for tick in given.ticks], strict=True):
        assert message.header.frame_id == "laser"
        assert seconds(message.header.stamp) == pytest.approx(scan.stamp, abs=1e-9)
        np.testing.assert_array_equal(np.array(message.ranges, np.float32), scan.ranges)
        assert message.angle_min == np.float32(scan.angle_min)
        assert message.angle_max == np.float32(scan.angles[-1])
        assert message.angle_increment == np.float32(scan.angle_increment)
        assert (message.range_min, message.range_max) == (np.float32(0.1), np.float32(30.0))
        assert message.time_increment == 0
        assert message.scan_time == pytest.approx(0.02)
        assert len(message.intensities) == 0


def test_clouds_are_those_given(read: dict[str, list[Any]], given: BagDrive) -> None:
    # What KISS-ICP and the tools of ROS make of the fields.
    types = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
    for message, tick in zip(read["/points"], given.ticks, strict=True):
        cloud = tick.cloud
        assert message.header.frame_id == "laser"
        assert seconds(message.header.stamp) == pytest.approx(cloud.stamp, abs=1e-9)
        assert (message.height, message.width, message.is_bigendian, message.is_dense) == (4, 3, False, False)
        assert [field.name for field in message.fields] == ["x", "y", "z", "intensity", "ring", "time"]
        assert {field.count for field in message.fields} == {1}
        kind = np.dtype(
            {
                "names": [field.name for field in message.fields],
                "formats": [types[field.datatype] for field in message.fields],
                "offsets": [field.offset for field in message.fields],
                "itemsize": message.point_step,
            }
        )
        assert message.row_step == message.width * message.point_step
        beams = np.frombuffer(bytes(message.data), kind).reshape(4, 3)
        assert np.isnan(beams["x"][:, 1]).all()
        np.testing.assert_allclose(beams["time"], np.tile((0, 0.025, 0.05), (4, 1)))
        points = beams[:, [0, 2]].ravel()
        np.testing.assert_array_equal(points["intensity"], cloud.intensity)
        np.testing.assert_array_equal(np.column_stack([points[axis] for axis in "xyz"]), cloud.xyz)
        np.testing.assert_array_equal(points["ring"], cloud.ring)
        np.testing.assert_array_equal(points["time"], cloud.time)


def test_frames_are_those_of_rep_105(read: dict[str, list[Any]], given: BagDrive) -> None:
    (static,) = read["/tf_static"][0].transforms
    assert (static.header.frame_id, static.child_frame_id) == ("base_link", "laser")
    assert pose_of(static.transform.translation, static.transform.rotation) == drives.MOUNT
    for k, message in enumerate(read["/tf"]):
        tree = {
            (t.header.frame_id, t.child_frame_id): pose_of(t.transform.translation, t.transform.rotation)
            for t in message.transforms
        }
        assert set(tree) == {("odom", "base_link"), ("map", "odom")}
        T_map_base = tree["map", "odom"] @ tree["odom", "base_link"]
        found, wanted = T_map_base.to_pose2(), given.ticks[k].estimate
        np.testing.assert_allclose(found.as_array(), wanted.as_array(), atol=1e-12)


def test_odometry_imu_and_truth(read: dict[str, list[Any]], given: BagDrive) -> None:
    for k in range(len(given.ticks)):
        odom, imu, truth = read["/odom"][k], read["/imu"][k], read["/ground_truth"][k]
        assert (odom.header.frame_id, odom.child_frame_id) == ("odom", "base_link")
        found = pose_of(odom.pose.pose.position, odom.pose.pose.orientation).to_pose2()
        np.testing.assert_allclose(found.as_array(), given.ticks[k].odometry.as_array(), atol=1e-12)
        assert odom.twist.twist.angular.z == pytest.approx(0.25 if k else 0.0)
        attitude = pose_of(truth.pose.position, imu.orientation)
        reading = given.ticks[k].imu
        assert (attitude.roll, attitude.pitch) == pytest.approx((reading.roll, reading.pitch))
        assert imu.header.frame_id == "base_link"
        rates, force = imu.angular_velocity, imu.linear_acceleration
        assert (rates.x, rates.y, rates.z) == reading.angular_velocity
        assert (force.x, force.y, force.z) == reading.linear_acceleration
        assert truth.header.frame_id == "map"
        assert pose_of(truth.pose.position, truth.pose.orientation) == given.ticks[k].truth


def test_covariances_are_those_of_the_sensors(read: dict[str, list[Any]]) -> None:
    rate = 0.1**2 + 0.2**2
    for message in read["/imu"]:
        np.testing.assert_allclose(message.orientation_covariance, np.diag((0.09, 0.09, 1e6)).ravel())
        np.testing.assert_allclose(message.angular_velocity_covariance, np.diag([rate] * 3).ravel())
        np.testing.assert_allclose(message.linear_acceleration_covariance, np.diag([0.16] * 3).ravel())
    first, last = read["/odom"][0], read["/odom"][-1]
    np.testing.assert_array_equal(first.pose.covariance, np.diag((0, 0, 1e6, 1e6, 1e6, 0)).ravel())
    pose = np.diag(np.reshape(last.pose.covariance, (6, 6)))
    assert pose[5] == pytest.approx(0.1**2 * 0.01 * 0.08 + (0.2 * 0.08) ** 2)
    twist = np.diag(np.reshape(last.twist.covariance, (6, 6)))
    assert twist[0] == pytest.approx((0.02 * last.twist.twist.linear.x) ** 2)
    assert twist[5] == pytest.approx(rate)


def test_variances_of_odometry_are_those_of_many_straight_drives() -> None:
    rng, count, steps, step, dt = np.random.default_rng(0), 4000, 500, 0.02, 0.01
    errors = SensorErrors(scale=0.02, scale_length=5.0, rate=0.05, rate_bias=0.01, update=dt)
    keep = math.exp(-step / 5.0)
    scale, yaw = 0.02 * rng.standard_normal(count), np.zeros(count)
    bias, pose = 0.01 * rng.standard_normal(count), np.zeros((2, count))
    for _ in range(steps):
        pose += step * (1 + scale) * np.array((np.cos(yaw), np.sin(yaw)))
        scale = keep * scale + 0.02 * math.sqrt(1 - keep**2) * rng.standard_normal(count)
        yaw += dt * (bias + 0.05 * rng.standard_normal(count))
    x, y, *_, heading = errors.pose_variances(steps * step, steps * dt)
    assert heading == pytest.approx(yaw.var(), rel=0.1)
    assert x == y == pytest.approx(max(pose[0].var(), pose[1].var()), rel=0.35), "a bound of first order"


def test_inertial_readings_have_their_own_stamps_and_covariances(
    read: dict[str, list[Any]], given: BagDrive
) -> None:
    readings = [tick.inertial for tick in given.ticks if tick.inertial is not None]
    stamps = np.concatenate([each.stamps for each in readings])
    rates = np.concatenate([each.angular_velocity for each in readings])
    for message, stamp, rate in zip(read["/imu/data_raw"], stamps, rates, strict=True):
        assert seconds(message.header.stamp) == pytest.approx(stamp, abs=1e-9)
        assert message.header.frame_id == "base_link"
        assert message.orientation_covariance[0] == -1
        omega, force = message.angular_velocity, message.linear_acceleration
        assert (omega.x, omega.y, omega.z) == tuple(rate)
        assert (force.x, force.y, force.z) == (1.0, 1.0, 1.0)
        np.testing.assert_allclose(message.angular_velocity_covariance, np.diag([0.01] * 3).ravel())
        np.testing.assert_allclose(message.linear_acceleration_covariance, np.diag([0.04] * 3).ravel())


def test_a_map_larger_than_a_chunk_is_whole(read: dict[str, list[Any]], given: BagDrive) -> None:
    (message,) = read["/map"]
    cells = np.array(message.data, np.int8).reshape(message.info.height, message.info.width)
    assert cells.size > 2**20
    assert (cells[0, :10] == -1).all()
    np.testing.assert_array_equal(cells == 100, given.grid.occupied)
    np.testing.assert_array_equal(cells == 0, given.grid.free)
    origin = pose_of(message.info.origin.position, message.info.origin.orientation).to_pose2()
    np.testing.assert_allclose(origin.as_array(), given.grid.origin.as_array(), atol=1e-12)


def test_no_message_is_larger_than_its_chunk(bag: Path) -> None:
    # MCAP 1.3, which Jazzy has, cannot read a message that its chunk does not hold whole.
    records = pytest.importorskip("mcap.stream_reader", reason="mcap is not installed")
    from mcap.records import Chunk, Message

    with (bag / "run.mcap").open("rb") as file:
        outer = list(records.StreamReader(file, emit_chunks=True).records)
    assert not [r for r in outer if isinstance(r, Message)]
    inside = [
        (chunk.uncompressed_size, max((len(m.data) for m in found), default=0))
        for chunk in outer
        if isinstance(chunk, Chunk)
        for found in [[r for r in records.breakup_chunk(chunk) if isinstance(r, Message)]]
    ]
    assert max(largest for _, largest in inside) > 2**20
    assert all(largest < size for size, largest in inside)


def test_metadata_has_the_quality_of_service(bag: Path, given: BagDrive) -> None:
    info = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    offered = {
        topic["topic_metadata"]["name"]: yaml.safe_load(topic["topic_metadata"]["offered_qos_profiles"])[0]
        for topic in info["topics_with_message_count"]
    }
    assert {name for name, qos in offered.items() if qos["durability"] == 1} == set(LATCHED)
    assert {qos["reliability"] for qos in offered.values()} == {1}
    assert info["version"] == 8  # what Humble reads, and Jazzy too
    assert info["storage_identifier"] == "mcap"
    assert info["relative_file_paths"] == ["run.mcap"]
    assert info["starting_time"]["nanoseconds_since_epoch"] == 1_000_000_000
    assert info["duration"]["nanoseconds"] == 80_000_000


def test_a_bag_replaces_an_older_one_and_leaves_nothing_else(given: BagDrive, tmp_path: Path) -> None:
    for _ in range(2):
        write_bag(tmp_path / "run", given)
    assert [p.name for p in tmp_path.iterdir()] == ["run"]
    held = sorted(p.name for p in (tmp_path / "run").iterdir())
    assert held == ["manifest-sha256.txt", "metadata.yaml", "run.mcap"]


def test_body_velocity_of_a_circle() -> None:
    step = Pose2(2 * np.sin(0.05), 2 * (1 - np.cos(0.05)), 0.05)  # 0.05 rad on a circle of 2 m
    v = body_velocity(Pose2(3, 4, 1.2), Pose2(3, 4, 1.2) @ step, 0.1)
    np.testing.assert_allclose(v, (1.0, 0.0, 0.5), atol=1e-3)
