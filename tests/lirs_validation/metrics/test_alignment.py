"""Alignment: pairs of stamps, rigid motions, and the start, against searches of all pairs."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation

from lirs_validation.metrics.map import map_scores
from lirs_validation.metrics.trajectory import (
    MAX_GAP,
    associated,
    motion,
    move_poses,
    nearest,
    planar,
    rigid_alignment,
    scan_coverage,
    start_alignment,
)
from lirs_wct.geometry import HeightField, OccupancyGrid, WallGrid
from lirs_wct.geometry.pose import Pose2, Trajectory, wrap_angle, wrap_angles

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


@given(stamps, stamps)
def test_the_nearest_stamp_of_any(first: np.ndarray, wanted: np.ndarray) -> None:
    if len(first):
        expected = [min(range(len(first)), key=lambda k: (abs(first[k] - t), k)) for t in wanted]
        assert nearest(first, wanted).tolist() == expected


seeds = st.integers(0, 2**32 - 1)


def poses(rng: np.random.Generator, n: int) -> np.ndarray:
    return np.column_stack((rng.uniform(-30, 30, (n, 2)), rng.uniform(-9, 9, n)))


def rows(array: np.ndarray) -> list[Pose2]:
    return [Pose2(*row) for row in array.tolist()]


@given(seeds)
def test_arrays_are_poses_one_by_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b, T = poses(rng, 5), poses(rng, 5), rows(poses(rng, 1))[0]
    between = [p.inverse() @ q for p, q in zip(rows(a), rows(b), strict=True)]
    found = motion(a, b)
    np.testing.assert_allclose(found[:, :2], [(p.x, p.y) for p in between], atol=1e-9)
    np.testing.assert_allclose(wrap_angles(found[:, 2]), [p.yaw for p in between], atol=1e-9)
    np.testing.assert_allclose(move_poses(a, T), [(T @ p).as_array() for p in rows(a)], atol=1e-9)
    np.testing.assert_allclose(
        planar(Trajectory.from_poses(range(5), rows(a))),
        [(p.x, p.y, wrap_angle(p.yaw)) for p in rows(a)],
        atol=1e-9,
    )


@given(seeds)
def test_alignment_is_the_best_of_all(seed: int) -> None:
    """SciPy's solution of Wahba's problem on the centered points, with noise, in space."""
    rng = np.random.default_rng(seed)
    source = rng.normal(size=(9, 2)) * (3.0, 1.0) + rng.uniform(-20, 20, 2)
    target = Pose2(*poses(rng, 1)[0].tolist()).apply(source) + rng.normal(0, 0.3, (9, 2))
    found = rigid_alignment(source, target)
    flat = [np.column_stack((p - p.mean(axis=0), np.zeros(9))) for p in (target, source)]
    turn = Rotation.align_vectors(*flat)[0].as_matrix()
    if turn[2, 2] < 0:  # the noise made it a turn out of the plane
        return
    np.testing.assert_allclose(
        wrap_angles(np.array([found.yaw - math.atan2(turn[1, 0], turn[0, 0])])), 0, atol=1e-6
    )
    np.testing.assert_allclose(found.apply(source).mean(axis=0), target.mean(axis=0), atol=1e-9)


def test_points_in_one_place_are_shifted_only() -> None:
    here = np.full((3, 2), 2.0)
    assert rigid_alignment(here, here + np.array((1.0, -4.0))) == Pose2(1.0, -4.0, 0.0)


FLAT = HeightField(np.zeros((2, 2), np.float32), (60.0, 60.0), (-30.0, -30.0))
START = Pose2(20.0, -7.0, 0.4)


def path(n: int = 101) -> Trajectory:
    """A half circle from the start pose on, in the world frame, 25 scans a second."""
    arc = [START @ Pose2(3 * math.sin(a), 3 - 3 * math.cos(a), a) for a in np.linspace(0, math.pi, n)]
    return Trajectory.from_poses([0.04 * k for k in range(n)], arc)


def room(origin: Pose2) -> tuple[OccupancyGrid, WallGrid]:
    """A room with an L-shaped wall, as a map and as wall cells."""
    p = np.full((120, 160), 0.1)
    p[20, 20:140] = 0.9
    p[20:100, 20] = 0.9
    return OccupancyGrid.from_probability(p, 0.05, origin), WallGrid(p > 0.5, 0.05, origin)


def test_a_shift_and_a_turn_of_the_start_are_measured_at_the_start() -> None:
    """A turn of 3 deg about the start pose moves nothing there, though it is far from the world's origin."""
    turned = path().moved(START @ Pose2(0, 0, math.radians(3)) @ START.inverse())
    found = start_alignment(path(), turned)
    assert found.shift == pytest.approx(0.0, abs=1e-9)
    assert found.turn == pytest.approx(math.radians(3))
    shifted = start_alignment(path(), path().moved(Pose2(0.12, -0.05, 0.0)))
    assert (shifted.shift, shifted.turn) == (pytest.approx(0.13), pytest.approx(0.0, abs=1e-9))


def test_a_path_without_a_meter_says_nothing_of_the_start() -> None:
    still = Trajectory.from_poses([0.0, 0.04, 0.08], [START] * 3)
    assert start_alignment(still, still) is None
    late = Trajectory(path().stamps + 99.0, path().positions, path().quaternions)
    assert start_alignment(path(), late) is None


def test_a_map_that_is_right_but_for_its_start_is_right_after_the_alignment() -> None:
    reference, walls = room(Pose2(18.0, -9.0, 0.2))
    error = Pose2(0.3, 0.1, 0.04)
    alignment = start_alignment(path(), path().moved(error))
    scores = map_scores(reference.moved(error), reference, surface=FLAT, walls=walls, alignment=alignment)
    assert scores.f1 < 0.6
    assert scores.f1_aligned == pytest.approx(1.0)
    assert scores.false_occupied > 0.4
    assert scores.false_occupied_aligned == 0.0
    assert scores.start_turn == pytest.approx(0.04)
    T_back = error.inverse()
    assert scores.start_shift == pytest.approx((T_back @ START).distance(START))
    assert map_scores(reference, reference, surface=FLAT, walls=walls).f1_aligned is None


@pytest.mark.parametrize(("meters", "some"), [(0.999, False), (1.001, True)])
def test_a_meter_of_common_path_is_enough(meters: float, some: bool) -> None:
    """The path is that of the poses compared, not of the whole truth."""
    truth = Trajectory.from_poses(
        [0.0, 1.0, 2.0, 9.0], [Pose2(5.0), Pose2(5.5), Pose2(5.0 + meters), Pose2(99.0)]
    )
    estimate = Trajectory.from_poses([0.0, 1.0, 2.0], [truth.pose2(k) for k in range(3)])
    assert (start_alignment(truth, estimate) is not None) == some
