"""Trajectories in bags: along /tf as SLAM systems publish them, or on a topic of poses."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from lirs_wct.errors import SourceError
from lirs_wct.formats.rosbag.frames import read_poses
from lirs_wct.formats.rosbag.messages import BagDrive, BagTick
from lirs_wct.formats.rosbag.writer import write_bag
from lirs_wct.geometry.pose import Pose2, Pose3
from tests.lirs_wct.formats.rosbag import drives

STORE = get_typestore(Stores.ROS2_JAZZY)


@pytest.fixture(scope="module")
def given() -> BagDrive:
    return drives.drive(50)


def make(kind: str, **fields: Any) -> Any:
    return STORE.types[kind.replace("/", "/msg/")](**fields)


def header(t: float, frame: str = "map") -> Any:
    stamp = make("builtin_interfaces/Time", sec=int(t), nanosec=round(t % 1 * 1e9))
    return make("std_msgs/Header", stamp=stamp, frame_id=frame)


def pose(T: Pose2) -> Any:
    q = Pose3.from_pose2(T)
    return make(
        "geometry_msgs/Pose",
        position=make("geometry_msgs/Point", x=q.x, y=q.y, z=0.0),
        orientation=make("geometry_msgs/Quaternion", x=0.0, y=0.0, z=q.qz, w=q.qw),
    )


def transform(t: float, parent: str, child: str, T: Pose2) -> Any:
    held = pose(T)
    p = held.position
    turned = make(
        "geometry_msgs/Transform",
        translation=make("geometry_msgs/Vector3", x=p.x, y=p.y, z=p.z),
        rotation=held.orientation,
    )
    stamped = make(
        "geometry_msgs/TransformStamped", header=header(t, parent), child_frame_id=child, transform=turned
    )
    return make("tf2_msgs/TFMessage", transforms=[stamped])


def written(folder: Path, messages: list[tuple[str, float, Any]]) -> Path:
    with Writer(folder, version=8, storage_plugin=StoragePlugin.MCAP) as writer:
        made: dict[str, Any] = {}
        for topic, t, message in messages:
            kind = message.__msgtype__
            if topic not in made:
                made[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(made[topic], round(t * 1e9), STORE.serialize_cdr(message, kind))
    return folder


def test_the_estimate_is_what_the_transforms_say(bag: Path, given: BagDrive) -> None:
    for topic in (None, "/tf"):
        found = read_poses(bag, topic)
        assert len(found) == len(given.ticks)
        for k, tick in enumerate(given.ticks):
            assert found.stamps[k] == pytest.approx(tick.scan.stamp, abs=1e-9)
            np.testing.assert_allclose(found.pose2(k).as_array(), tick.estimate.as_array(), atol=1e-12)


def test_topics_of_poses(bag: Path, given: BagDrive) -> None:
    truth, odometry = read_poses(bag, "/ground_truth"), read_poses(bag, "/odom")
    for k, tick in enumerate(given.ticks):
        np.testing.assert_allclose(truth.positions[k], tick.truth.position, atol=1e-12)
        np.testing.assert_allclose(truth.quaternions[k], tick.truth.quaternion, atol=1e-12)
        np.testing.assert_allclose(odometry.pose2(k).as_array(), tick.odometry.as_array(), atol=1e-12)


def test_poses_with_covariance_and_paths(tmp_path: Path) -> None:
    path = [Pose2(0.1 * k, 0.2, 0.01 * k) for k in range(9)]
    steps = [(0.5 * k, T) for k, T in enumerate(path)]
    stamped = [make("geometry_msgs/PoseStamped", header=header(t), pose=pose(T)) for t, T in steps]
    old = [make("geometry_msgs/PoseStamped", header=header(t), pose=pose(Pose2(9, 9, 1))) for t, _ in steps]
    messages: list[tuple[str, float, Any]] = [
        ("/path", 3.0, make("nav_msgs/Path", header=header(3.0), poses=old)),
        ("/path", 4.0, make("nav_msgs/Path", header=header(4.0), poses=stamped)),
    ]
    for t, T in steps:
        claimed = np.zeros(36) if t == 0.0 else np.arange(36.0)
        held = make("geometry_msgs/PoseWithCovariance", pose=pose(T), covariance=claimed)
        kind = "geometry_msgs/PoseWithCovarianceStamped"
        messages.append(("/pose", t, make(kind, header=header(t), pose=held)))
    folder = written(tmp_path / "slam", messages)
    for topic in ("/pose", "/path"):
        found = read_poses(folder, topic)
        np.testing.assert_allclose(found.stamps, [t for t, _ in steps])
        for k, T in enumerate(path):
            np.testing.assert_allclose(found.pose2(k).as_array(), T.as_array(), atol=1e-12)
        if topic == "/path":
            assert found.covariances is None
        else:
            assert np.isnan(found.covariances[0]).all()
            expected = np.broadcast_to([[0, 1, 5], [6, 7, 11], [30, 31, 35]], (8, 3, 3))
            np.testing.assert_array_equal(found.covariances[1:], expected)
    with pytest.raises(SourceError, match=r"BAG:/TOPIC must say where its poses are; .*/path .*, /pose "):
        read_poses(folder)


def test_corrections_at_other_times_are_interpolated(tmp_path: Path) -> None:
    """As slam_toolbox publishes map -> odom: less often than the odometry, and stamped ahead."""
    messages: list[tuple[str, float, Any]] = []
    for k in range(40):
        t = 1.0 + 0.05 * k
        messages.append(("/tf", t, transform(t, "odom", "r1/base_footprint", Pose2(k * 0.01, 0, 0))))
        if k % 8 == 0:
            messages.append(("/tf", t, transform(t + 0.2, "/map", "/odom", Pose2(0, 0.1 * k, 0))))
    found = read_poses(written(tmp_path / "slam", messages))
    assert (found.stamps[0], found.stamps[-1]) == pytest.approx((1.2, 2.8))
    at = (found.stamps - 1.0) / 0.05
    np.testing.assert_allclose(found.positions[:, 0], 0.01 * at, atol=1e-9)
    np.testing.assert_allclose(found.positions[:, 1], 0.1 * (at - 4), atol=1e-9)


def test_missing_topics_and_frames_list_those_that_are_there(
    given: BagDrive, bag: Path, tmp_path: Path
) -> None:
    with pytest.raises(SourceError, match=r"BAG:/TOPIC /pose: no topic of .*; there are: /clock .*, /tf "):
        read_poses(bag, "/pose")
    with pytest.raises(SourceError, match=r"BAG:/TOPIC /scan: no topic of nav_msgs/msg/Odometry or "):
        read_poses(bag, "/scan")
    ticks = [BagTick(scan=t.scan, odometry=t.odometry, imu=t.imu, truth=t.truth) for t in given.ticks]
    write_bag(tmp_path / "sensors", BagDrive(ticks=ticks))
    with pytest.raises(SourceError, match=r"BAG:/TOPIC must say where its poses are; there are: .*/odom"):
        read_poses(tmp_path / "sensors")
    with pytest.raises(
        SourceError, match=r"do not lead from map to base_link or .*: its frames are base_link, "
    ):
        read_poses(tmp_path / "sensors", "/tf")
