"""A drive's bag: what it holds, that it changes nothing else, and that mapping it gives the same path."""

import errno
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from lirs_validation import Run, validate
from lirs_validation.config import MapConfig, RunConfig
from lirs_validation.experiment.run import run
from lirs_validation.logs.map_log import run_mapping
from lirs_validation.sweep.tasks import RunTask
from lirs_wct.errors import ConfigError, OutputError
from lirs_wct.files import read_manifest
from lirs_wct.formats.rosbag.reader import read_bag
from lirs_wct.formats.rosbag.topics import Topics
from lirs_wct.geometry.pose import Pose3
from lirs_wct.geometry.scan import POINT
from slam_baselines.mapper import MAPPERS

SECONDS = 2.0
pytestmark = pytest.mark.usefixtures("plain_pictures")
Record = Callable[..., Run]


@pytest.fixture(scope="module")
def recorded(room: str) -> Record:
    def record(out: Path, **options: Any) -> Run:
        given: dict[str, Any] = {"mapper": "hector", "seconds": SECONDS, "bag": "mcap"} | options
        return validate(room, **given, out=out)

    return record


@pytest.fixture(scope="module")
def made(recorded: Record, tmp_path_factory: pytest.TempPathFactory, plain_pictures: None) -> Run:
    return recorded(tmp_path_factory.mktemp("out"))


def folder_of(made: Run) -> Path:
    assert made.folder is not None
    return made.folder


def messages(folder: Path) -> dict[str, list[Any]]:
    found: dict[str, list[Any]] = {}
    with AnyReader([folder]) as reader:
        for connection, _, data in reader.messages():
            found.setdefault(connection.topic, []).append(reader.deserialize(data, connection.msgtype))
    return found


def pose_of(position: Any, rotation: Any) -> Pose3:
    return Pose3(position.x, position.y, position.z, rotation.w, rotation.x, rotation.y, rotation.z)


def test_a_bag_changes_nothing_else(made: Run, recorded: Record, tmp_path: Path) -> None:
    plain = recorded(tmp_path, bag=None)
    assert plain.record.name == made.record.name, "the digest says what is tried, not what is recorded"
    for name in ("estimate.tum", "truth.tum", "odometry.tum", "commands.csv", "map.pgm", "scans.clf.gz"):
        assert (folder_of(plain) / name).read_bytes() == (folder_of(made) / name).read_bytes(), name
    for part in ("trajectory", "map", "collisions", "status"):
        assert getattr(plain.record, part) == getattr(made.record, part)
    assert {"metadata.yaml", "bag.mcap"} <= set(read_manifest(folder_of(made)))
    assert sorted(p.name for p in folder_of(made).parent.iterdir()) == [made.record.name]


def test_the_bag_holds_what_was_sensed_and_answered(made: Run) -> None:
    found, log = messages(folder_of(made)), made.log
    for topic, rate, first in (("/imu/data_raw", 200, 1), ("/odom", 50, 0)):
        ends = [each.header.stamp.sec + each.header.stamp.nanosec * 1e-9 for each in found[topic]]
        np.testing.assert_allclose(ends, np.arange(first, len(ends) + first) / rate, atol=1e-9)
        assert ends[-1] == pytest.approx(log.stamps[-1])
    assert len(found["/tf"]) == len(found["/clock"]) == len(found["/odom"])
    for topic in ("/imu/data_raw", "/odom", "/clock"):
        del found[topic]
    found["/tf"] = [message for message in found["/tf"] if len(message.transforms) == 2]
    assert {topic: len(held) for topic, held in found.items()} == {
        topic: 1 if topic in ("/tf_static", "/map") else len(log.observations)
        for topic in ("/tf_static", "/tf", "/imu", "/scan", "/ground_truth", "/map")
    }
    T_map_world = Pose3.from_pose2(log.truth[0].to_pose2().inverse())
    for k, observation in enumerate(log.observations):
        np.testing.assert_array_equal(found["/scan"][k].ranges, observation.scan.ranges)
        frames = {
            (t.header.frame_id, t.child_frame_id): pose_of(t.transform.translation, t.transform.rotation)
            for t in found["/tf"][k].transforms
        }
        estimate = (frames["map", "odom"] @ frames["odom", "base_link"]).to_pose2()
        np.testing.assert_allclose(estimate.as_array(), log.estimates[k].as_array(), atol=1e-9)
        pose = found["/ground_truth"][k].pose
        true = pose_of(pose.position, pose.orientation)
        wanted = T_map_world @ log.truth[k]
        np.testing.assert_allclose(true.position, wanted.position, atol=1e-12)
        np.testing.assert_allclose(true.quaternion, wanted.quaternion, atol=1e-12)
    (grid,) = found["/map"]
    cells = np.array(grid.data).reshape(grid.info.height, grid.info.width)
    np.testing.assert_array_equal(cells == 100, made.maps.built.occupied)


@pytest.mark.parametrize(
    ("robot", "mapper"),
    [
        ("husky", "hector"),
        *(pytest.param("husky", mapper, marks=pytest.mark.slow) for mapper in MAPPERS if mapper != "hector"),
        # Its range_min, .1 m, and its angles, 270.25 deg / 1080, are no float32.
        pytest.param("jackal", "hector", marks=pytest.mark.slow),
    ],
)
def test_mapping_the_bag_gives_the_trajectory_of_the_drive(
    robot: str, mapper: str, recorded: Record, tmp_path: Path
) -> None:
    driven = recorded(tmp_path, robot=robot, mapper=mapper, seconds=0.8)
    again = run_mapping(MapConfig(log=str(folder_of(driven)), mapper=mapper, imu_topic="/imu")).trajectory
    online = driven.log.final_trajectory
    assert online is not None
    np.testing.assert_allclose(again.stamps, online.stamps, atol=1e-9)
    np.testing.assert_allclose(again.positions, online.positions, atol=1e-6)
    np.testing.assert_allclose(again.yaw, online.yaw, atol=1e-6)


def test_scans_come_back_as_the_mapper_had_them(recorded: Record, tmp_path: Path) -> None:
    driven = recorded(tmp_path, robot="jackal", seconds=1.0, bag="sqlite3")
    log = read_bag(folder_of(driven), Topics(imu="/imu"))
    for k, observation in enumerate(driven.log.observations):
        scan, wanted = log.scans[k], observation.scan
        np.testing.assert_array_equal(scan.ranges, wanted.ranges)
        np.testing.assert_allclose(scan.angles, wanted.angles, atol=1e-14)
        assert (scan.range_min, scan.range_max) == (wanted.range_min, wanted.range_max)
        assert scan.stamp == pytest.approx(wanted.stamp, abs=1e-9)
        assert scan.T_base_laser == wanted.T_base_laser
        pose = log.odometry[k]
        assert pose is not None
        np.testing.assert_allclose(pose.as_array(), observation.odometry.as_array(), atol=1e-14)
        assert log.imu[k].roll == pytest.approx(observation.imu.roll, abs=1e-15)
        assert log.imu[k].linear_acceleration == observation.imu.linear_acceleration


def test_sensors_only_leaves_out_what_the_mapper_made(recorded: Record, tmp_path: Path) -> None:
    found = messages(folder_of(recorded(tmp_path, seconds=1.0, sensors_only=True)))
    assert "/map" not in found
    assert {t.child_frame_id for message in found["/tf"] for t in message.transforms} == {"base_link"}


def test_a_run_that_comes_to_nothing_leaves_no_bag(
    recorded: Record, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from rosbags.rosbag2 import Writer

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Writer, "write", full)
    with pytest.raises(OutputError, match="cannot be written: No space left on device"):
        recorded(tmp_path / "out", seconds=1.0)
    assert list((tmp_path / "out").iterdir()) == []


def test_a_bag_needs_a_folder_and_a_storage() -> None:
    with pytest.raises(ConfigError, match="simple: a bag needs a folder"):
        run(RunConfig(source="simple", bag="mcap"))
    with pytest.raises(ConfigError, match="unknown storage of a bag 'rosbag'; legal: mcap, sqlite3"):
        RunConfig(source="simple", bag="rosbag")  # type: ignore[arg-type]


def test_a_finished_run_counts_where_its_bag_is_what_is_asked_for(made: Run) -> None:
    out = folder_of(made).parent
    config = replace(made.record.config, bag="mcap")
    for same in (config, replace(config, bag=None)):
        assert RunTask(same).find_outcome(out) is not None
    for other in (replace(config, bag="sqlite3"), replace(config, sensors_only=True)):
        assert RunTask(other).find_outcome(out) is None
    file = folder_of(made) / "bag.mcap"
    whole = file.read_bytes()
    file.write_bytes(whole[:-9])
    assert RunTask(config).find_outcome(out) is None
    file.write_bytes(whole)
    record = folder_of(made) / "record.json"
    assert json.loads(record.read_text())["config"]["bag"] == "mcap"


def test_a_ring_lidars_clouds_are_in_the_bag(recorded: Record, tmp_path: Path) -> None:
    made = recorded(tmp_path, lidar="vlp16", seconds=1.0)
    points = messages(folder_of(made))["/points"]
    assert len(points) == len(made.log.observations) == 11
    assert {field.name for field in points[0].fields} == {"x", "y", "z", "intensity", "ring", "time"}
    assert points[0].width * points[0].height > 10_000


def test_clouds_for_a_slam_system_hold_the_returns_in_the_order_of_time(
    recorded: Record, tmp_path: Path
) -> None:
    def clouds(out: Path, *, sensors_only: bool) -> list[Any]:
        made = recorded(out, lidar="vlp16", noise="datasheet", seconds=0.5, sensors_only=sensors_only)
        return messages(folder_of(made))["/points"]

    organized = clouds(tmp_path / "all", sensors_only=False)
    for all_beams, returns in zip(organized, clouds(tmp_path / "some", sensors_only=True), strict=True):
        wanted = np.frombuffer(bytes(all_beams.data), POINT)
        wanted = wanted[np.isfinite(wanted["x"])]
        points = np.frombuffer(bytes(returns.data), POINT)
        assert 0 < len(points) < all_beams.height * all_beams.width
        assert (returns.height, returns.width, returns.is_dense) == (1, len(points), True)
        assert (np.diff(points["time"]) >= 0).all()
        np.testing.assert_array_equal(points, wanted[np.argsort(wanted["time"], kind="stable")])
