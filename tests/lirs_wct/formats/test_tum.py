"""TUM trajectories: quaternions xyzw in the file, wxyz inside."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest
from evo.tools import file_interface

from lirs_wct.errors import SourceError
from lirs_wct.formats.tum import read_tum, write_tum
from lirs_wct.geometry.pose import Pose3
from lirs_wct.geometry.trajectory import Trajectory


@pytest.fixture
def trajectory() -> Trajectory:
    rng = np.random.default_rng(1)
    poses = [Pose3.from_rpy(*rng.uniform(-1, 1, 6)) for _ in range(9)]
    return Trajectory.from_poses((1.6e9 + np.arange(9) * 0.04).tolist(), poses)


def test_reads_back(trajectory: Trajectory, tmp_path: Path) -> None:
    write_tum(tmp_path / "t.tum", trajectory)
    again = read_tum(tmp_path / "t.tum")
    np.testing.assert_allclose(again.stamps, trajectory.stamps, atol=1e-6)
    np.testing.assert_allclose(again.positions, trajectory.positions, atol=1e-9)
    np.testing.assert_allclose(again.quaternions, trajectory.quaternions, atol=1e-8)


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
    "not finite": b"1 0 nan 0 0 0 0 1\n",
    "no rotation": b"1 0 0 0 0 0 0 0\n",
    "the same stamp twice": POSE * 2,
    "binary": bytes(range(128, 256)),
    "cut gzip": gzip.compress(POSE * 99)[:-12],
    "damaged gzip": gzip.compress(POSE * 99)[:12] + b"????",
}


@pytest.mark.parametrize("case", BAD)
def test_what_is_none_is_refused_in_one_line(case: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.tum"
    path.write_bytes(BAD[case])
    with pytest.raises(SourceError) as told:
        read_tum(path)
    assert str(told.value).startswith(f"{path}: ")
    assert "\n" not in str(told.value)


def test_what_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match=r"none\.tum: No such file"):
        read_tum(tmp_path / "none.tum")
