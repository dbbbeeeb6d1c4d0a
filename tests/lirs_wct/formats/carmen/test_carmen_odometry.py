"""Odometry of a CARMEN log: which source is taken, and jumps that no robot makes."""

import math
from collections import Counter

import numpy as np
import pytest

from lirs_wct.formats.carmen.lines import Message
from lirs_wct.formats.carmen.repairs import odometry_of, without_jumps
from lirs_wct.geometry.pose import Pose2, Trajectory


def messages(stamps: list[float], poses: list[Pose2 | None]) -> list[Message]:
    return [Message(k, t, p) for k, (t, p) in enumerate(zip(stamps, poses, strict=True))]


def east(*x: float) -> list[Pose2 | None]:
    return [Pose2(value) for value in x]


def xs(poses: list[Pose2 | None]) -> list[float | None]:
    return [None if p is None else round(p.x, 9) for p in poses]


def found(
    lasers: list[Message], odoms: list[Message]
) -> tuple[list[float | None], list[float], list[float], dict[str, int]]:
    """Return x of each scan, stamps and x of the track, and what was repaired."""
    repaired = Counter[str]()
    poses, track = odometry_of([m.stamp for m in lasers], lasers, odoms, repaired)
    return xs(poses), track.stamps.tolist(), track.xy[:, 0].round(9).tolist(), dict(repaired)


def test_the_lasers_own_poses_come_first_and_the_wheels_fill_the_gaps() -> None:
    lasers = messages([1.0, 2.0, 3.0], east(0, 1, 2))
    odoms = messages([0.5, 1.0, 2.5, 3.5], east(-0.5, 0.25, 1.5, 2.5))
    # The wheels' pose at a scan's stamp is not taken; the others are put between.
    assert found(lasers, odoms) == ([0, 1, 2], [0.5, 1.0, 2.0, 2.5, 3.0, 3.5], [-0.5, 0, 1, 1.5, 2, 2.5], {})
    assert found(lasers, []) == ([0, 1, 2], [1.0, 2.0, 3.0], [0, 1, 2], {})


@pytest.mark.parametrize(("away", "merged"), [(0.99, True), (1.0, True), (1.01, False), (-1.01, False)])
def test_wheels_a_meter_away_are_of_another_frame(away: float, merged: bool) -> None:
    """The median of the distances, in the plane."""
    stamps = [0.0, 1.0, 2.0, 3.0, 4.0]
    lasers = messages(stamps, [Pose2(5.0 + k, 3.0) for k in range(5)])
    beside: list[Pose2 | None] = [Pose2(5.0 + k, 3.0 + away) for k in range(5)]
    beside[1] = Pose2(6.0, 50.0)
    odoms = messages([t + 1e-9 for t in stamps], beside)
    _, track, _, _ = found(lasers, odoms)
    assert len(track) == (10 if merged else 5)


def test_one_scan_alone_takes_the_wheels_of_any_frame() -> None:
    lasers, odoms = messages([1.0], east(0)), messages([0.0, 2.0], east(40, 50))
    assert found(lasers, odoms) == ([0], [0, 1, 2], [40, 0, 50], {})
    two = messages([1.0, 1.5], east(0, 1))
    assert found(two, odoms) == ([0, 1], [1, 1.5], [0, 1], {})


@pytest.mark.parametrize("own", [[None, None], [Pose2(3.0), Pose2(3.0)], [Pose2(3.0), None]])
def test_poses_that_never_change_are_none(own: list[Pose2 | None]) -> None:
    lasers = messages([1.0, 2.0], own)
    assert found(lasers, messages([0.0, 4.0], east(0, 8))) == ([2, 4], [0, 4], [0, 8], {})
    assert found(lasers, messages([0.0, 4.0], east(8, 8))) == ([None, None], [], [], {})
    assert found(lasers, messages([0.0], east(8))) == ([None, None], [], [], {})
    assert found(lasers, []) == ([None, None], [], [], {})


@pytest.mark.parametrize("step", [Pose2(1e-3), Pose2(0, 1e-3), Pose2(0, 0, 1e-3)])
def test_any_motion_is_odometry(step: Pose2) -> None:
    lasers = messages([1.0, 2.0], [Pose2(5.0, 6.0, 7.0), Pose2(5.0, 6.0, 7.0) @ step])
    poses, track = odometry_of([1.0, 2.0], lasers, [], Counter())
    assert poses == [m.base for m in lasers]
    assert len(track) == 2


def test_a_single_scan_keeps_its_pose() -> None:
    assert found(messages([1.0], east(4)), []) == ([4], [1], [4], {})
    assert found(messages([1.0], [None]), []) == ([None], [], [], {})


# ---- jumps


def track(stamps: list[float], x: list[float], y: list[float] | None = None) -> Trajectory:
    ys = y or [0.0] * len(x)
    return Trajectory.from_poses(stamps, [Pose2(a, b, 0.3) for a, b in zip(x, ys, strict=True)])


FAR, ANEW = (
    "odometry far from that before and after, taken from between",
    "jumps of the odometry, taken for standing still",
)


@pytest.mark.parametrize(
    ("seconds", "meters", "sound"),
    [(0.1, 5.0, True), (0.1, 5.01, False), (1.0, 30.0, True), (1.0, 30.1, False), (0.5, 14.9, True)],
)
def test_what_is_no_motion_of_a_robot(seconds: float, meters: float, sound: bool) -> None:
    """More than 5 m, and more than 30 m/s; the same sideways."""
    stamps = [10.0, 10.0 + seconds]
    for at in (track(stamps, [7.0, 7.0 + meters]), track(stamps, [7.0, 7.0], [-2.0, -2.0 - meters])):
        repaired = Counter[str]()
        kept = without_jumps(at, repaired)
        assert (kept is at) == sound
        assert repaired == ({} if sound else {ANEW: 1})
        if not sound:
            np.testing.assert_allclose(kept.positions, np.repeat(at.positions[:1], 2, axis=0), atol=1e-9)


def test_poses_far_off_are_taken_from_between() -> None:
    x = [0.0, 1.0, 2.0, 900.0, -700.0, 5.0, 6.0]
    repaired = Counter[str]()
    kept = without_jumps(track([float(k) for k in range(7)], x), repaired)
    np.testing.assert_allclose(kept.xy[:, 0], range(7), atol=1e-9)
    assert repaired == {FAR: 2}
    assert kept.stamps.tolist() == list(range(7))


@pytest.mark.parametrize(("away", "back"), [(5, True), (6, False)])
def test_within_five_poses_a_track_may_come_back(away: int, back: bool) -> None:
    n = 2 + away + 3
    x = [float(k) for k in range(n)]
    for k in range(2, 2 + away):
        x[k] += 10_000.0
    repaired = Counter[str]()
    kept = without_jumps(track([float(k) for k in range(n)], x), repaired)
    if back:
        assert repaired == {FAR: away}
        np.testing.assert_allclose(kept.xy[:, 0], range(n), atol=1e-9)
    else:
        assert repaired == {ANEW: 2}
        steps = np.diff(kept.xy[:, 0])
        np.testing.assert_allclose(
            steps, [0.0 if k in (1, 1 + away) else 1.0 for k in range(n - 1)], atol=1e-9
        )


def test_after_a_jump_the_motion_goes_on_in_the_old_frame() -> None:
    """The odometry is set to zero at a place where the robot looks north: it goes on northward."""
    poses = [Pose2(10.0, 0.0, math.pi / 2), Pose2(10.0, 2.0, math.pi / 2)]
    anew = [Pose2(-90.0, 0.0, 0.0), Pose2(-88.0, 0.0, 0.0), Pose2(-88.0, 1.0, 0.5)]
    repaired = Counter[str]()
    kept = without_jumps(Trajectory.from_poses([0.0, 1.0, 2.0, 3.0, 4.0], [*poses, *anew]), repaired)
    np.testing.assert_allclose(kept.xy, [(10, 0), (10, 2), (10, 2), (10, 4), (9, 4)], atol=1e-9)
    np.testing.assert_allclose(kept.yaw, np.pi / 2 + np.array([0, 0, 0, 0, 0.5]), atol=1e-9)
    assert repaired == {ANEW: 1}


def test_scans_take_repaired_poses() -> None:
    lasers = messages([0.0, 1.0, 2.0, 3.0], east(0, 1, 500, 3))
    # The wheels are left out where the scans' own poses had to be repaired.
    assert found(lasers, messages([0.5], east(0.5))) == ([0, 1, 2, 3], [0, 1, 2, 3], [0, 1, 2, 3], {FAR: 1})
    wheels = messages([0.0, 1.0, 2.0, 3.0], east(0, 2, 500, 6))
    still = messages([0.5, 2.5], east(9, 9))
    assert found(still, wheels) == ([1, 5], [0, 1, 2, 3], [0, 2, 4, 6], {FAR: 1})
