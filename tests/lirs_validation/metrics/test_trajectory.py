"""Errors of trajectories: known motions, pairs of poses, relations and references; evo confirms them."""

import gzip
import math
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation

from lirs_validation.logs.read_log import read_constraints
from lirs_validation.metrics.mapped_log import (
    Accuracy,
    ConstraintErrors,
    ReferenceErrors,
    RelativePoseConstraint,
    constraint_errors,
    poses_at,
    reference_errors,
)
from lirs_validation.metrics.trajectory import (
    ErrorSpread,
    close_pairs,
    inside_95,
    pairs_by_path,
    pairs_by_time,
    relative_pose_error,
    rms,
    spatial_alignment,
    spatial_errors,
    trajectory_errors,
)
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.pose import Pose2, Pose3, Trajectory
from tests.kit import refused

finite = st.floats(-50, 50)
poses = st.builds(Pose2, finite, finite, st.floats(-math.pi, math.pi))


def circle(n: int = 200, radius: float = 3.0, rate: float = 25.0) -> Trajectory:
    angles = np.linspace(0, 1.5 * math.pi, n)
    path = [Pose2(radius * math.cos(a), radius * math.sin(a), a + math.pi / 2) for a in angles.tolist()]
    return Trajectory.from_poses((np.arange(n) / rate).tolist(), path)


def test_a_known_covariance_holds_95_percent_of_the_errors() -> None:
    rng = np.random.default_rng(5)
    truth, covariances, errors = np.zeros((4000, 3)), [], []
    for _ in truth:
        A = rng.standard_normal((3, 3)) * (0.3, 0.05, 0.01)
        covariances.append(A @ A.T)
        errors.append(A @ rng.standard_normal(3))
    share = inside_95(truth, np.array(errors), covariances)
    assert share == pytest.approx(0.95, abs=4 * math.sqrt(0.95 * 0.05 / 4000))
    half = inside_95(truth, np.array(errors), [P / 4 for P in covariances])
    assert half == pytest.approx(1 - math.exp(-5.991 / 8), abs=0.04)


def test_only_claimed_covariances_count() -> None:
    truth, estimate = np.zeros((3, 3)), np.array(((0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (9.0, 9.0, 0.0)))
    assert inside_95(truth, estimate, [np.zeros((3, 3)), 0.01 * np.eye(3), None]) == 1.0
    assert inside_95(truth, estimate, [np.zeros((3, 3)), 1e-3 * np.eye(3), None]) == 0.5
    assert inside_95(truth, estimate, [None] * 3) is None


@given(poses)
def test_a_moved_copy_has_no_aligned_error(T: Pose2) -> None:
    truth = circle()
    errors = trajectory_errors(truth, truth.moved(T))
    assert errors.ate_rmse < 1e-9
    assert errors.yaw_rmse < 1e-6
    assert errors.rpe_metre.translation_rmse < 1e-9


@given(poses, poses)
def test_moving_both_changes_nothing(T: Pose2, shift: Pose2) -> None:
    truth, estimate = circle(), circle(radius=3.2)
    one = trajectory_errors(truth, estimate)
    both = trajectory_errors(truth.moved(T), estimate.moved(T))
    assert both.ate_rmse == pytest.approx(one.ate_rmse, abs=1e-9)
    assert both.ate_rmse_unaligned == pytest.approx(one.ate_rmse_unaligned, abs=1e-9)
    # The aligned error does not care where the estimate lies, either.
    elsewhere = trajectory_errors(truth, estimate.moved(shift))
    assert elsewhere.ate_rmse == pytest.approx(one.ate_rmse, abs=1e-9)


def test_a_robot_that_stands_still() -> None:
    still = Trajectory.from_poses([0.0, 0.1, 0.2], [Pose2(1, 2, 3)] * 3)
    errors = trajectory_errors(still, still)
    assert (errors.ate_rmse, errors.length, errors.rpe_metre, errors.rpe_second) == (0.0, 0.0, None, None)


def test_one_common_pose_is_refused() -> None:
    late = Trajectory.from_poses([0.0, 50.0], [Pose2(), Pose2(1.0)])
    with pytest.raises(ConfigError, match="got 1 of 2 true and 200 estimated"):
        trajectory_errors(late, circle())


SEEDS = st.integers(0, 2**32 - 1)


def wander(rng: np.random.Generator, n: int = 400) -> Trajectory:
    rpy = np.cumsum(rng.normal(0, (0.01, 0.01, 0.05), (n, 3)), axis=0)
    step = Rotation.from_euler("xyz", rpy).apply(np.column_stack((rng.uniform(0, 0.1, n), np.zeros((n, 2)))))
    poses = [
        Pose3.from_rpy(*p, *a) for p, a in zip(np.cumsum(step, axis=0).tolist(), rpy.tolist(), strict=True)
    ]
    return Trajectory.from_poses((0.1 * np.arange(n)).tolist(), poses)


def any_pose(rng: np.random.Generator) -> Pose3:
    return Pose3.from_arrays(rng.normal(0, 5, 3), rng.normal(0, 1, 4))


def jittered(t: Trajectory, rng: np.random.Generator, meters: float = 0.05) -> Trajectory:
    turned = Rotation.from_quat(t.quaternions, scalar_first=True) * Rotation.from_rotvec(
        rng.normal(0, 0.02, (len(t), 3))
    )
    noise = rng.normal(0, meters, (len(t), 3)) + np.linspace(0, 0.3, len(t))[:, None]
    return Trajectory(t.stamps, t.positions + noise, turned.as_quat(scalar_first=True))


@given(SEEDS)
def test_no_small_motion_from_the_alignment_lowers_the_error(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = rng.normal(0, 3, (15, 3)), rng.normal(0, 3, (15, 3))
    T = spatial_alignment(a, b)
    least = np.square(T.apply(a) - b).sum()
    for _ in range(10):
        nudge = Pose3.from_rpy(*rng.normal(0, 1e-3, 6).tolist())
        assert np.square((nudge @ T).apply(a) - b).sum() >= least - 1e-9


def test_mirrored_points_are_not_mirrored_back() -> None:
    points = np.random.default_rng(2).normal(0, 1, (30, 3))
    found = spatial_alignment(points, points * (1, 1, -1))
    assert np.linalg.det(found.rotation) == pytest.approx(1.0)


def test_points_on_a_line_are_aligned_to_the_line() -> None:
    line = np.outer(np.linspace(0, 5, 9), (1.0, 2.0, 0.5))
    T = Pose3.from_rpy(1, 2, 3, 0.3, -0.4, 2.0)
    np.testing.assert_allclose(spatial_alignment(line, T.apply(line)).apply(line), T.apply(line), atol=1e-9)


def test_the_same_path_has_no_error_and_a_moved_one_only_unaligned() -> None:
    rng = np.random.default_rng(4)
    truth = wander(rng)
    assert spatial_errors(truth, truth).ate_rmse_3d == pytest.approx(0, abs=1e-9)
    moved = truth.moved(Pose3.from_rpy(0.3, -0.4, 1.2, 0.0, 0.1, 0.0))
    errors = spatial_errors(truth, moved)
    assert errors.ate_rmse_3d == pytest.approx(0, abs=1e-9)
    assert errors.rotation_rmse_3d == pytest.approx(0.1, abs=1e-6)
    lifted = Trajectory(truth.stamps, truth.positions + np.array((0, 0, 0.7)), truth.quaternions)
    assert spatial_errors(truth, lifted).ate_rmse_3d_unaligned == pytest.approx(0.7)


def test_height_counts_in_space_and_not_in_the_plane() -> None:
    truth = wander(np.random.default_rng(7))
    bumpy = Trajectory(
        truth.stamps,
        truth.positions + np.column_stack((np.zeros((len(truth), 2)), 0.1 * (-1.0) ** np.arange(len(truth)))),
        truth.quaternions,
    )
    assert trajectory_errors(truth, bumpy).ate_rmse == pytest.approx(0, abs=1e-9)
    assert spatial_errors(truth, bumpy).ate_rmse_3d == pytest.approx(0.1, rel=0.02)


@pytest.mark.parametrize("seed", range(4))
def test_evo_says_the_same(seed: int) -> None:
    metrics = pytest.importorskip("evo.core.metrics")
    trajectory = pytest.importorskip("evo.core.trajectory")
    rng = np.random.default_rng(seed)
    truth = wander(rng)
    estimate = jittered(truth.moved(any_pose(rng)), rng)
    a, b = (
        trajectory.PoseTrajectory3D(t.positions.copy(), t.quaternions.copy(), t.stamps.copy())
        for t in (truth, estimate)
    )
    ours = spatial_errors(truth, estimate)
    turn = metrics.APE(metrics.PoseRelation.rotation_angle_rad)
    turn.process_data((a, b))
    assert ours.rotation_rmse_3d == pytest.approx(turn.get_statistic(metrics.StatisticsType.rmse), rel=1e-6)
    b.align(a)
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data((a, b))
    assert ours.ate_rmse_3d == pytest.approx(ape.get_statistic(metrics.StatisticsType.rmse), rel=1e-6)
    assert ours.ate_max_3d == pytest.approx(ape.get_statistic(metrics.StatisticsType.max), rel=1e-6)


def pairs(found: tuple[np.ndarray, np.ndarray]) -> list[tuple[int, int]]:
    return list(zip(*(k.tolist() for k in found), strict=True))


def test_pairs_are_a_stretch_of_path_apart_or_just_above() -> None:
    # Steps of 0.5, 0.5, 0.25, 1.0, 0.25, 0.25, 0.25, 0.25, 0.5 along both axes; only the path counts.
    steps = np.array([(0.5, 0), (0, 0.5), (0, -0.25), (0.6, 0.8), *[(-0.25, 0)] * 4, (0, 0.5)])
    poses = np.column_stack((np.cumsum([(7.0, -3.0), *steps], axis=0), np.zeros(10)))
    assert pairs(pairs_by_path(poses, 1.0)) == [(0, 2), (2, 4), (4, 8)]
    assert pairs(pairs_by_path(poses, 1.5)) == [(0, 4), (4, 9)]
    assert pairs(pairs_by_path(poses, 9.0)) == []
    assert pairs(pairs_by_path(poses[:1], 1.0)) == []


def test_pairs_are_a_time_apart_to_the_nearest_stamp() -> None:
    even = np.arange(9) * 0.25 + 100
    assert pairs(pairs_by_time(even, 1.0)) == [(k, k + 4) for k in range(5)]
    assert pairs(pairs_by_time(even, 1.1)) == [(k, k + 4) for k in range(5)]
    assert pairs(pairs_by_time(even, 0.9)) == [(k, k + 4) for k in range(5)]
    assert pairs(pairs_by_time(even, 2.0)) == [(0, 8)]
    assert pairs(pairs_by_time(even, 2.25)) == []
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # a single stamp has no step
        assert pairs(pairs_by_time(np.array([5.0]), 1.0)) == []
    # A pose alone in a gap has no partner within the usual step.
    gaps = np.array([0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 4.0, 4.25])
    assert pairs(pairs_by_time(gaps, 1.0)) == [(0, 4), (1, 5), (2, 5)]


def test_no_pair_is_none_and_one_is_enough() -> None:
    poses = np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)])
    nothing = np.empty(0, np.int64)
    assert relative_pose_error(poses, poses, (nothing, nothing)) is None
    one = relative_pose_error(poses, 2 * poses, (np.array([0]), np.array([1])))
    assert (one.translation_rmse, one.rotation_rmse, one.pairs) == (1.0, 0.0, 1)


STAMPS = [0.0, 1.0, 2.0]


@given(seed=st.integers(0, 2**32 - 1))
def test_all_at_once_is_one_after_the_other(seed: int) -> None:
    """The array code against the metric written down pose by pose."""
    rng = np.random.default_rng(seed)

    def walk(n: int) -> Trajectory:
        stamps = np.cumsum(rng.uniform(0.05, 1.5, n)).tolist()
        return Trajectory.from_poses(stamps, [Pose2(*row) for row in rng.normal(size=(n, 3)).tolist()])

    estimate, odometry = walk(12), walk(20)
    relations = tuple(
        RelativePoseConstraint(*rng.uniform(-3, 15, 2).tolist(), Pose2(*rng.normal(size=3).tolist()))
        for _ in range(15)
    )
    errors = constraint_errors(estimate, relations, odometry)
    low, high = estimate.stamps[0] - 2, estimate.stamps[-1] + 2
    inside = [r for r in relations if all(low <= t <= high for t in (r.stamp_a, r.stamp_b))]
    expected = [
        r.T_ab.inverse()
        @ carried(estimate, odometry, r.stamp_a).inverse()
        @ carried(estimate, odometry, r.stamp_b)
        for r in inside
    ]
    np.testing.assert_allclose(errors.translation, [math.hypot(e.x, e.y) for e in expected], atol=1e-9)
    np.testing.assert_allclose(np.cos(errors.rotation), [math.cos(e.yaw) for e in expected], atol=1e-9)
    assert errors.outside == len(relations) - len(inside)


def carried(estimate: Trajectory, odometry: Trajectory, stamp: float) -> Pose2:
    i = int(np.argmin(np.abs(estimate.stamps - stamp)))
    if abs(estimate.stamps[i] - stamp) <= 0.1:
        return estimate.pose2(i)
    return estimate.pose2(i) @ at(odometry, estimate.stamps[i]).inverse() @ at(odometry, stamp)


def at(track: Trajectory, stamp: float) -> Pose2:
    """Linear between the neighbors, the end beyond the ends."""
    stamp = float(np.clip(stamp, track.stamps[0], track.stamps[-1]))
    j = int(np.clip(np.searchsorted(track.stamps, stamp), 1, len(track) - 1))
    a, b = track.pose2(j - 1), track.pose2(j)
    t = (stamp - track.stamps[j - 1]) / (track.stamps[j] - track.stamps[j - 1])
    yaw = a.yaw + t * math.remainder(b.yaw - a.yaw, math.tau)
    return Pose2(a.x + t * (b.x - a.x), a.y + t * (b.y - a.y), yaw)


@pytest.mark.parametrize(
    ("stamp", "propagated"), [(1.0, False), (1.125, True), (0.875, True), (1.0625, False), (1.5, True)]
)
def test_a_pose_a_tenth_of_a_second_away_is_propagated(stamp: float, propagated: bool) -> None:
    estimate = Trajectory.from_poses([1.0, 2.0], [Pose2(5.0, 5.0, 0.0), Pose2(8.0, 8.0, 0.0)])
    odometry = Trajectory.from_poses([0.0, 4.0], [Pose2(), Pose2(4.0)])
    expected = (5.0 + (stamp - 1.0) * propagated, 5.0, 0.0)  # of two as near, the earlier
    np.testing.assert_allclose(poses_at(estimate, np.array([stamp]), odometry)[0], expected, atol=1e-12)


@pytest.mark.parametrize(("stamp", "used"), [(-2.0, 1), (-2.01, 0), (4.0, 1), (4.01, 0)])
def test_two_seconds_outside_are_still_compared(stamp: float, used: int) -> None:
    estimate = Trajectory.from_poses(STAMPS, [Pose2(float(t), 0.0, 0.0) for t in STAMPS])
    for pair in ((stamp, 1.0), (1.0, stamp)):
        errors = constraint_errors(estimate, (RelativePoseConstraint(*pair, Pose2()),), estimate)
        assert (len(errors.translation), errors.outside) == (used, 1 - used)
        assert errors.stamps.tolist() == [min(pair)] * used


def test_without_odometry_the_estimate_itself_propagates() -> None:
    estimate = Trajectory.from_poses(STAMPS, [Pose2(2.0 * t, 0.0, 0.0) for t in STAMPS])
    constraint = RelativePoseConstraint(0.25, 1.25, Pose2(2.0))
    for odometry in (Trajectory.from_poses([], []), Trajectory.from_poses([0.5], [Pose2()])):
        errors = constraint_errors(estimate, (constraint,), odometry)
        # A single pose of odometry says that the robot stood still.
        assert errors.translation[0] == pytest.approx(0.0, abs=1e-12)
    none = constraint_errors(estimate, (), estimate)
    assert (len(none.translation), len(none.rotation), none.outside) == (0, 0, 0)


def test_relations_are_read_number_by_number(tmp_path: Path) -> None:
    text = b"# stamps x y z roll pitch yaw\n\n10.5 20.25 1 -2 3 0.1 0.2 -0.3\n1 2 4 5 6 7 8 0.5\n"
    expected = (
        RelativePoseConstraint(10.5, 20.25, Pose2(1.0, -2.0, -0.3)),
        RelativePoseConstraint(1.0, 2.0, Pose2(4.0, 5.0, 0.5)),
    )
    for content in (text, gzip.compress(text)):
        (tmp_path / "r.relations").write_bytes(content)
        assert read_constraints(tmp_path / "r.relations") == expected


def test_close_pairs_by_hand() -> None:
    # Marks a meter of path apart at 0, 1, 2, 3 m east, then back on a line 1.5 m north.
    x = [0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.0, 3.0, 2.0, 1.0]
    y = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 1.5, 1.5, 1.5]
    poses = np.column_stack((np.add(x, 100.0), np.subtract(y, 50.0), np.zeros(11)))
    i, j = close_pairs(poses)
    marks = [0, 2, 4, 6, 8, 9, 10]
    expected = [
        (a, b)
        for k, a in enumerate(marks)
        for b in marks[k + 1 :]
        if math.hypot(x[a] - x[b], y[a] - y[b]) <= 2.0
    ]
    assert (0, 4) in expected
    assert list(zip(i.tolist(), j.tolist(), strict=True)) == expected
    assert [len(k) for k in close_pairs(poses[:2])] == [0, 0]
    assert [len(k) for k in close_pairs(poses[:3])] == [1, 1]


BAD = {
    "too few numbers": (b"1 2 3\n", "needs 8 numbers"),
    "words": (
        b"1 2 three 4 5 6 7 8\n",
        "not readable as relations: could not convert string to float: 'three'",
    ),
    "not a number": (b"1 2 nan 4 5 6 7 8\n", "needs 8 numbers"),
    "empty": (b"# nothing\n\n", "holds no relation"),
    "binary": (b"\x89PNG\r\n\x1a\n\x00", "not readable as relations"),
    "cut gzip": (gzip.compress(b"1 2 3 4 5 6 7 8\n" * 99)[:-12], "damaged or cut off"),
    "wrong gzip": (gzip.compress(b"1 2 3 4 5 6 7 8\n" * 99)[:12] + b"xxxx", "damaged or cut off"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_relations_are_one_line(tmp_path: Path, case: str) -> None:
    content, expected = BAD[case]
    path = tmp_path / "r.relations"
    path.write_bytes(content)
    with refused(path, expected):
        read_constraints(path)


def test_errors_are_those_after_alignment() -> None:
    """A path seen from another frame; then one with a wrong corner, against the metric that evo confirms."""
    true = [Pose2(0.0, 0.0), Pose2(4.0, 0.0), Pose2(4.0, 4.0), Pose2(0.0, 4.0)]
    reference = Trajectory.from_poses([0.0, 1.0, 2.0, 9.0], true)
    estimate = Trajectory.from_poses([0.0, 1.0, 2.0, 3.0], [Pose2(7.0, 1.0, 2.0) @ p for p in true])
    errors = reference_errors(estimate, reference)
    assert errors.outside == 1  # nearest scan six seconds away
    np.testing.assert_allclose(errors.position, 0, atol=1e-12)
    np.testing.assert_allclose(errors.yaw, 0, atol=1e-12)
    moved = reference.moved(errors.T_map_reference)
    np.testing.assert_allclose(moved.xy[:3], estimate.xy[:3], atol=1e-12)
    stretched = Trajectory.from_poses([0.0, 1.0, 2.0], [Pose2(0.0), Pose2(4.6), Pose2(4.0, 4.0)])
    found, known = reference_errors(stretched, reference).position, trajectory_errors(reference, stretched)
    assert found.max() == pytest.approx(known.ate_max)
    assert rms(found) == pytest.approx(known.ate_rmse)
    assert known.ate_max > 0.2


def east(stamps: list[float]) -> Trajectory:
    return Trajectory.from_poses(stamps, [Pose2(t, 0.0, 0.0) for t in stamps])


@pytest.mark.parametrize(("late", "used"), [(0.499, 2), (0.501, 1)])
def test_a_scan_half_a_second_away_is_compared(late: float, used: int) -> None:
    errors = reference_errors(east([0.0, 10.0 + late]), east([0.0, 10.0, 50.0]))
    assert errors.outside == 3 - used
    # A single pose cannot be aligned: nothing is said of it.
    assert len(errors.position) == len(errors.yaw) == len(errors.stamps) == (2 if used == 2 else 0)
    assert errors.T_map_reference == Pose2() or used == 2


def test_metrics_of_the_record_by_hand() -> None:
    constraints = ConstraintErrors(np.array([0.1, 0.3]), np.radians([1.0, 4.0]), 5, np.array([0.0, 1.0]))
    reference = ReferenceErrors(
        np.array([1.0, 2.0]), np.array([3.0, 4.0]), np.radians([6.0, 8.0]), 7, Pose2()
    )
    found = Accuracy(constraints, reference).metrics()
    assert found["relations"] == pytest.approx(
        {
            "translation_mean": 0.2,
            "translation_std": 0.1,
            "rotation_mean_deg": 2.5,
            "rotation_std_deg": 1.5,
            "used": 2,
            "outside": 5,
        }
    )
    assert found["reference"] == pytest.approx(
        {"ate_rmse": math.sqrt(12.5), "ate_max": 4.0, "yaw_rmse_deg": math.sqrt(50), "used": 2, "outside": 7}
    )


@given(st.lists(st.none() | st.floats(1e-3, 1e3), min_size=1, max_size=60), st.randoms(use_true_random=False))
def test_a_spread_counts_the_central_drives_in_any_order(errors: list[float | None], order: object) -> None:
    spread, known = ErrorSpread.of(errors), [error for error in errors if error is not None]
    shuffled = errors.copy()
    order.shuffle(shuffled)  # type: ignore[attr-defined]
    assert ErrorSpread.of(shuffled) == spread
    # A drive without an error is worse than any.
    worst = ErrorSpread.of(1e6 if error is None else error for error in errors)
    ends = round(0.05 * len(errors) + 1e-9)
    if spread is None:
        assert len(known) <= ends
        return
    assert worst is not None
    assert spread.low == worst.low
    assert spread.high == min(worst.high, max(known))
    assert spread.total == len(errors)
    assert spread.inside <= sum(spread.low <= error <= spread.high for error in known)
    assert spread.inside == min(len(errors) - ends, len(known)) - ends
    assert sum(error < spread.low for error in known) <= ends


@pytest.mark.parametrize(("count", "text"), [(1, "all 1"), (9, "all 9"), (10, "8 of 10"), (20, "18 of 20")])
def test_a_spread_states_its_count(count: int, text: str) -> None:
    spread = ErrorSpread.of(map(float, range(count)))
    assert spread is not None
    assert spread.count == text


def test_a_new_drive_lies_in_the_interval_as_often_as_chance_says() -> None:
    """Of 21 drives alike, the last has each rank with the same probability: 17 ranks are inside."""
    rng, inside = np.random.default_rng(3), 0
    for _ in range(2000):
        *drives, new = rng.lognormal(size=21).tolist()
        spread = ErrorSpread.of(drives)
        assert spread is not None
        inside += spread.low <= new <= spread.high
    assert inside / 2000 == pytest.approx(17 / 21, abs=0.03)
