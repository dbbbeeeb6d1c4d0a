"""Odometry of a CARMEN log: which source is taken."""

import pytest

from lirs_wct.formats.carmen.lines import Message
from lirs_wct.formats.carmen.repairs import odometry_of
from lirs_wct.geometry.pose import Pose2


def messages(stamps: list[float], poses: list[Pose2 | None]) -> list[Message]:
    return [Message(k, t, p) for k, (t, p) in enumerate(zip(stamps, poses, strict=True))]


def east(*x: float) -> list[Pose2 | None]:
    return [Pose2(value) for value in x]


def xs(poses: list[Pose2 | None]) -> list[float | None]:
    return [None if p is None else round(p.x, 9) for p in poses]


def found(lasers: list[Message], odoms: list[Message]) -> tuple[list[float | None], list[float], list[float]]:
    """Return x of each scan, and stamps and x of the track."""
    poses, track = odometry_of([m.stamp for m in lasers], lasers, odoms)
    return xs(poses), track.stamps.tolist(), track.xy[:, 0].round(9).tolist()


def test_the_lasers_own_poses_come_first_and_the_wheels_fill_the_gaps() -> None:
    lasers = messages([1.0, 2.0, 3.0], east(0, 1, 2))
    odoms = messages([0.5, 1.0, 2.5, 3.5], east(-0.5, 0.25, 1.5, 2.5))
    # The wheels' pose at a scan's stamp is not taken; the others are put between.
    assert found(lasers, odoms) == ([0, 1, 2], [0.5, 1.0, 2.0, 2.5, 3.0, 3.5], [-0.5, 0, 1, 1.5, 2, 2.5])
    assert found(lasers, []) == ([0, 1, 2], [1.0, 2.0, 3.0], [0, 1, 2])


@pytest.mark.parametrize(("away", "merged"), [(0.99, True), (1.0, True), (1.01, False), (-1.01, False)])
def test_wheels_a_meter_away_are_of_another_frame(away: float, merged: bool) -> None:
    """The median of the distances, in the plane."""
    stamps = [0.0, 1.0, 2.0, 3.0, 4.0]
    lasers = messages(stamps, [Pose2(5.0 + k, 3.0) for k in range(5)])
    beside: list[Pose2 | None] = [Pose2(5.0 + k, 3.0 + away) for k in range(5)]
    beside[1] = Pose2(6.0, 50.0)
    odoms = messages([t + 1e-9 for t in stamps], beside)
    _, track, _ = found(lasers, odoms)
    assert len(track) == (10 if merged else 5)


def test_one_scan_alone_takes_the_wheels_of_any_frame() -> None:
    lasers, odoms = messages([1.0], east(0)), messages([0.0, 2.0], east(40, 50))
    assert found(lasers, odoms) == ([0], [0, 1, 2], [40, 0, 50])
    two = messages([1.0, 1.5], east(0, 1))
    assert found(two, odoms) == ([0, 1], [1, 1.5], [0, 1])


@pytest.mark.parametrize("own", [[None, None], [Pose2(3.0), Pose2(3.0)], [Pose2(3.0), None]])
def test_poses_that_never_change_are_none(own: list[Pose2 | None]) -> None:
    lasers = messages([1.0, 2.0], own)
    assert found(lasers, messages([0.0, 4.0], east(0, 8))) == ([2, 4], [0, 4], [0, 8])
    assert found(lasers, messages([0.0, 4.0], east(8, 8))) == ([None, None], [], [])
    assert found(lasers, messages([0.0], east(8))) == ([None, None], [], [])
    assert found(lasers, []) == ([None, None], [], [])


@pytest.mark.parametrize("step", [Pose2(1e-3), Pose2(0, 1e-3), Pose2(0, 0, 1e-3)])
def test_any_motion_is_odometry(step: Pose2) -> None:
    lasers = messages([1.0, 2.0], [Pose2(5.0, 6.0, 7.0), Pose2(5.0, 6.0, 7.0) @ step])
    poses, track = odometry_of([1.0, 2.0], lasers, [])
    assert poses == [m.base for m in lasers]
    assert len(track) == 2


def test_a_single_scan_keeps_its_pose() -> None:
    assert found(messages([1.0], east(4)), []) == ([4], [1], [4])
    assert found(messages([1.0], [None]), []) == ([None], [], [])
