"""Stamps that go back, repeat or leap: the order of the file stays, and the stamps rise plausibly."""

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lirs_wct.arrays import FloatArray
from lirs_wct.formats.carmen.lines import Message
from lirs_wct.formats.carmen.log import read_carmen
from lirs_wct.formats.carmen.repairs import in_file_order
from lirs_wct.formats.laser_log import LaserLog, LineStamps
from lirs_wct.geometry.pose import Pose2
from tests.lirs_wct.formats.carmen.carmen_room import PERIOD, START, room_lines, write_log

RANGES = np.full(3, 2.0, np.float32)
SPEED = 0.3


def drive(stamps: FloatArray, poses: FloatArray | None = None) -> tuple[list[Message], list[Message]]:
    """Scans and ODOM lines in turn, every second one a scan, a robot that drives straight on."""
    x = SPEED * PERIOD * np.arange(len(stamps)) if poses is None else poses
    lines = [
        Message(k, t, Pose2(p)) for k, (t, p) in enumerate(zip(stamps.tolist(), x.tolist(), strict=True))
    ]
    return [replace(m, ranges=RANGES) for m in lines[::2]], lines[1::2]


def repaired(stamps: FloatArray, poses: FloatArray | None = None) -> LineStamps:
    scans, odoms, lines = in_file_order(*drive(stamps, poses))
    by_line = sorted([*scans, *odoms], key=lambda m: m.line)
    assert [m.stamp for m in by_line] == lines.repaired.tolist()
    assert [m.line for m in by_line] == list(range(len(stamps)))
    return lines


def steady(n: int) -> FloatArray:
    return np.asarray(START + PERIOD * np.arange(n), np.float64)


def late_in_bursts(true: FloatArray, seed: int = 4, most: int = 11) -> FloatArray:
    """Every line as late as the end of its burst, and every other ODOM line later still."""
    rng, logged, k = np.random.default_rng(seed), true.copy(), 0
    while k < len(true):
        n = int(rng.integers(1, most + 1)) if rng.random() < 0.1 else 1
        logged[k : k + n] = true[min(k + n, len(true)) - 1]
        k += n
    logged[3::4] += rng.exponential(0.3, len(logged[3::4]))
    return logged


def test_bursts_are_spread_and_no_speed_is_beyond_the_drive() -> None:
    true = steady(400)
    logged = late_in_bursts(true)
    assert (np.diff(logged) < 0).sum() > 20
    assert (np.diff(logged) == 0).sum() > 50
    lines = repaired(logged)
    assert (lines.back, lines.repeated) == ((np.diff(logged) < 0).sum(), (np.diff(logged) == 0).sum())
    speeds = SPEED * PERIOD / np.diff(lines.repaired)
    assert speeds.max() < 2.5 * SPEED
    delay = np.mean(logged - true)
    assert np.abs(lines.repaired - true - delay).mean() < 0.85 * np.abs(logged - true - delay).mean()


def test_stamps_that_rise_stay_to_the_bit() -> None:
    rng = np.random.default_rng(2)
    logged = START + np.cumsum(rng.exponential(PERIOD, 200) + 1e-6)
    lines = repaired(logged)
    assert lines.repaired.tobytes() == logged.tobytes()
    assert (lines.moved, lines.furthest) == (0, 0.0)


def test_a_jump_of_the_odometry_does_not_stretch_the_stamps() -> None:
    logged, poses = late_in_bursts(steady(200)), np.asarray(SPEED * PERIOD * np.arange(200), np.float64)
    poses[100:] += 1e9
    lines = repaired(logged, poses)
    assert lines.furthest < 3.0


@given(
    st.lists(st.floats(-2.0, 2.0), min_size=2, max_size=60), st.lists(st.booleans(), min_size=60, max_size=60)
)
def test_any_stamps_rise_in_the_order_of_the_file(jitter: list[float], standing: list[bool]) -> None:
    logged = np.round(steady(len(jitter)) + np.array(jitter), 6)
    poses = np.cumsum(np.where(standing[: len(jitter)], 0.0, SPEED * PERIOD))
    lines = repaired(logged, poses)
    scans = lines.repaired[lines.scans]
    assert (np.diff(scans) > 0).all()
    assert (np.diff(lines.repaired) >= 0).all()
    assert (lines.repaired.min(), lines.repaired.max()) >= (logged.min() - 5, logged.min())
    again = repaired(lines.repaired, poses)
    assert np.abs(again.repaired - lines.repaired).max() < 0.5


def test_logged_stamps_are_found_where_their_lines_went() -> None:
    logged = np.array([0.0, 1.0, 3.0, 2.0, 3.0, 4.0])
    lines = LineStamps(
        logged, np.array([0.0, 1.0, 2.2, 2.6, 3.0, 4.0]), np.array([1, 0, 0, 1, 1, 0], np.bool_)
    )
    # Of the two lines at 3 s the scan's; 1.1 s is a tenth after the line that stayed.
    np.testing.assert_allclose(
        lines.repaired_at(np.array([0.0, 1.1, 2.0, 3.0, 9.0])), [0, 1.1, 2.6, 3.0, 9.0]
    )


def read_with_stamps(tmp_path: Path, stamps: list[float]) -> LaserLog:
    lines, _ = room_lines(len(stamps))
    late = [
        line.replace(f" {START + PERIOD * k:.6f} ", f" {t:.6f} ")
        for k, (line, t) in enumerate(zip(lines, stamps, strict=True))
    ]
    return read_carmen(write_log(tmp_path / "late.clf", late))


def test_the_same_scans_and_odometry_in_the_same_order_whatever_the_stamps(tmp_path: Path) -> None:
    true = steady(60)
    sound = read_with_stamps(tmp_path, true.tolist())
    with pytest.warns(UserWarning, match=r"late\.clf: stamps go back at \d+ of 59 steps .*file is kept"):
        late = read_with_stamps(tmp_path, late_in_bursts(true).tolist())
    assert sound.odometry == late.odometry
    assert all(np.array_equal(a.ranges, b.ranges) for a, b in zip(sound.scans, late.scans, strict=True))
    assert (np.diff(late.stamps) > 0).all()
    assert late.lines.moved > 0


def test_a_sound_log_is_read_without_a_warning(tmp_path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read_with_stamps(tmp_path, steady(20).tolist()).lines.moved == 0


def test_scans_without_a_pose_are_kept_in_order(tmp_path: Path) -> None:
    raw = "RAWLASER1 0 -1.570796 3.141593 1.570796 20.0 0.1 0 3 1 2 {} 0 {:.2f} h 0"
    stamps = [1.0, 1.2, 1.1, 1.1, 1.6]
    lines = [raw.format(k + 1, t) for k, t in enumerate(stamps)]
    with pytest.warns(UserWarning, match=r"stamps go back at 1 of 4 steps and repeat at 1"):
        log = read_carmen(write_log(tmp_path / "x.clf", lines))
    assert [float(s.ranges[2]) for s in log.scans] == [1, 2, 3, 4, 5]


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
