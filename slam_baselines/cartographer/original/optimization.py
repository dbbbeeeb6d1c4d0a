"""Sparse pose adjustment as in the original's optimization_problem_2d and spa_cost_function_2d.

Nodes are tied to the submaps and to the next node, so the equations of the nodes form a band, which is
factorized; the few submaps follow by the Schur complement. The first submap is fixed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded, solve

from lirs_wct.arrays import FloatArray
from lirs_wct.geometry import Pose2
from slam_baselines.cartographer.original.trust_region import NormalEquations, minimize
from slam_baselines.cartographer.pose_graph import PoseConstraint, PoseConstraints, errors, linearize


def pose_tie(
    a: int, b: int, measured: Pose2, weights: tuple[float, float], *, loop: bool = False
) -> PoseConstraint:
    """Return a constraint of pose b in the frame of a, weighted in 1/m and 1/rad."""
    translation, rotation = weights
    information = np.diag((translation**2, translation**2, rotation**2))
    return PoseConstraint(a, b, measured.as_array(), information, loop)


class GraphHessian(NamedTuple):
    """J'J of the pose graph.

    Attributes:
        submaps: (s, 3, 3) diagonal blocks, without the first.
        nodes: (n, 3, 3) diagonal blocks.
        chain: (n - 1, 3, 3) blocks of each node and the next.
        cross: (3 n, 3 s) of nodes and submaps.
    """

    submaps: FloatArray
    nodes: FloatArray
    chain: FloatArray
    cross: FloatArray


@dataclass(frozen=True)
class PoseGraphProblem:
    """Least-squares problem over the poses of all submaps but the first, and of all nodes.

    Attributes:
        first: (3,) pose of the first submap.
        submaps: number of submaps.
        to_submaps: ties of nodes to submaps (a).
        to_nodes: ties of nodes to the node before (a).
        huber_scale: weighted error from which on a loop counts linearly.
    """

    first: FloatArray
    submaps: int
    to_submaps: PoseConstraints
    to_nodes: PoseConstraints
    huber_scale: float

    def poses(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return (s, 3) submaps and (n, 3) nodes of a point."""
        rows = x.reshape(-1, 3)
        split = self.submaps - 1
        return np.concatenate((self.first[None], rows[:split])), rows[split:]

    def evaluate(self, x: FloatArray) -> NormalEquations:
        """Return the normal equations; loops have Huber's loss, as weights."""
        submaps, nodes = self.poses(x)
        s, n = len(submaps), len(nodes)
        (Hs, gs), (Hn, gn) = ((np.zeros((k, 3, 3)), np.zeros((k, 3))) for k in (s, n))
        cost, weighted = self._weigh_ties(submaps, nodes)
        B, E = np.empty((len(weighted.a), 3, 3)), np.empty((len(self.to_nodes.a), 3, 3))
        linearize(weighted.rows, submaps, nodes, 1.0, (Hs, gs), (Hn, gn), B)
        linearize(self.to_nodes.rows, nodes, nodes, 1.0, (Hn, gn), (Hn, gn), E)
        chain, cross = np.zeros((max(0, n - 1), 3, 3)), np.zeros((n, 3, s, 3))
        np.add.at(chain, self.to_nodes.a, E)
        # A node is tied to a submap at most once.
        cross[weighted.b, :, weighted.a] = B.transpose(0, 2, 1)
        hessian = GraphHessian(Hs[1:], Hn, chain, cross[:, :, 1:].reshape(3 * n, 3 * (s - 1)))
        diagonal = np.concatenate((Hs[1:], Hn))[:, range(3), range(3)].ravel()
        return NormalEquations(cost, np.concatenate((gs[1:], gn)).ravel(), diagonal, hessian)

    def solve(self, equations: NormalEquations, damping: FloatArray) -> FloatArray:
        """Return the damped step."""
        H: GraphHessian = equations.hessian
        split = 3 * len(H.submaps)
        band = _band(H.nodes, H.chain)
        band[-1] += damping[split:]
        right = np.concatenate((H.cross, equations.gradient[split:, None]), axis=1)
        solved = cho_solve_banded((cholesky_banded(band), False), right, overwrite_b=True)
        if not split:
            return -solved[:, -1]
        S = _block_diagonal(H.submaps) + np.diag(damping[:split]) - H.cross.T @ solved[:, :-1]
        step = -solve(S, equations.gradient[:split] - H.cross.T @ solved[:, -1], assume_a="pos")
        return np.concatenate((step, -solved[:, -1] - solved[:, :-1] @ step))

    def _weigh_ties(self, submaps: FloatArray, nodes: FloatArray) -> tuple[float, PoseConstraints]:
        """Return the cost, and the ties to submaps with the weights of Huber's loss."""
        ties, chain = self.to_submaps, self.to_nodes
        square, by_chain = (
            np.einsum("mi,mij,mj->m", e, t.information, e)
            for t, e in (
                (ties, errors(submaps[ties.a], nodes[ties.b], ties.z)),
                (chain, errors(nodes[chain.a], nodes[chain.b], chain.z)),
            )
        )
        a = self.huber_scale
        length = np.sqrt(square)
        far = ties.robust & (length > a)
        cost = 0.5 * float(np.where(far, a * (2 * length - a), square).sum() + by_chain.sum())
        weights = np.where(far, a / np.maximum(length, a), 1.0)
        information = ties.information * weights[:, None, None]
        return cost, replace(ties, information=information, robust=np.zeros(len(ties.a), np.bool_))


def _band(diagonal: FloatArray, chain: FloatArray) -> FloatArray:
    """Return the upper band (6, 3 n) of a block tridiagonal matrix."""
    n = len(diagonal)
    band = np.zeros((6, n, 3))
    for i in range(3):
        for j in range(3):
            if j >= i:
                band[5 + i - j, :, j] = diagonal[:, i, j]
            band[2 + i - j, 1:, j] = chain[:, i, j]
    return band.reshape(6, 3 * n)


def _block_diagonal(blocks: FloatArray) -> FloatArray:
    s = len(blocks)
    matrix = np.zeros((s, 3, s, 3))
    matrix[np.arange(s), :, np.arange(s)] = blocks
    return matrix.reshape(3 * s, 3 * s)


def adjust(
    submaps: Sequence[Pose2], nodes: Sequence[Pose2], to_submaps: Sequence[PoseConstraint],
    to_nodes: Sequence[PoseConstraint], huber_scale: float, iterations: Sequence[int],
) -> tuple[list[Pose2], list[Pose2]]:  # fmt: skip
    """Return poses of submaps and nodes after optimizations of at most so many iterations each."""
    x = np.array([pose.as_array() for pose in (*submaps, *nodes)])
    problem = PoseGraphProblem(
        x[0], len(submaps), PoseConstraints.stack(to_submaps), PoseConstraints.stack(to_nodes), huber_scale
    )
    point = x[1:].ravel()
    for most in iterations:
        point = minimize(problem, point, most)
    adjusted_submaps, adjusted_nodes = (
        [Pose2(*pose) for pose in poses.tolist()] for poses in problem.poses(point)
    )
    return adjusted_submaps, adjusted_nodes
