"""TUM trajectories: quaternions xyzw in the file, wxyz inside."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from evo.tools import file_interface

from lirs_wct.errors import SourceError
from lirs_wct.formats.tum import read_tum, write_tum
from lirs_wct.pose import Pose3
from lirs_wct.trajectory import Trajectory


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


@pytest.mark.parametrize("text", ["", "1 2 3\n", "a b c d e f g h\n", "1 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n"])
def test_what_is_none_is_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.tum"
    path.write_text(text)
    with pytest.raises(SourceError, match=r"bad\.tum: "):
        read_tum(path)
    with pytest.raises(SourceError, match=r"none\.tum: "):
        read_tum(tmp_path / "none.tum")
