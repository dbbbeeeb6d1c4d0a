"""A reference trajectory is told by its first word: a number is TUM, a name is CARMEN."""

import gzip
from pathlib import Path

import numpy as np
import pytest

from lirs_validation.logs.reference import read_reference
from lirs_wct.errors import SourceError
from lirs_wct.formats.tum import write_tum
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.trajectory import Trajectory
from tests.lirs_wct.formats.carmen.carmen_room import START, room_lines, write_log


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
    with pytest.raises(SourceError) as told:
        read_reference(tmp_path / "bad")
    assert str(told.value).startswith(f"{tmp_path / 'bad'}: ")
    assert "\n" not in str(told.value)


def test_a_log_without_poses_is_no_reference(tmp_path: Path) -> None:
    path = write_log(tmp_path / "still.clf", room_lines(5, drifting=False)[0])
    with pytest.raises(SourceError, match="holds no poses that change"):
        read_reference(path)
