"""Our planar trajectory errors against evo, an independent implementation."""

import math

import numpy as np
import pytest

from lirs_validation.metrics.trajectory import (
    close_pairs,
    constraint_error_summary,
    pairs_by_path,
    pairs_by_time,
    planar,
    relative_pose_error,
    trajectory_errors,
)
from lirs_wct.geometry.pose import Pose2, Trajectory

metrics = pytest.importorskip("evo.core.metrics")
sync = pytest.importorskip("evo.core.sync")
trajectory = pytest.importorskip("evo.core.trajectory")


RELATIVE = (("translation_part", "translation_rmse"), ("rotation_angle_rad", "rotation_rmse"))
"""evo's names and ours."""


def wander(rng: np.random.Generator, n: int = 1200, dt: float = 0.04) -> Trajectory:
    yaw = np.cumsum(rng.normal(0.01, 0.05, n))
    step = rng.uniform(0.0, 0.04, n)
    xy = np.column_stack((np.cumsum(step * np.cos(yaw)), np.cumsum(step * np.sin(yaw))))
    poses = [Pose2(float(x), float(y), float(a)) for (x, y), a in zip(xy, yaw, strict=True)]
    return Trajectory.from_poses((np.arange(n) * dt).tolist(), poses)


def disturbed(truth: Trajectory, rng: np.random.Generator) -> Trajectory:
    """Every third pose, jittered, drifting, its stamps 3 ms late, expressed in the start's frame."""
    ids = np.arange(5, len(truth), 3)
    back = truth.pose2(0).inverse()
    poses = []
    for k in ids:
        p = back @ truth.pose2(int(k))
        x, y, a = rng.normal(0, (0.03, 0.03, 0.01))
        poses.append(Pose2(p.x + x + 1e-4 * k, p.y + y, p.yaw + a + 1e-5 * k))
    return Trajectory.from_poses((truth.stamps[ids] + 0.003).tolist(), poses)


def as_evo(t: Trajectory):  # type: ignore[no-untyped-def]
    return trajectory.PoseTrajectory3D(t.positions.copy(), t.quaternions.copy(), t.stamps.copy())


@pytest.fixture(params=range(4))
def case(request: pytest.FixtureRequest):  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(request.param)
    truth = wander(rng).moved(Pose2(3.0, -7.0, 2.0))
    estimate = disturbed(truth, rng)
    start = truth.pose2(0)
    pair = sync.associate_trajectories(as_evo(truth), as_evo(estimate.moved(start)), max_diff=0.02)
    return truth, estimate, start, pair


def evo_figure(metric, pair, kind=None):  # type: ignore[no-untyped-def]
    metric.process_data(pair)
    return metric.get_statistic(metrics.StatisticsType.rmse if kind is None else kind)


def test_absolute_errors(case) -> None:  # type: ignore[no-untyped-def]
    truth, estimate, start, (ref, est) = case
    ours = trajectory_errors(truth, estimate, T_world_map=start)
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    assert ours.poses == ref.num_poses
    assert ours.ate_rmse_unaligned == pytest.approx(evo_figure(ape, (ref, est)), abs=1e-9)
    assert ours.final_drift == pytest.approx(float(ape.error[-1]), abs=1e-9)
    turned = metrics.APE(metrics.PoseRelation.rotation_angle_rad)
    turned.process_data((ref, est))
    assert ours.final_yaw_drift == pytest.approx(float(turned.error[-1]), abs=1e-9)
    assert ours.length == pytest.approx(ref.path_length, abs=1e-9)
    est.align(ref)
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    assert ours.ate_rmse == pytest.approx(evo_figure(ape, (ref, est)), abs=1e-9)
    assert ours.ate_max == pytest.approx(ape.get_statistic(metrics.StatisticsType.max), abs=1e-9)
    turn = metrics.APE(metrics.PoseRelation.rotation_angle_rad)
    assert ours.yaw_rmse == pytest.approx(evo_figure(turn, (ref, est)), abs=1e-9)
    assert 0 < ours.ate_rmse < ours.ate_rmse_unaligned


@pytest.mark.parametrize("delta", [1.0, 2.5])
def test_relative_errors_per_meter(case, delta: float) -> None:  # type: ignore[no-untyped-def]
    truth, estimate, start, pair = case
    true, est = (np.column_stack((t.positions_xyz[:, :2], yaws(t))) for t in pair)
    ours = relative_pose_error(true, est, pairs_by_path(true, delta))
    for relation, figure in RELATIVE:
        rpe = metrics.RPE(
            metrics.PoseRelation[relation], delta, metrics.Unit.meters, pairs_from_reference=True
        )
        assert getattr(ours, figure) == pytest.approx(evo_figure(rpe, pair), abs=1e-9)
        assert ours is not None
        assert ours.pairs == len(rpe.error)
    if delta == 1.0:
        whole = trajectory_errors(truth, estimate, T_world_map=start).rpe_metre
        assert whole is not None
        assert ours is not None
        assert whole.translation_rmse == pytest.approx(ours.translation_rmse, abs=1e-9)


def test_relative_errors_per_second(case) -> None:  # type: ignore[no-untyped-def]
    _, _, _, (ref, est) = case
    # Poses every 0.12 s: 8 frames (0.96 s) are nearest to a second.
    true, guess = (np.column_stack((t.positions_xyz[:, :2], yaws(t))) for t in (ref, est))
    ours = relative_pose_error(true, guess, pairs_by_time(ref.timestamps, 1.0))
    assert ours is not None
    for relation, figure in RELATIVE:
        rpe = metrics.RPE(metrics.PoseRelation[relation], 8, metrics.Unit.frames, all_pairs=True)
        assert getattr(ours, figure) == pytest.approx(evo_figure(rpe, (ref, est)), abs=1e-9)
        assert ours.pairs == len(rpe.error)


def test_relations(case) -> None:  # type: ignore[no-untyped-def]
    """evo knows no such pairs, but computes the error of any pair: the relation's E of Eq. 1."""
    truth, estimate, start, (ref, est) = case
    true, guess = (np.column_stack((t.positions_xyz[:, :2], yaws(t))) for t in (ref, est))
    pairs = list(zip(*(k.tolist() for k in close_pairs(true)), strict=True))
    errors = [
        metrics.RPE.rpe_base(ref.poses_se3[i], ref.poses_se3[j], est.poses_se3[i], est.poses_se3[j])
        for i, j in pairs
    ]
    shift = np.array([np.linalg.norm(E[:3, 3]) for E in errors])
    turn = np.abs([math.atan2(E[1, 0], E[0, 0]) for E in errors])
    ours = constraint_error_summary(true, guess)
    assert ours is not None
    assert ours.relations == len(pairs) > 40
    assert ours.translation_mean == pytest.approx(shift.mean(), abs=1e-9)
    assert ours.translation_std == pytest.approx(shift.std(), abs=1e-9)
    assert ours.rotation_mean == pytest.approx(turn.mean(), abs=1e-9)
    assert ours.rotation_std == pytest.approx(turn.std(), abs=1e-9)
    whole = trajectory_errors(truth, estimate, T_world_map=start).relations
    assert whole is not None
    assert whole.translation_mean == pytest.approx(ours.translation_mean, abs=1e-9)


def yaws(t) -> np.ndarray:  # type: ignore[no-untyped-def]
    w, x, y, z = t.orientations_quat_wxyz.T
    return np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def test_the_helpers_agree_with_evo_on_yaw() -> None:
    t = wander(np.random.default_rng(9), n=50)
    assert np.allclose(planar(t)[:, 2], yaws(as_evo(t)))
    assert math.isclose(t.length, as_evo(t).path_length)
