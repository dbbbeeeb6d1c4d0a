"""TUM trajectories: quaternions xyzw in the file, wxyz inside."""

import gzip
from pathlib import Path

import numpy as np
import pytest
from evo.tools import file_interface

from lirs_wct.errors import SourceError
from lirs_wct.formats.tum import read_tum, write_tum
from lirs_wct.geometry.pose import Pose3, Trajectory
from tests.kit import refused


@pytest.fixture
def trajectory() -> Trajectory:
    rng = np.random.default_rng(1)
    poses = [Pose3.from_rpy(*rng.uniform(-1, 1, 6)) for _ in range(9)]
    return Trajectory.from_poses((1.6e9 + np.arange(9) * 0.04).tolist(), poses)


def test_evo_reads_the_same(trajectory: Trajectory, tmp_path: Path) -> None:
    write_tum(tmp_path / "t.tum", trajectory)
    theirs = file_interface.read_tum_trajectory_file(str(tmp_path / "t.tum"))
    np.testing.assert_allclose(theirs.positions_xyz, trajectory.positions, atol=1e-9)
    np.testing.assert_allclose(theirs.orientations_quat_wxyz, trajectory.quaternions, atol=1e-8)


def test_gzip_is_known_by_its_content(trajectory: Trajectory, tmp_path: Path) -> None:
    write_tum(tmp_path / "t.tum", trajectory)
    (tmp_path / "z.tum").write_bytes(gzip.compress((tmp_path / "t.tum").read_bytes()))
    np.testing.assert_array_equal(
        read_tum(tmp_path / "z.tum").positions, read_tum(tmp_path / "t.tum").positions
    )


POSE = b"1 0 0 0 0 0 0 1\n"
BAD = {
    "empty": b"",
    "comments": b"# stamp x y z\n  \n",
    "three numbers": b"1 2 3\n",
    "one line short": POSE + b"2 0 0 0\n",
    "words": b"a b c d e f g h\n",
    "too far": b"1 1e300 0 0 0 0 0 1\n",
    "not finite": b"1 0 nan 0 0 0 0 1\n",
    "no rotation": b"1 0 0 0 0 0 0 0\n",
    "one without rotation": POSE + b"2 0 0 0 0 0 0 0\n",
    "binary": bytes(range(128, 256)),
    "cut gzip": gzip.compress(POSE * 99)[:-12],
    "damaged gzip": gzip.compress(POSE * 99)[:12] + b"????",
}


@pytest.mark.parametrize("case", BAD)
def test_what_is_none_is_refused_in_one_line(case: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.tum"
    path.write_bytes(BAD[case])
    with refused(f"{path}: "):
        read_tum(path)


def test_what_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match=r"none\.tum: cannot be read: No such file"):
        read_tum(tmp_path / "none.tum")


def test_every_number_has_its_place(tmp_path: Path) -> None:
    """Quaternions need not be of unit length in the file."""
    path = tmp_path / "t.tum"
    path.write_bytes(b"# a\n\n10.5 1 -2 3 0.1 0.2 0.3 0.4\n  #b\n11 4 5 6 0 0 -2 0\n")
    found = read_tum(path)
    assert found.stamps.tolist() == [10.5, 11.0]
    assert found.positions.tolist() == [[1, -2, 3], [4, 5, 6]]
    expected = [np.array((0.4, 0.1, 0.2, 0.3)) / np.sqrt(0.3), (0, 0, 0, -1)]
    np.testing.assert_allclose(found.quaternions, expected, atol=1e-12)
    write_tum(path, found)
    assert path.read_text().splitlines()[0] == "# stamp[s] x y z[m] qx qy qz qw"
    words = path.read_text().splitlines()[2].split()
    assert words == ["11.000000000", "4.000000000", "5.000000000", "6.000000000",
                     "0.000000000", "0.000000000", "-1.000000000", "0.000000000"]  # fmt: skip


def test_one_pose_is_a_trajectory(tmp_path: Path) -> None:
    (tmp_path / "t.tum").write_bytes(POSE)
    assert len(read_tum(tmp_path / "t.tum")) == 1
