"""Poses of the plane by the array, against `Pose2` one by one and against an independent alignment."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation

from lirs_validation.metrics.alignment import motion, move_poses, planar, rigid_alignment, rms, wrap_angles
from lirs_wct.geometry.pose import Pose2, Trajectory, wrap_angle

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


@pytest.mark.parametrize(
    ("angle", "expected"),
    [(0.0, 0.0), (3.0, 3.0), (3.5, 3.5 - math.tau), (-3.5, math.tau - 3.5), (20.0, 20 - 3 * math.tau)],
)
def test_wrapped_by_hand(angle: float, expected: float) -> None:
    assert wrap_angles(np.array([angle]))[0] == pytest.approx(expected, abs=1e-12)


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


@pytest.mark.parametrize("yaw", [0.0, math.pi / 2, -math.pi / 2, 3.0])
def test_alignment_of_two_points_by_hand(yaw: float) -> None:
    T = Pose2(3.0, -5.0, yaw)
    source = np.array([(1.0, 2.0), (4.0, 2.5)])
    found = rigid_alignment(source, T.apply(source))
    np.testing.assert_allclose(found.as_array(), T.as_array(), atol=1e-12)


def test_points_in_one_place_are_shifted_only() -> None:
    here = np.full((3, 2), 2.0)
    assert rigid_alignment(here, here + np.array((1.0, -4.0))) == Pose2(1.0, -4.0, 0.0)


def test_root_mean_square() -> None:
    assert rms(np.array([3.0, -4.0, 5.0, 0.0])) == pytest.approx(math.sqrt(50 / 4))
