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
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.sparse.linalg import splu

from lirs_wct.arrays import BoolArray, FloatArray, IntArray
from slam_baselines.cartographer.config import OptimizationConfig
from slam_baselines.cartographer.pose_graph.normal_equations import (
    BlockPattern,
    Rows,
    eliminate_nodes,
    linearize,
    node_steps,
    robust_cost,
)
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

    @property
    def rows(self) -> Rows:
        """The arrays, for the kernels."""
        return self.a, self.b, self.z, self.information, self.robust

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


@dataclass(frozen=True)
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

    @cached_property
    def pattern(self) -> BlockPattern:
        """Where the submaps' matrix has blocks: the same in every step."""
        indices = (self.to_nodes.a, self.to_submaps.a, self.to_submaps.b)
        submaps = 1 + max(int(index.max(initial=-1)) for index in indices)
        return BlockPattern.of(self.to_nodes.rows, self.to_submaps.rows, submaps)

    def cost(self, submaps: FloatArray, nodes: FloatArray, width: float) -> float:
        """Return half the sum of the robust squared errors of (s, 3) submaps and (n, 3) nodes.

        Cauchy's scale is `width` times the configured one.
        """
        scale = width * self.config.cauchy_scale
        total: float = robust_cost(self.to_nodes.rows, submaps, nodes, scale)
        total += robust_cost(self.to_submaps.rows, submaps, submaps, scale)
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
        pattern, scale = self.pattern, width * self.config.cauchy_scale
        s, n = len(submaps), len(nodes)
        (Hs, gs), (Hn, gn) = ((np.zeros((k, 3, 3)), np.zeros((k, 3))) for k in (s, n))
        to_nodes, to_submaps = self.to_nodes.rows, self.to_submaps.rows
        cross, odometry = np.empty((len(to_nodes[0]), 3, 3)), np.empty((len(to_submaps[0]), 3, 3))
        linearize(to_nodes, submaps, nodes, scale, (Hs, gs), (Hn, gn), cross)
        linearize(to_submaps, submaps, submaps, scale, (Hs, gs), (Hs, gs), odometry)
        gauge = nodes[0] - self.origin
        gauge[2] = wrap(gauge[2])
        Hn[0] += self.config.gauge_information * np.eye(3)
        gn[0] += self.config.gauge_information * gauge
        damped = 1 + damping * np.eye(3)
        blocks, inverse = np.zeros((len(pattern.row), 3, 3)), np.empty_like(Hn)
        blocks[pattern.diagonal] = Hs * damped
        np.add.at(blocks, pattern.odometry[0], odometry)
        np.add.at(blocks, pattern.odometry[1], odometry.transpose(0, 2, 1))
        places = (pattern.order, pattern.node, pattern.pair)
        eliminate_nodes(places, to_nodes[0], cross, (Hn * damped, gn), blocks, gs, inverse)
        ds = -splu(pattern.matrix(blocks)).solve(gs.ravel()).reshape(-1, 3)
        return _moved(submaps, ds), _moved(nodes, node_steps(to_nodes, cross, ds, gn, inverse))


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
