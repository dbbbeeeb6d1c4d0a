"""Rising stamps and the odometry of a laser log.

A plain twin holds the definition line by line, with pools of adjacent violators by hand.
"""

import math
import warnings
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from lirs_wct.formats.carmen_log import read_carmen
from lirs_wct.formats.laser_log import LaserLog, LineStamps, Message, in_file_order, odometry_of
from lirs_wct.geometry.pose import Pose2
from tests.lirs_wct.formats.carmen_room import PERIOD, START, room_lines, write_log

RANGES = np.full(3, 2.0, np.float32)


def pooled(values: list[float]) -> list[float]:
    """Return the rising values nearest to some, in the least squares' sense: neighbors that fall are one."""
    pools: list[list[float]] = []
    for value in values:
        pools.append([value])
        while len(pools) > 1 and np.mean(pools[-2]) >= np.mean(pools[-1]):
            last = pools.pop()
            pools[-1] += last
    return [float(np.mean(pool)) for pool in pools for _ in pool]


def least_steps(stamps: list[float], poses: list[Pose2]) -> list[float]:
    """Return the least seconds between lines: what their motion takes at the log's own speed limit."""
    n = min(20, len(stamps) - 1)
    windows = [(k, k + n) for k in range(len(stamps) - n)]
    pace = float(np.median([stamps[b] - stamps[a] for a, b in windows])) / n
    if pace <= 0:
        pace = (max(stamps) - min(stamps)) / (len(stamps) - 1) or 0.1
    meters = [math.dist((p.x, p.y), (q.x, q.y)) for p, q in pairwise(poses)]
    radians = [abs(math.remainder(q.yaw - p.yaw, math.tau)) for p, q in pairwise(poses)]
    takes = [0.0] * len(meters)
    for steps in (meters, radians):
        speeds = [sum(steps[a:b]) / max(stamps[b] - stamps[a], n * pace / 2) for a, b in windows]
        limit = 1.25 * float(np.percentile(speeds, 99))
        if limit > 0:
            takes = [max(t, step / limit) for t, step in zip(takes, steps, strict=True)]
    return [min(max(t, 1e-3), max(pace, 1e-3)) for t in takes]


def twin(logged: list[float], poses: list[Pose2]) -> list[float]:
    start = float(np.median(logged))
    stamps = [t - start for t in logged]
    least = np.concatenate(((0.0,), np.cumsum(least_steps(stamps, poses))))
    rising = np.array(pooled((np.array(stamps) - least).tolist())) + least + start
    return [old if abs(new - old) < 1e-6 else new for new, old in zip(rising.tolist(), logged, strict=True)]


def lines(logged: list[float], poses: list[Pose2 | None], scans: list[bool]) -> list[Message]:
    """Return messages in the order of the file."""
    plain = [Message(k, t, p) for k, (t, p) in enumerate(zip(logged, poses, strict=True))]
    return [replace(m, ranges=RANGES) if scan else m for m, scan in zip(plain, scans, strict=True)]


def repaired(messages: list[Message]) -> list[float]:
    """Return the stamps as repaired; the messages come back in their order with them."""
    scans = [m for m in messages if len(m.ranges)]
    odoms = [m for m in messages if not len(m.ranges)]
    got_scans, got_odoms, found = in_file_order(scans, odoms)
    assert [m.line for m in got_scans] == [m.line for m in scans]
    assert [m.line for m in got_odoms] == [m.line for m in odoms]
    by_line = sorted([*got_scans, *got_odoms], key=lambda m: m.line)
    assert [m.stamp for m in by_line] == found.repaired.tolist()
    assert found.logged.tolist() == [m.stamp for m in messages]
    assert found.scans.tolist() == [len(m.ranges) > 0 for m in messages]
    return found.repaired.tolist()


@given(st.integers(0, 2**32 - 1), st.sampled_from((2, 3, 8, 21, 22, 60)))
def test_bursts_and_delays(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    logged = (
        1e6 + np.cumsum(rng.exponential(0.2, n)) + rng.exponential(0.3, n) * (rng.random(n) < 0.3)
    ).round(3)
    logged[-1] = logged[max(0, n - 9) : n - 1].min()  # at least one stamp goes back or repeats
    steps = rng.normal(0, (0.1, 0.02, 0.3), (n, 3)) * (rng.random((n, 1)) < 0.8) + (1e-4, 0, 0)
    steps[0, 2] += 3.0  # the yaw crosses pi
    if seed % 4 == 0:
        steps[n // 2, 0] += 1e4  # a jump of the odometry takes no time
    poses = [Pose2() @ Pose2(*row) for row in np.cumsum(steps, axis=0).tolist()]
    scans = [True, True, *(rng.random(n - 2) < 0.5).tolist()]  # two poses of scans: they have their own
    found = repaired(lines(logged.tolist(), list(poses), scans))
    np.testing.assert_allclose(found, twin(logged.tolist(), poses), atol=2e-6, rtol=0)


def test_stamps_that_rise_stay_to_the_bit() -> None:
    logged = START + np.cumsum(np.random.default_rng(2).exponential(PERIOD, 200) + 1e-6)
    assert repaired(lines(logged.tolist(), list(east(200)), [True, False] * 100)) == logged.tolist()


@given(
    st.lists(st.floats(-2.0, 2.0), min_size=2, max_size=60), st.lists(st.booleans(), min_size=60, max_size=60)
)
def test_any_stamps_rise_in_the_order_of_the_file(jitter: list[float], standing: list[bool]) -> None:
    n = len(jitter)
    logged = np.round(START + PERIOD * np.arange(n) + np.array(jitter), 6)
    poses = [Pose2(x) for x in np.cumsum(np.where(standing[:n], 0.0, 0.06)).tolist()]
    kinds = ([True, False] * n)[:n]
    found = np.array(repaired(lines(logged.tolist(), list(poses), kinds)))
    assert (np.diff(found[::2]) > 0).all()
    assert (np.diff(found) >= 0).all()
    assert (found.min(), found.max()) >= (logged.min() - 5, logged.min())
    again = repaired(lines(found.tolist(), list(poses), kinds))
    assert np.abs(np.array(again) - found).max() < 0.5


def east(n: int) -> list[Pose2]:
    return [Pose2(0.1 * k) for k in range(n)]


@pytest.mark.parametrize(
    ("scan", "step", "sound"),
    [
        ([True, True, True], [0.1, 0.1], False),
        ([True, False, True], [0.1, 0.1], False),
        ([True, False, True], [0.1, 0.0], True),  # the scan's own odometry, at the same stamp
        ([True, True, True], [0.1, 0.0], False),  # two scans cannot share a stamp
    ],
)
def test_when_a_stamp_may_repeat(scan: list[bool], step: list[float], sound: bool) -> None:
    x = np.cumsum([0.0, *step]).tolist()
    logged = [1.0, 2.0, 2.0]
    assert (repaired(lines(logged, [Pose2(v) for v in x], scan)) == logged) == sound


def test_scans_and_odometry_one_after_the_other_are_merged_by_stamp() -> None:
    scans = [replace(m, ranges=RANGES) for m in lines([0.5, 20.5], list(east(2)), [False] * 2)]
    for back, merged in ((9.0, False), (30.0, True)):
        odoms = [Message(2 + k, 20.5 - back + k, Pose2(0.1 * k)) for k in range(3)]
        *_, found = in_file_order(scans, odoms)
        stamps = [0.5, 20.5, *(20.5 - back + k for k in range(3))]
        assert found.logged.tolist() == (sorted(stamps) if merged else stamps)


@pytest.mark.parametrize("meters", [0.0, 0.1])
def test_a_log_without_a_clock_gets_steps_of_its_own(meters: float) -> None:
    """A tenth of a second a line, half of it in a burst: 2 m/s, and a quarter more is the limit."""
    n = 30
    poses = [Pose2(meters * k) for k in range(n)]
    found = repaired(lines([5.0] * n, list(poses), [True] * n))
    np.testing.assert_allclose(np.diff(found), 0.04 if meters else 1e-3, atol=1e-9)
    assert np.mean(found) == pytest.approx(5.0)


# ---- what is said about them


def test_counts_by_hand() -> None:
    found = LineStamps(
        np.array([0.0, 2.0, 1.0, 1.0, 1.0, 5.0]),
        np.array([0.0, 1.0, 1.25, 1.5, 1.75, 5.0]),
        np.array([True, False, True, False, True, False]),
    )
    assert (found.back, found.repeated, found.moved, found.furthest) == (1, 2, 4, 1.0)
    assert found.summary() == (
        "stamps go back at 1 of 5 steps and repeat at 2: "
        "the order of the file is kept, 4 stamps moved by up to 1.00 s"
    )
    nothing = LineStamps(np.array([1.0]), np.array([1.0]), np.array([True]))
    assert (nothing.back, nothing.repeated, nothing.moved, nothing.furthest) == (0, 0, 0, 0.0)


@pytest.mark.parametrize(
    ("asked", "expected"),
    [(-3.0, -3.0), (0.49, 0.49), (0.5, 0.75), (1.0, 1.25), (1.4, 1.65), (2.0, 2.5), (9.0, 9.5)],
)
def test_a_stamp_moves_as_the_nearest_line_did(asked: float, expected: float) -> None:
    """Lines at 0, 1 and 2 s moved by 0, 1/4 and 1/2 s; halfway the later one counts."""
    found = LineStamps(np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.25, 2.5]), np.array([True] * 3))
    assert found.repaired_at(np.array([asked])).tolist() == [expected]
    # Of the two lines at 3 s the scan's.
    logged, moved = np.array([0.0, 1.0, 3.0, 2.0, 3.0, 4.0]), np.array([0.0, 1.0, 2.2, 2.6, 3.0, 4.0])
    assert (
        LineStamps(logged, moved, np.array([1, 0, 0, 1, 1, 0], np.bool_)).repaired_at(np.array([3.0])) == 3.0
    )


# ---- whole logs


def read_with_stamps(tmp_path: Path, stamps: list[float]) -> LaserLog:
    text, _ = room_lines(len(stamps))
    late = [
        line.replace(f" {START + PERIOD * k:.6f} ", f" {t:.6f} ")
        for k, (line, t) in enumerate(zip(text, stamps, strict=True))
    ]
    return read_carmen(write_log(tmp_path / "late.clf", late))


def test_the_same_scans_and_odometry_in_the_same_order_whatever_the_stamps(tmp_path: Path) -> None:
    true = START + PERIOD * np.arange(60)
    late = np.repeat(true[4::5], 5)  # bursts of five lines
    late[3::4] += np.random.default_rng(4).exponential(0.9, 15)
    with warnings.catch_warnings(action="error"):
        sound = read_with_stamps(tmp_path, true.tolist())
    with pytest.warns(UserWarning, match=r"late\.clf: stamps go back at \d+ of 59 steps .*file is kept"):
        found = read_with_stamps(tmp_path, late.tolist())
    assert sound.odometry == found.odometry
    assert all(np.array_equal(a.ranges, b.ranges) for a, b in zip(sound.scans, found.scans, strict=True))
    assert (np.diff(found.stamps) > 0).all()
    assert found.lines.moved > sound.lines.moved == 0


@pytest.mark.slow
@pytest.mark.shared
def test_the_intel_log_is_the_same_with_the_stamps_as_logged(shared_data: Path) -> None:
    folder = shared_data / "logs" / "intel"
    sound = read_carmen(folder / "intel.clf.gz")
    with pytest.warns(UserWarning, match="629 of 13,630 steps and repeat at 2,459"):
        logged = read_carmen(folder / "stamps_as_logged.clf.gz")
    assert (logged.lines.back, logged.lines.repeated, sound.lines.moved) == (629, 2459, 0)
    assert sound.odometry == logged.odometry
    assert np.array_equal(sound.track.positions, logged.track.positions)
    for a, b in zip(sound.scans, logged.scans, strict=True):
        assert np.array_equal(a.ranges, b.ranges, equal_nan=True)
    step = np.linalg.norm(np.diff(logged.track.xy, axis=0), axis=1)
    assert np.percentile(step / np.diff(logged.track.stamps), 99.9) < 0.6
    # The sound file's stamps are smoothed, too: two ways to repair the same ones.
    assert np.abs(logged.stamps - sound.stamps).mean() < 0.25


def messages(stamps: list[float], poses: list[Pose2 | None]) -> list[Message]:
    return [Message(k, t, p) for k, (t, p) in enumerate(zip(stamps, poses, strict=True))]


def at(*x: float) -> list[Pose2 | None]:
    return [Pose2(value) for value in x]


def xs(poses: list[Pose2 | None]) -> list[float | None]:
    return [None if p is None else round(p.x, 9) for p in poses]


def found(lasers: list[Message], odoms: list[Message]) -> tuple[list[float | None], list[float], list[float]]:
    """Return x of each scan, and stamps and x of the track."""
    poses, track = odometry_of(lasers, odoms)
    return xs(poses), track.stamps.tolist(), track.xy[:, 0].round(9).tolist()


def test_the_lasers_own_poses_come_first_and_the_wheels_fill_the_gaps() -> None:
    lasers = messages([1.0, 2.0, 3.0], at(0, 1, 2))
    odoms = messages([0.5, 1.0, 2.5, 3.5], at(-0.5, 0.25, 1.5, 2.5))
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


@pytest.mark.parametrize("own", [[None, None], [Pose2(3.0), Pose2(3.0)], [Pose2(3.0), None]])
def test_poses_that_never_change_are_none(own: list[Pose2 | None]) -> None:
    lasers = messages([1.0, 2.0], own)
    assert found(lasers, messages([0.0, 4.0], at(0, 8))) == ([2, 4], [0, 4], [0, 8])
    assert found(lasers, messages([0.0, 4.0], at(8, 8))) == ([None, None], [], [])
    assert found(lasers, messages([0.0], at(8))) == ([None, None], [], [])
    assert found(lasers, []) == ([None, None], [], [])


def test_a_single_scan_keeps_its_pose() -> None:
    assert found(messages([1.0], at(4)), []) == ([4], [1], [4])
    assert found(messages([1.0], [None]), []) == ([None], [], [])
