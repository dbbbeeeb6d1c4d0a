"""The pose graph: derivatives, a square loop, outliers."""

import numpy as np
import pytest

from lirs_wct.geometry import compose_poses, relative_poses, wrap_angles
from slam_baselines.cartographer.config import CartographerConfig
from slam_baselines.cartographer.pose_graph import (
    OptimizationProblem,
    PoseConstraint,
    PoseConstraints,
    errors,
    linearize,
    optimize,
    robust_cost,
    start_optimization,
)

TIGHT = np.diag((0.02**-2, 0.02**-2, 0.004**-2))
LOCAL = np.diag((0.03**-2, 0.03**-2, 0.01**-2))
NONE = PoseConstraints.stack([])


def square(side=10.0, per_side=20, per_submap=10):
    """True poses of nodes along a square, driven twice, and of the submaps that begin on the way."""
    steps = np.zeros((8 * per_side, 3))
    steps[:, 0] = side / per_side
    steps[per_side - 1 :: per_side, 2] = np.pi / 2
    nodes = [np.zeros(3)]
    for step in steps[:-1]:
        nodes.append(compose_poses(nodes[-1], step))
    nodes = np.array(nodes)
    return nodes, nodes[::per_submap].copy(), per_submap


def constraints_of(nodes, local, per_submap, rng, outliers=0.0):
    """Each node to its two submaps as local SLAM drifts; true loops from round two to round one."""
    submaps, rows = nodes[::per_submap], []
    for k in range(len(submaps)):
        first = k * per_submap
        members = range(first, min(len(nodes), first + 2 * per_submap))
        rows += [PoseConstraint(k, j, relative_poses(local[first], local[j]), LOCAL, False) for j in members]
    half = len(nodes) // 2
    for j in range(half, len(nodes), 2):
        k = (j - half) // per_submap
        z = relative_poses(submaps[k], nodes[j]) + rng.normal(0, (0.01, 0.01, 0.002))
        if rng.random() < outliers:
            z = z + rng.normal(0, (3.0, 3.0, 1.0))
        rows.append(PoseConstraint(k, j, z, TIGHT, True))
    return PoseConstraints.stack(rows)


def drifted(nodes, rng):
    """The same path with a turn that is wrong by a little at each step."""
    wrong = rng.normal((0, 0, 0.003), (0.002, 0.002, 0.002), (len(nodes) - 1, 3))
    steps = relative_poses(nodes[:-1], nodes[1:]) + wrong
    poses = [nodes[0]]
    for step in steps:
        poses.append(compose_poses(poses[-1], step))
    return np.array(poses)


def solved(problem, submaps, nodes):
    return optimize(problem, start_optimization(problem, submaps, nodes))


def rmse(estimate, truth):
    return np.sqrt(((estimate - truth)[:, :2] ** 2).sum(axis=1).mean())


def test_the_kernels_linearize_the_errors():
    """Blocks and gradients are those of numeric derivatives; Cauchy's loss weighs robust constraints."""
    rng = np.random.default_rng(1)
    m, s, n, scale = 50, 4, 7, 2.0
    submaps, nodes = rng.uniform(-3, 3, (s, 3)), rng.uniform(-3, 3, (n, 3))
    L = rng.normal(size=(m, 3, 3))
    rows = (
        rng.integers(0, s, m), rng.integers(0, n, m), rng.uniform(-3, 3, (m, 3)),
        L @ L.transpose(0, 2, 1) + np.eye(3), rng.random(m) < 0.5,
    )  # fmt: skip
    a, b, z, W, robust = rows
    h = 1e-6 * np.eye(3)
    Ja, Jb = (
        np.stack([wrap_yaw(errors(*plus, z) - errors(*minus, z)) / 2e-6 for plus, minus in moved], axis=-1)
        for moved in (
            [((submaps[a] + d, nodes[b]), (submaps[a] - d, nodes[b])) for d in h],
            [((submaps[a], nodes[b] + d), (submaps[a], nodes[b] - d)) for d in h],
        )
    )
    e = errors(submaps[a], nodes[b], z)
    chi2 = np.einsum("mi,mij,mj->m", e, W, e)
    W = W * np.where(robust, 1 / (1 + chi2 / scale**2), 1.0)[:, None, None]
    (Hs, gs), (Hn, gn) = ((np.zeros((k, 3, 3)), np.zeros((k, 3))) for k in (s, n))
    cross = np.empty((m, 3, 3))
    linearize(rows, submaps, nodes, scale, (Hs, gs), (Hn, gn), cross)
    expected = [np.zeros_like(H) for H in (Hs, gs, Hn, gn)]
    np.add.at(expected[0], a, np.einsum("mji,mjk,mkl->mil", Ja, W, Ja))
    np.add.at(expected[1], a, np.einsum("mji,mjk,mk->mi", Ja, W, e))
    np.add.at(expected[2], b, np.einsum("mji,mjk,mkl->mil", Jb, W, Jb))
    np.add.at(expected[3], b, np.einsum("mji,mjk,mk->mi", Jb, W, e))
    for got, wanted in zip((Hs, gs, Hn, gn), expected, strict=True):
        np.testing.assert_allclose(got, wanted, rtol=1e-5, atol=1e-4)
    np.testing.assert_allclose(cross, np.einsum("mji,mjk,mkl->mil", Ja, W, Jb), rtol=1e-5, atol=1e-4)
    cost = np.where(robust, scale**2 * np.log1p(chi2 / scale**2), chi2).sum()
    assert robust_cost(rows, submaps, nodes, scale) == pytest.approx(cost)


def wrap_yaw(difference):
    difference[:, 2] = wrap_angles(difference[:, 2])
    return difference


def test_errors_vanish_at_the_measured_poses_and_yaw_wraps():
    a = np.array([[1.0, 2.0, 3.0]])
    z = np.array([[0.5, -0.2, 3.1]])
    np.testing.assert_allclose(errors(a, compose_poses(a, z), z), 0, atol=1e-12)


@pytest.mark.parametrize("outliers", [0.0, 0.05])
def test_a_square_is_recovered(outliers):
    rng = np.random.default_rng(3)
    nodes, _, per = square()
    start = drifted(nodes, rng)
    constraints = constraints_of(nodes, start, per, rng, outliers)
    solution = solved(
        OptimizationProblem(CartographerConfig(), constraints, NONE, np.zeros(3)), start[::per], start
    )
    second = len(nodes) // 2  # the first round closes nowhere: that the second lies on it is what loops say
    assert rmse(start[second:], start[:second]) > 1.0
    assert rmse(solution.nodes[second:], solution.nodes[:second]) < 0.05
    assert rmse(solution.nodes, nodes) < 0.5 * rmse(start, nodes)
    np.testing.assert_allclose(solution.nodes[0], 0, atol=1e-4)  # the gauge holds the first node


def test_the_step_solves_the_whole_system():
    """The Schur complement gives what the dense normal equations give."""
    rng = np.random.default_rng(5)
    nodes, submaps, per = square(per_side=5, per_submap=5)
    constraints = constraints_of(nodes, drifted(nodes, rng), per, rng)
    odometry = [
        PoseConstraint(k, k + 1, relative_poses(submaps[k], submaps[k + 1]), TIGHT / 4, False)
        for k in range(7)
    ]
    problem = OptimizationProblem(
        CartographerConfig(gauge_information=100.0), constraints, PoseConstraints.stack(odometry), np.zeros(3)
    )
    s0, n0 = submaps + rng.normal(0, 0.05, submaps.shape), nodes + rng.normal(0, 0.05, nodes.shape)
    s, n = len(s0), len(n0)

    def stacked(x):
        S, N = x[: 3 * s].reshape(s, 3), x[3 * s :].reshape(n, 3)
        e = []
        for part, ends in ((constraints, N), (problem.to_submaps, S)):
            roots = np.sqrt(np.diagonal(part.information, axis1=1, axis2=2))
            e.append(errors(S[part.a], ends[part.b], part.z) * roots)
        return np.concatenate([*(v.ravel() for v in e), 10 * N[0]])

    x = np.concatenate((s0.ravel(), n0.ravel()))
    J = np.stack([(stacked(x + d) - stacked(x - d)) / 2e-6 for d in 1e-6 * np.eye(len(x))], axis=1)
    # Loops are robust: hold their weights at 1 by a wide kernel.
    wide = OptimizationProblem(
        CartographerConfig(gauge_information=100.0, cauchy_scale=1e6),
        constraints,
        problem.to_submaps,
        np.zeros(3),
    )
    step = -np.linalg.solve(J.T @ J + 1e-9 * np.diag(np.diag(J.T @ J)), J.T @ stacked(x))
    got_s, got_n = wide.solve_normal_equations(s0, n0, 1e-9, 1.0)
    np.testing.assert_allclose(wrap_angles(got_s - s0).ravel(), step[: 3 * s], atol=1e-5)
    np.testing.assert_allclose(wrap_angles(got_n - n0).ravel(), step[3 * s :], atol=1e-5)


def test_the_scale_is_that_of_cauchys_loss():
    """At the scale, Cauchy's loss is log 2 times the squared scale; Huber's would still be quadratic."""
    z = np.array((3.0, 0.0, 0.0))
    constraint = PoseConstraints.stack([PoseConstraint(0, 0, z, np.eye(3), True)])
    problem = OptimizationProblem(CartographerConfig(cauchy_scale=3.0), constraint, NONE, np.zeros(3))
    cost = problem.cost(np.zeros((1, 3)), np.zeros((1, 3)), 1.0)
    assert cost == pytest.approx(0.5 * 9 * np.log(2))
