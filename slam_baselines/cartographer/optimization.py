"""Pose-graph optimization: submaps and nodes, and the constraints between them.

Hess et al. 2016, section V-A (after Konolige et al. 2010): the poses minimise the sum of
rho(e' Lambda e) over all constraints, e the difference between the measured pose of b in the frame of a
and the estimated one. Every constraint has a submap at one end, so that nodes are constrained to submaps
only: the Schur complement eliminates them block by block, and the matrix that is factorized grows with the
number of submaps alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.sparse.linalg import splu

from lirs_wct.arrays import BoolArray, FloatArray, IntArray
from slam_baselines.cartographer.config import OptimizationConfig
from slam_baselines.common.linalg import block_matrix, inverted, sum_blocks, sum_vectors
from slam_baselines.common.se2 import relative_poses, wrap


class PoseConstraint(NamedTuple):
    """A measured pose of a node or a submap in the frame of a submap.

    Attributes:
        a: index of the submap in whose frame it was measured.
        b: index of the node, or of another submap.
        z: (3,) measured x, y, yaw of b in the frame of a.
        information: (3, 3) inverse covariance of z.
        robust: whether it may be an outlier.
    """

    a: int
    b: int
    z: FloatArray
    information: FloatArray
    robust: bool


@dataclass(frozen=True, slots=True)
class PoseConstraints:
    """Constraints as arrays, with a first axis of length m.

    Attributes:
        a: (m,) index of the submap in whose frame it was measured.
        b: (m,) index of the node, or of another submap.
        z: (m, 3) measured x, y, yaw of b in the frame of a.
        information: (m, 3, 3) inverse covariance of z.
        robust: (m,) whether it may be an outlier.
    """

    a: IntArray
    b: IntArray
    z: FloatArray
    information: FloatArray
    robust: BoolArray

    @staticmethod
    def stack(constraints: Sequence[PoseConstraint]) -> PoseConstraints:
        """Stack constraints."""
        return PoseConstraints(
            np.array([c.a for c in constraints], dtype=np.int64),
            np.array([c.b for c in constraints], dtype=np.int64),
            np.array([c.z for c in constraints], dtype=np.float64).reshape(-1, 3),
            np.array([c.information for c in constraints], dtype=np.float64).reshape(-1, 3, 3),
            np.array([c.robust for c in constraints], dtype=np.bool_),
        )


@dataclass(frozen=True, slots=True)
class OptimizationProblem:
    """Nonlinear least-squares problem over the poses of submaps and nodes.

    Attributes:
        config: parameters of the solver.
        to_nodes: constraints whose b are nodes.
        to_submaps: constraints whose b are submaps.
        origin: (3,) pose at which the first node is held.
    """

    config: OptimizationConfig
    to_nodes: PoseConstraints
    to_submaps: PoseConstraints
    origin: FloatArray

    def cost(self, submaps: FloatArray, nodes: FloatArray, width: float) -> float:
        """Return half the sum of the robust squared errors of (s, 3) submaps and (n, 3) nodes.

        Cauchy's scale is `width` times the configured one.
        """
        total = 0.0
        for constraints, targets in ((self.to_nodes, nodes), (self.to_submaps, submaps)):
            e = errors(submaps[constraints.a], targets[constraints.b], constraints.z)
            chi2 = np.einsum("mi,mij,mj->m", e, constraints.information, e)
            total += float(np.where(constraints.robust, self._loss(chi2, width), chi2).sum())
        gauge = nodes[0] - self.origin
        gauge[2] = wrap(gauge[2])
        return 0.5 * (total + self.config.gauge_information * float(gauge @ gauge))

    def initial_width(self, submaps: FloatArray, nodes: FloatArray, since: int) -> float:
        """Return the width of the loss at which every loop from row `since` on is within its scale."""
        late = slice(since, None)
        robust = self.to_nodes.robust[late]
        if not robust.any():
            return 1.0
        a, b = self.to_nodes.a[late][robust], self.to_nodes.b[late][robust]
        e = errors(submaps[a], nodes[b], self.to_nodes.z[late][robust])
        chi2 = np.einsum("mi,mij,mj->m", e, self.to_nodes.information[late][robust], e)
        return max(1.0, math.sqrt(float(chi2.max())) / self.config.cauchy_scale)

    def solve_normal_equations(
        self, submaps: FloatArray, nodes: FloatArray, damping: float, width: float
    ) -> tuple[FloatArray, FloatArray]:
        """Return submaps and nodes after one Gauss-Newton step with Levenberg's damping."""
        n, s = len(nodes), len(submaps)
        A, B, C, ga, gb = self._linearize(self.to_nodes, submaps, nodes, width)
        Hnn, gn = sum_blocks(C, self.to_nodes.b, n), sum_vectors(gb, self.to_nodes.b, n)
        Hnn[0] += self.config.gauge_information * np.eye(3)
        gauge = nodes[0] - self.origin
        gn[0] += self.config.gauge_information * np.array((gauge[0], gauge[1], wrap(gauge[2])))
        Hsn = block_matrix(B, self.to_nodes.a, self.to_nodes.b, s, n)
        A2, B2, C2, ga2, gb2 = self._linearize(self.to_submaps, submaps, submaps, width)
        gs = sum_vectors(ga, self.to_nodes.a, s) + sum_vectors(ga2, self.to_submaps.a, s)
        gs += sum_vectors(gb2, self.to_submaps.b, s)
        diagonal = sum_blocks(A, self.to_nodes.a, s) + sum_blocks(A2, self.to_submaps.a, s)
        diagonal += sum_blocks(C2, self.to_submaps.b, s)
        cross = block_matrix(B2, self.to_submaps.a, self.to_submaps.b, s, s)
        eye = damping * np.eye(3)
        Hss = block_matrix(diagonal * (1 + eye), np.arange(s), np.arange(s), s, s) + cross + cross.T
        # Schur complement: the nodes' blocks are inverted one by one.
        inverse = inverted(Hnn * (1 + eye))
        Y = Hsn @ block_matrix(inverse, np.arange(n), np.arange(n), n, n)
        ds = splu((Hss - Y @ Hsn.T).tocsc()).solve(-(gs.ravel() - Y @ gn.ravel()))
        rest = gn + (Hsn.T @ ds).reshape(-1, 3)
        dn = -np.einsum("nij,nj->ni", inverse, rest)
        return _moved(submaps, ds.reshape(-1, 3)), _moved(nodes, dn)

    def _linearize(
        self, constraints: PoseConstraints, submaps: FloatArray, targets: FloatArray, width: float
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return the blocks Ja'WJa, Ja'WJb, Jb'WJb (m, 3, 3) and the gradients Ja'We, Jb'We (m, 3)."""
        e = errors(submaps[constraints.a], targets[constraints.b], constraints.z)
        Ja, Jb = jacobians(submaps[constraints.a], targets[constraints.b])
        W = constraints.information
        if constraints.robust.any():
            chi2 = np.einsum("mi,mij,mj->m", e, W, e)
            W = W * np.where(constraints.robust, self._loss_derivative(chi2, width), 1.0)[:, None, None]
        WJa, WJb = W @ Ja, W @ Jb
        JaT, JbT = Ja.transpose(0, 2, 1), Jb.transpose(0, 2, 1)
        We = np.einsum("mij,mj->mi", W, e)
        return (
            JaT @ WJa,
            JaT @ WJb,
            JbT @ WJb,
            np.einsum("mij,mj->mi", JaT, We),
            np.einsum("mij,mj->mi", JbT, We),
        )

    def _loss(self, chi2: FloatArray, width: float) -> FloatArray:
        """Cauchy's loss: quadratic near 0, logarithmic far out, so that outliers lose their weight."""
        c2 = (width * self.config.cauchy_scale) ** 2
        return c2 * np.log1p(chi2 / c2)

    def _loss_derivative(self, chi2: FloatArray, width: float) -> FloatArray:
        """Derivative of the loss: the weight of a constraint."""
        return 1 / (1 + chi2 / (width * self.config.cauchy_scale) ** 2)


@dataclass(frozen=True, slots=True)
class Solution:
    """State of an optimization.

    The loss starts so wide that every new loop has its full weight, however far the map has drifted, and is
    narrowed from step to step (graduated non-convexity): outliers lose their weight in the end.

    Attributes:
        submaps: (s, 3) poses.
        nodes: (n, 3) poses.
        cost: of these poses.
        damping: Levenberg's damping of the next step.
        width: of the loss, times the configured scale.
        iterations: steps so far.
        converged: whether no further step is worthwhile.
    """

    submaps: FloatArray
    nodes: FloatArray
    cost: float
    damping: float
    width: float = 1.0
    iterations: int = 0
    converged: bool = False


def start_optimization(
    problem: OptimizationProblem, submaps: FloatArray, nodes: FloatArray, new_since: int = 0
) -> Solution:
    """Start from poses; the constraints to nodes from row `new_since` on are new."""
    width = problem.initial_width(submaps, nodes, new_since)
    return Solution(
        submaps, nodes, problem.cost(submaps, nodes, width), problem.config.initial_damping, width
    )


def iterate(problem: OptimizationProblem, now: Solution) -> Solution:
    """Try one Levenberg-Marquardt step; a step that does not lower the cost is rejected."""
    c = problem.config
    submaps, nodes = problem.solve_normal_equations(now.submaps, now.nodes, now.damping, now.width)
    cost, count = problem.cost(submaps, nodes, now.width), now.iterations + 1
    last = count >= c.max_num_iterations
    if not cost < now.cost:
        stuck = cost <= now.cost * (1 + c.function_tolerance) or now.damping > 1e4
        if not stuck:
            return replace(now, damping=now.damping * 10, iterations=count, converged=last)
        submaps, nodes, cost = now.submaps, now.nodes, now.cost
    damping = max(now.damping / 10, 1e-9)
    if now.width > 1:
        width = max(1.0, now.width / c.scale_reduction)
        cost = problem.cost(submaps, nodes, width)
        return Solution(submaps, nodes, cost, damping, width, count, last)
    converged = last or now.cost - cost <= c.function_tolerance * now.cost
    return Solution(submaps, nodes, cost, damping, 1.0, count, converged)


def optimize(problem: OptimizationProblem, start: Solution) -> Solution:
    """Iterate until converged."""
    while not start.converged:
        start = iterate(problem, start)
    return start


def _moved(poses: FloatArray, step: FloatArray) -> FloatArray:
    moved = poses + step
    moved[:, 2] = wrap(moved[:, 2])
    return moved


def errors(a: FloatArray, b: FloatArray, z: FloatArray) -> FloatArray:
    """Return (m, 3) the estimated minus the measured pose of b in the frame of a (eq. 6)."""
    e = relative_poses(a, b) - z
    e[:, 2] = wrap(e[:, 2])
    return e


def jacobians(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (m, 3, 3) the derivatives of the errors with respect to a and to b."""
    c, s = np.cos(a[:, 2]), np.sin(a[:, 2])
    dx, dy = b[:, 0] - a[:, 0], b[:, 1] - a[:, 1]
    Jb = np.zeros((len(a), 3, 3))
    Jb[:, 0, 0], Jb[:, 0, 1], Jb[:, 1, 0], Jb[:, 1, 1], Jb[:, 2, 2] = c, s, -s, c, 1
    Ja = -Jb
    Ja[:, 0, 2], Ja[:, 1, 2] = c * dy - s * dx, -s * dy - c * dx
    return Ja, Jb
