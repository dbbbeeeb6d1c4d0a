"""Kernels for symmetric 3x3 matrices against NumPy."""

import numpy as np

from slam_baselines.linalg import invert3, moved_covariance, solve3


def test_small_matrices_equal_numpy() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        B = rng.standard_normal((3, 3))
        A, b = B @ B.T + 0.1 * np.eye(3), rng.standard_normal(3)
        np.testing.assert_allclose(invert3(A), np.linalg.inv(A), rtol=1e-9)
        np.testing.assert_allclose(solve3(A, b), np.linalg.solve(A, b), rtol=1e-9)
        dx, dy, shift, turn = rng.random(4).tolist()
        G = np.array(((1, 0, -dy), (0, 1, dx), (0, 0, 1)))
        np.testing.assert_allclose(
            moved_covariance(A, dx, dy, shift, turn), G @ A @ G.T + np.diag((shift, shift, turn)), rtol=1e-9
        )
    assert not invert3(np.zeros((3, 3))).any()
