"""What comes with a log: references, relations, inertial readings at the scans, the laser's mount."""

import gzip
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from lirs_validation import map_log
from lirs_validation.config import MapConfig
from lirs_validation.logs.map_log import folder_name
from lirs_validation.logs.read_log import read_reference, truth_in_time
from lirs_validation.metrics.mapped_log import RelativePoseConstraint
from lirs_wct.errors import ConfigError, SourceError
from lirs_wct.formats.drive_files import read_mount, write_imu, write_scans, write_tum
from lirs_wct.formats.laser_log import LineStamps
from lirs_wct.geometry.pose import Pose2, Pose3, Trajectory
from lirs_wct.geometry.scan import Imu, LaserScan
from tests.lirs_wct.formats.carmen_room import START, room_lines, write_log


@pytest.mark.parametrize("zipped", [False, True])
def test_both_formats_are_read(tmp_path: Path, zipped: bool) -> None:
    track = Trajectory.from_poses([1.0, 2.0, 3.0], [Pose2(0.1 * k, 0.0, 0.2) for k in range(3)])
    write_tum(tmp_path / "a.txt", track)
    write_log(tmp_path / "b.txt", room_lines(5)[0])
    for name in ("a.txt", "b.txt"):
        if zipped:
            (tmp_path / name).write_bytes(gzip.compress((tmp_path / name).read_bytes()))
    np.testing.assert_allclose(read_reference(tmp_path / "a.txt").positions, track.positions, atol=1e-9)
    np.testing.assert_allclose(read_reference(tmp_path / "b.txt").stamps, START + 0.2 * np.arange(5))


def test_a_log_without_poses_is_no_reference(tmp_path: Path) -> None:
    path = write_log(tmp_path / "still.clf", room_lines(5, drifting=False)[0])
    with pytest.raises(SourceError, match="holds no poses that change"):
        read_reference(path)


LOGGED = np.array([5.0, 5.9, 5.5, 5.7, 7.0])
REPAIRED = np.array([5.0, 5.6, 5.7, 5.8, 7.0])
LINES = LineStamps(LOGGED, REPAIRED, np.ones(5, np.bool_))


def test_relations_are_moved_with_the_lines_they_name() -> None:
    relations = RelativePoseConstraint(5.9, 5.5, Pose2(1.0)), RelativePoseConstraint(5.0, 7.0, Pose2(2.0))
    moved, _ = truth_in_time((relations, None), LINES)
    assert moved is not None
    np.testing.assert_allclose([(r.stamp_a, r.stamp_b) for r in moved], [(5.6, 5.7), (5.0, 7.0)])
    assert [r.T_ab for r in moved] == [Pose2(1.0), Pose2(2.0)]


def test_a_reference_is_moved_and_stays_in_order() -> None:
    """The pose at the line of 5.9 s comes first: it is that of an earlier line."""
    reference = Trajectory.from_poses(np.sort(LOGGED).tolist(), [Pose2(float(k)) for k in range(5)])
    _, moved = truth_in_time((None, reference), LINES)
    assert moved is not None
    np.testing.assert_allclose(moved.stamps, REPAIRED)
    assert moved.positions[:, 0].tolist() == [0, 3, 1, 2, 4]


@given(st.floats(-100, 100))
def test_of_a_sound_log_nothing_moves(stamp: float) -> None:
    sound = LineStamps(REPAIRED, REPAIRED, np.ones(5, np.bool_))
    relation = RelativePoseConstraint(stamp, stamp + 1, Pose2())
    assert truth_in_time(((relation,), None), sound) == ((relation,), None)
    assert sound.repaired_at(np.array([stamp])).tolist() == [stamp]


NOTING = """
import json
from lirs_wct.geometry.pose import Trajectory
from slam_baselines.mapper import MapperStats
from slam_baselines.front_end import KnownPoseMapper

class Noting(KnownPoseMapper):
    lost, stats = False, MapperStats()

    def __init__(self):
        super().__init__(0.05)
        self.stamps, self.poses = [], []

    def update(self, scan, odometry, imu):
        super().update(scan, odometry, imu)
        mount = scan.T_base_laser
        with open("given.txt", "a") as file:
            file.write(json.dumps([list(map(float, mount.position)), mount.pitch, imu and imu.pitch]) + "\\n")
        self.stamps.append(scan.stamp)
        self.poses.append(odometry)
        return odometry

    def trajectory(self):
        return Trajectory.from_poses(self.stamps, self.poses)
"""
MOUNT = Pose3.from_rpy(0.22, -0.05, 0.4, 0.0, 0.1, 0.3)
SCANS = 20


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    """A folder with a log of a square room, and readings at every scan but the last two."""
    angles = np.linspace(-math.pi / 2, math.pi / 2, 91)
    ranges = (2.0 / np.maximum(np.abs(np.cos(angles)), np.abs(np.sin(angles)))).astype(np.float32)
    scans = [
        LaserScan(ranges, float(angles[0]), math.radians(2), 0.05, 20.0, 0.1 * k, MOUNT) for k in range(SCANS)
    ]
    write_scans(tmp_path / "scans.clf.gz", [(scan, Pose2(0.01 * k)) for k, scan in enumerate(scans)])
    write_imu(tmp_path / "imu.csv.gz", [Imu(pitch=0.01 * k, stamp=0.1 * k) for k in range(SCANS - 2)])
    (tmp_path / "noting_log_slam.py").write_text(NOTING)
    return tmp_path


@pytest.mark.parametrize("attitude", ["imu", "none"])
def test_each_scan_gets_the_reading_at_its_stamp(
    recorded: Path, monkeypatch: pytest.MonkeyPatch, attitude: Any
) -> None:
    monkeypatch.chdir(recorded)
    imu = recorded / "imu.csv.gz"
    map_log("scans.clf.gz", mapper="noting_log_slam:Noting", imu=imu, attitude=attitude, second="none")
    given = [json.loads(line) for line in (recorded / "given.txt").read_text().splitlines()]
    assert len(given) == SCANS
    for position, pitch, _ in given:
        np.testing.assert_allclose(position, MOUNT.position, atol=1e-6)
        assert pitch == pytest.approx(0.1)
    readings = [reading for *_, reading in given]
    if attitude == "none":
        assert readings == [None] * SCANS
    else:
        assert readings[:-2] == pytest.approx([0.01 * k for k in range(SCANS - 2)])
        assert readings[-2:] == [None, None]


def test_readings_and_attitude_tell_folders_apart_and_neither_changes_older_names(recorded: Path) -> None:
    log, imu = str(recorded / "scans.clf.gz"), str(recorded / "imu.csv.gz")
    configs = [MapConfig(log=log), MapConfig(log=log, imu=imu), MapConfig(log=log, imu=imu, attitude="none")]
    names = {folder_name(config) for config in configs}
    assert len(names) == 3
    assert MapConfig(log=log, attitude="imu").digest(b"") == MapConfig(log=log).digest(b"")


def test_a_log_without_the_comment_has_no_recorded_mount(recorded: Path, tmp_path: Path) -> None:
    found = read_mount(recorded / "scans.clf.gz")
    assert found.yaw == pytest.approx(0.3)
    for text in ("", "# carmen\nFLASER 1\n", "# laser on base_link, x y z roll pitch yaw: 1 2\nODOM 1\n"):
        (tmp_path / "a.clf").write_text(text)
        assert read_mount(tmp_path / "a.clf") is None


def test_readings_that_do_not_fit_are_refused(recorded: Path) -> None:
    log = recorded / "scans.clf.gz"
    write_imu(recorded / "late.csv.gz", [Imu(stamp=100.0)])
    with pytest.raises(SourceError, match=r"late.csv.gz: other stamps: none of its 1 readings"):
        map_log(log, mapper="hector", imu=recorded / "late.csv.gz")
    with pytest.raises(SourceError, match=r"^nothing.csv.gz: cannot be read: No such file"):
        map_log(log, mapper="hector", imu="nothing.csv.gz")
    with pytest.raises(ConfigError, match="attitude must be imu or none, got 'some'"):
        map_log(log, attitude="some")
