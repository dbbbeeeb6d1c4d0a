"""Text files of a drive: exact round trips, evo's reading, and one line for damaged files."""

import gzip
from pathlib import Path

import numpy as np
import pytest
from evo.tools import file_interface

from lirs_wct.formats.drive_files import (
    IMU_HEADER as HEADER,
    Commands,
    read_commands,
    read_imu,
    read_tum,
    write_commands,
    write_imu,
    write_tum,
)
from lirs_wct.geometry import Imu, Pose2, Pose3, Trajectory
from tests.kit import refused

READERS = {"commands.csv": read_commands, "imu.csv.gz": read_imu, "bad.tum": read_tum}
POSE = b"1 0 0 0 0 0 0 1\n"


def test_inertial_readings_come_back(tmp_path: Path) -> None:
    path, rows = tmp_path / "imu.csv.gz", np.random.default_rng(3).normal(size=(40, 9))
    write_imu(path, [Imu.from_row(*row) for row in rows.tolist()])
    np.testing.assert_allclose([reading.row for reading in read_imu(path)], rows, rtol=1e-8)
    first = Imu(
        stamp=1.5, roll=2.0, pitch=3.0, angular_velocity=(4.0, 5.0, 6.0), linear_acceleration=(7.0, 8.0, 9.0)
    )
    write_imu(path, [first])
    assert gzip.decompress(path.read_bytes()).decode() == f"{HEADER}\n1.5,2,3,4,5,6,7,8,9\n"
    assert path.read_bytes()[4:8] == bytes(4)  # no time of day: the same data give the same bytes
    path.write_text(f"{HEADER}\n1.5,2,3,4,5,6,7,8,9\n")
    assert read_imu(path) == (first,)
    write_imu(path, [])
    assert read_imu(path) == ()


def test_commands_come_back_as_they_were(tmp_path: Path) -> None:
    commands = Commands(
        Pose2(0.1, -1 / 3, 2e-17), np.random.default_rng(0).normal(size=(50, 3)) * (1.0, 1e-9, 1e9)
    )
    write_commands(tmp_path / "commands.csv", commands)
    read = read_commands(tmp_path / "commands.csv")
    assert read.start == commands.start
    assert np.array_equal(read.rows, commands.rows)


def test_evo_reads_the_same_trajectory(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    poses = [Pose3.from_rpy(*rng.uniform(-1, 1, 6)) for _ in range(9)]
    trajectory = Trajectory.from_poses((1.6e9 + np.arange(9) * 0.04).tolist(), poses)
    path = tmp_path / "t.tum"
    write_tum(path, trajectory)
    theirs = file_interface.read_tum_trajectory_file(str(path))
    np.testing.assert_allclose(theirs.positions_xyz, trajectory.positions, atol=1e-9)
    np.testing.assert_allclose(theirs.orientations_quat_wxyz, trajectory.quaternions, atol=1e-8)
    zipped = tmp_path / "z.tum"  # known by its content
    zipped.write_bytes(gzip.compress(path.read_bytes()))
    np.testing.assert_array_equal(read_tum(zipped).positions, read_tum(path).positions)


def test_every_number_of_a_pose_has_its_place(tmp_path: Path) -> None:
    """Quaternions need not be of unit length in the file."""
    path = tmp_path / "t.tum"
    path.write_bytes(b"# a\n\n10.5 1 -2 3 0.1 0.2 0.3 0.4\n  #b\n11 4 5 6 0 0 -2 0\n")
    read = read_tum(path)
    assert read.stamps.tolist() == [10.5, 11.0]
    assert read.positions.tolist() == [[1, -2, 3], [4, 5, 6]]
    expected = [np.array((0.4, 0.1, 0.2, 0.3)) / np.sqrt(0.3), (0, 0, 0, -1)]
    np.testing.assert_allclose(read.quaternions, expected, atol=1e-12)
    write_tum(path, read)
    header, _, line = path.read_text().splitlines()
    assert header == "# stamp[s] x y z[m] qx qy qz qw"
    assert line == " ".join(f"{value:.9f}" for value in (11, 4, 5, 6, 0, 0, -1, 0))


@pytest.mark.parametrize(
    ("name", "data", "reason"),
    [
        ("imu.csv.gz", b"", "line 1: the header stamp,.* is needed"),
        ("imu.csv.gz", gzip.compress(b"stamp\n1\n", mtime=0), r"line 1: the header .* got \['stamp'\]"),
        ("imu.csv.gz", f"{HEADER}\n1,2,3\n".encode(), "line 2: 9 finite numbers are needed, got '1,2,3'"),
        ("imu.csv.gz", f"{HEADER}\n1,2,3,4,5,6,7,8,inf\n".encode(), "line 2: 9 finite numbers"),
        ("imu.csv.gz", f"{HEADER}\n1,2,3,4,5,6,7,8,x\n".encode(), "line 2: 9 finite numbers"),
        ("imu.csv.gz", gzip.compress(HEADER.encode() * 50, mtime=0)[:60], "damaged or cut off"),
        ("commands.csv", b"", "line 1: commands begin with '# start X Y YAW', got ''"),
        ("commands.csv", b"\xff\xfe", "no text"),
        ("commands.csv", b"time,v,omega\n0,0,0\n", "line 1: commands begin"),
        ("commands.csv", b"# start 0 0\ntime,v,omega\n0,0,0\n", "line 1: commands begin"),
        ("commands.csv", b"# start 0 0 0\nv,omega\n0,0\n", "line 2: the header time,v,omega is needed"),
        ("commands.csv", b"# start 0 0 0\ntime,v,omega\n0,nan,0\n", "line 3: 3 finite numbers"),
        ("commands.csv", b"# start 0 0 0\ntime,v,omega\n0,0,0\n0.04,1\n", "line 4: 3 finite numbers"),
        ("bad.tum", b"", "a trajectory has 8 numbers a line"),
        ("bad.tum", b"# stamp x y z\n  \n", "a trajectory has 8 numbers a line"),
        ("bad.tum", b"1 2 3\n", "a trajectory has 8 numbers a line"),
        ("bad.tum", POSE + b"2 0 0 0\n", "not a trajectory"),
        ("bad.tum", b"a b c d e f g h\n", "not a trajectory"),
        ("bad.tum", bytes(range(128, 256)), "not a trajectory"),
        ("bad.tum", b"1 1e300 0 0 0 0 0 1\n", r"a position must be within 1e\+09 m"),
        ("bad.tum", b"1 0 nan 0 0 0 0 1\n", "must be finite"),
        ("bad.tum", b"1 0 0 0 0 0 0 0\n", "no quaternion zero"),
        ("bad.tum", POSE + b"2 0 0 0 0 0 0 0\n", "no quaternion zero"),
        ("bad.tum", gzip.compress(POSE * 99, mtime=0)[:-12], "the gzip stream is damaged or cut off"),
        ("bad.tum", gzip.compress(POSE * 99, mtime=0)[:12] + b"????", "damaged or cut off"),
    ],
)
def test_a_damaged_file_is_refused_in_one_line(name: str, data: bytes, reason: str, tmp_path: Path) -> None:
    path = tmp_path / name
    with refused(f"{path}: cannot be read: No such file"):
        READERS[name](path)
    path.write_bytes(data)
    with refused(f"{path}: ", reason):
        READERS[name](path)


def test_one_pose_is_a_trajectory(tmp_path: Path) -> None:
    (tmp_path / "t.tum").write_bytes(POSE)
    assert len(read_tum(tmp_path / "t.tum")) == 1
