"""References and true trajectories of logs."""

import gzip
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from lirs_validation.logs.read_log import read_reference, truth_in_time
from lirs_validation.metrics.trajectory import RelativePoseConstraint
from lirs_wct.errors import SourceError
from lirs_wct.formats.drive_files import write_tum
from lirs_wct.formats.laser_log import LineStamps
from lirs_wct.geometry.pose import Pose2, Trajectory
from tests.kit import refused
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


@pytest.mark.parametrize("content", [b"", b"\x89PNG\x00", b"VERTEX2 0 1 2 3\n", b"1 2 3\n", b"\x1f\x8b\x08"])
def test_what_is_neither_is_refused_in_one_line(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "bad").write_bytes(content)
    with refused(f"{tmp_path / 'bad'}: "):
        read_reference(tmp_path / "bad")


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
