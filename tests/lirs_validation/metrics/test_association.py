"""Poses of one moment, against a search of all pairs."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from lirs_validation.metrics.alignment import MAX_GAP, associated, nearest, scan_coverage

# Whole eighths: many stamps coincide and lie halfway, and nothing is rounded.
stamps = st.lists(st.integers(-40, 40), unique=True, max_size=12).map(lambda k: np.array(sorted(k)) / 8)


def all_pairs(first: np.ndarray, second: np.ndarray, gap: float) -> list[tuple[int, int]]:
    """Return for each of the shorter list the nearest of the longer; of two alike the earlier."""
    pairs = []
    for i, stamp in enumerate(first.tolist()):
        j = min(range(len(second)), key=lambda k: (abs(second[k] - stamp), k), default=None)
        if j is not None and abs(second[j] - stamp) <= gap:
            pairs.append((i, j))
    return pairs


@given(stamps, stamps, st.sampled_from((0.0, 0.125, 0.25, 0.5, 9.0)))
def test_each_of_the_shorter_with_the_nearest_of_the_longer(
    first: np.ndarray, second: np.ndarray, gap: float
) -> None:
    i, j = associated(first, second, max_gap=gap)
    found = list(zip(i.tolist(), j.tolist(), strict=True))
    if len(first) <= len(second):
        assert found == all_pairs(first, second, gap)
    else:
        assert found == [(a, b) for b, a in all_pairs(second, first, gap)]


@pytest.mark.parametrize(("count", "other"), [(0, 0), (0, 3), (3, 0)])
def test_nothing_pairs_with_nothing(count: int, other: int) -> None:
    i, j = associated(np.arange(float(count)), np.arange(float(other)))
    assert (i.tolist(), j.tolist()) == ([], [])
    assert (i.dtype, j.dtype) == (np.int64, np.int64)


@pytest.mark.parametrize(("late", "pairs"), [(0.0199, 1), (0.0201, 0), (-0.0199, 1), (-0.0201, 0)])
def test_twenty_milliseconds_are_one_moment(late: float, pairs: int) -> None:
    assert MAX_GAP == 0.02
    assert len(associated(np.array([5.0]), np.array([5.0 + late, 7.0]))[0]) == pairs


@given(stamps, stamps)
def test_scans_are_covered_by_poses_nearer_than_half_their_period(
    scans: np.ndarray, poses: np.ndarray
) -> None:
    scans, poses = scans / 8, poses / 8  # 64ths of a second: half a period is less than 0.02 s for some
    steps = np.diff(scans)
    gap = min(0.02, 0.49 * float(np.median(steps))) if len(steps) else 0.02
    covered = [any(abs(pose - scan) <= gap for pose in poses) for scan in scans]
    assert scan_coverage(scans, poses) == pytest.approx(np.mean(covered) if covered else 0.0)


def test_coverage_by_hand() -> None:
    scans = np.array([0.0, 0.5, 0.5, 1.0, 1.5])  # one stamp twice
    assert scan_coverage(scans, np.array([0.0199, 0.5, 1.021, 1.4801])) == 0.8
    fast = np.arange(8) / 64  # half a period is 7.8 ms
    assert scan_coverage(fast, fast[::2]) == 0.5
    assert scan_coverage(fast, fast + 0.48 / 64) == 1.0
    assert scan_coverage(fast, fast[:1] + 0.495 / 64) == 0.0
    assert scan_coverage(np.array([3.0]), np.array([3.0199])) == 1.0
    repeated = np.repeat(fast, 3)  # the period is that of the stamps that rise
    assert scan_coverage(repeated, fast + 0.4 / 64) == 1.0


@given(stamps, stamps)
def test_the_nearest_stamp_of_any(first: np.ndarray, wanted: np.ndarray) -> None:
    if len(first):
        expected = [min(range(len(first)), key=lambda k: (abs(first[k] - t), k)) for t in wanted]
        assert nearest(first, wanted).tolist() == expected
