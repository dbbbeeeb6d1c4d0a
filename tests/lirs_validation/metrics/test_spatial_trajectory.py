"""Trajectory errors in space: what they are of known motions, and beside evo's."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation

from lirs_validation.metrics.alignment import spatial_alignment
from lirs_validation.metrics.trajectory import spatial_errors, trajectory_errors
from lirs_wct.geometry.pose import Pose2, Pose3, Trajectory

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
def test_the_alignment_recovers_any_rigid_motion(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points, T = rng.normal(0, 3, (20, 3)), any_pose(rng)
    found = spatial_alignment(points, T.apply(points))
    np.testing.assert_allclose(found.apply(points), T.apply(points), atol=1e-9)
    assert np.linalg.det(found.rotation) == pytest.approx(1.0)


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


def test_in_the_plane_both_are_the_same() -> None:
    rng = np.random.default_rng(11)
    poses = [Pose2(0.1 * k, math.sin(0.05 * k), 0.02 * k) for k in range(200)]
    truth = Trajectory.from_poses((0.1 * np.arange(200)).tolist(), poses)
    noise = np.column_stack((rng.normal(0, 0.05, (200, 2)), np.zeros(200)))
    estimate = Trajectory(truth.stamps, truth.positions + noise, truth.quaternions)
    flat, spatial = trajectory_errors(truth, estimate), spatial_errors(truth, estimate)
    assert spatial.ate_rmse_3d == pytest.approx(flat.ate_rmse)
    assert spatial.ate_max_3d == pytest.approx(flat.ate_max)
    assert spatial.ate_rmse_3d_unaligned == pytest.approx(flat.ate_rmse_unaligned)


def test_two_poses_in_common_suffice() -> None:
    truth = wander(np.random.default_rng(1), 30)
    two = Trajectory(truth.stamps[:2], truth.positions[:2], truth.quaternions[:2])
    assert spatial_errors(truth, two).ate_rmse_3d == pytest.approx(0, abs=1e-9)


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
