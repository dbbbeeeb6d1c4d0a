"""The sparse pose graph: submaps and nodes, and the constraints between them.

Hess et al. 2016, section V-A (after Konolige et al. 2010): the poses minimise the sum of
rho(e' Lambda e) over all constraints, e the difference between the measured pose of b in the frame of a
and the estimated one. Every constraint has a submap at one end, so that nodes are tied to submaps only:
they are eliminated block by block, and what is factorised is as large as the number of submaps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse.linalg import splu

from lirs_wct.arrays import BoolArray, FloatArray, IntArray
from lirs_wct.errors import ConfigError
from slam_baselines.common.linalg import block_matrix, sum_blocks, sum_vectors
from slam_baselines.common.se2 import inverted, relative_poses, wrap


@dataclass(frozen=True, kw_only=True)
class OptimizationConfig:
    """How the graph is solved; `huber_scale` as in Cartographer's optimization_problem.

    Attributes:
        huber_scale: error, in standard deviations, from which on a loop counts less and less ...
        narrowing: the kernel starts wide and is narrowed by this factor from step to step.
        max_num_iterations: of Levenberg and Marquardt, at most, each time.
        converged: ends when a step lowers the cost by less than this share.
        damping: Levenberg's, at first, as a share of the diagonal.
        gauge: information of the tie that holds the first node where it is.

    Raises:
        ConfigError: a value that is not above 0, or narrowing not above 1.
    """

    huber_scale: float = 3.0
    narrowing: float = 2.0
    max_num_iterations: int = 30
    converged: float = 1e-4
    damping: float = 1e-4
    gauge: float = 1e8

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            if not getattr(self, name) > 0:
                raise ConfigError(f"{name} of the optimization must be above 0, got {getattr(self, name)}")
        if not self.narrowing > 1:
            raise ConfigError(f"narrowing of the optimization must be above 1, got {self.narrowing}")


@dataclass(frozen=True, slots=True)
class Problem:
    """What is to be solved: constraints from submaps to nodes and from submaps to submaps.

    Attributes:
        config: how.
        to_nodes: constraints whose b are nodes.
        to_submaps: constraints whose b are submaps.
        origin: (3,) where the first node is held.
    """

    config: OptimizationConfig
    to_nodes: Edges
    to_submaps: Edges
    origin: FloatArray

    def cost(self, submaps: FloatArray, nodes: FloatArray, width: float) -> float:
        """Return half the sum of the robust squared errors of (s, 3) submaps and (n, 3) nodes.

        The kernel is `width` times as wide as configured.
        """
        total = 0.0
        for edges, targets in ((self.to_nodes, nodes), (self.to_submaps, submaps)):
            e = errors(submaps[edges.a], targets[edges.b], edges.z)
            chi2 = np.einsum("mi,mij,mj->m", e, edges.information, e)
            total += float(np.where(edges.robust, self._rho(chi2, width), chi2).sum())
        tie = nodes[0] - self.origin
        tie[2] = wrap(tie[2])
        return 0.5 * (total + self.config.gauge * float(tie @ tie))

    def width(self, submaps: FloatArray, nodes: FloatArray, since: int) -> float:
        """Return how wide the kernel must be for none of the loops from row `since` on to lose its pull."""
        late = slice(since, None)
        robust = self.to_nodes.robust[late]
        if not robust.any():
            return 1.0
        a, b = self.to_nodes.a[late][robust], self.to_nodes.b[late][robust]
        e = errors(submaps[a], nodes[b], self.to_nodes.z[late][robust])
        chi2 = np.einsum("mi,mij,mj->m", e, self.to_nodes.information[late][robust], e)
        return max(1.0, math.sqrt(float(chi2.max())) / self.config.huber_scale)

    def step(
        self, submaps: FloatArray, nodes: FloatArray, damping: float, width: float
    ) -> tuple[FloatArray, FloatArray]:
        """Return submaps and nodes after one Gauss-Newton step with Levenberg's damping."""
        n, s = len(nodes), len(submaps)
        A, B, C, ga, gb = self._linearised(self.to_nodes, submaps, nodes, width)
        Hnn, gn = sum_blocks(C, self.to_nodes.b, n), sum_vectors(gb, self.to_nodes.b, n)
        Hnn[0] += self.config.gauge * np.eye(3)
        tie = nodes[0] - self.origin
        gn[0] += self.config.gauge * np.array((tie[0], tie[1], wrap(tie[2])))
        Hsn = block_matrix(B, self.to_nodes.a, self.to_nodes.b, s, n)
        A2, B2, C2, ga2, gb2 = self._linearised(self.to_submaps, submaps, submaps, width)
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

    def _linearised(
        self, edges: Edges, submaps: FloatArray, targets: FloatArray, width: float
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return the blocks Ja'WJa, Ja'WJb, Jb'WJb (m, 3, 3) and the gradients Ja'We, Jb'We (m, 3)."""
        e = errors(submaps[edges.a], targets[edges.b], edges.z)
        Ja, Jb = jacobians(submaps[edges.a], targets[edges.b])
        W = edges.information
        if edges.robust.any():
            chi2 = np.einsum("mi,mij,mj->m", e, W, e)
            W = W * np.where(edges.robust, self._weight(chi2, width), 1.0)[:, None, None]
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

    def _rho(self, chi2: FloatArray, width: float) -> FloatArray:
        """Cauchy's loss: quadratic near 0, logarithmic far out, so that wrong loops lose their pull."""
        c2 = (width * self.config.huber_scale) ** 2
        return c2 * np.log1p(chi2 / c2)

    def _weight(self, chi2: FloatArray, width: float) -> FloatArray:
        """Derivative of the loss."""
        return 1 / (1 + chi2 / (width * self.config.huber_scale) ** 2)


@dataclass(frozen=True, slots=True)
class Solution:
    """Where an optimisation stands.

    The kernel starts so wide that every new loop pulls, however far the map has drifted, and is narrowed
    from step to step (graduated non-convexity): what contradicts all others loses its pull in the end.

    Attributes:
        submaps: (s, 3) poses.
        nodes: (n, 3) poses.
        cost: of them.
        damping: Levenberg's, for the next step.
        width: of the kernel, times the configured one.
        iterations: steps so far.
        done: whether no further step is worth while.
    """

    submaps: FloatArray
    nodes: FloatArray
    cost: float
    damping: float
    width: float = 1.0
    iterations: int = 0
    done: bool = False


def begin(problem: Problem, submaps: FloatArray, nodes: FloatArray, since: int = 0) -> Solution:
    """Start from poses; the constraints to nodes from row `since` on are new."""
    width = problem.width(submaps, nodes, since)
    return Solution(submaps, nodes, problem.cost(submaps, nodes, width), problem.config.damping, width)


def improve(problem: Problem, now: Solution) -> Solution:
    """Try one step of Levenberg and Marquardt; a step that does not lower the cost is not taken."""
    c = problem.config
    submaps, nodes = problem.step(now.submaps, now.nodes, now.damping, now.width)
    cost, count = problem.cost(submaps, nodes, now.width), now.iterations + 1
    last = count >= c.max_num_iterations
    if not cost < now.cost:
        hopeless = cost <= now.cost * (1 + c.converged) or now.damping > 1e4
        if not hopeless:
            return replace(now, damping=now.damping * 10, iterations=count, done=last)
        submaps, nodes, cost = now.submaps, now.nodes, now.cost
    damping = max(now.damping / 10, 1e-9)
    if now.width > 1:
        width = max(1.0, now.width / c.narrowing)
        cost = problem.cost(submaps, nodes, width)
        return Solution(submaps, nodes, cost, damping, width, count, last)
    done = last or now.cost - cost <= c.converged * now.cost
    return Solution(submaps, nodes, cost, damping, 1.0, count, done)


def solve(problem: Problem, submaps: FloatArray, nodes: FloatArray) -> Solution:
    """Iterate until it is done."""
    solution = begin(problem, submaps, nodes)
    while not solution.done:
        solution = improve(problem, solution)
    return solution


def _moved(poses: FloatArray, step: FloatArray) -> FloatArray:
    moved = poses + step
    moved[:, 2] = wrap(moved[:, 2])
    return moved


@dataclass(frozen=True, slots=True)
class Edges:
    """Constraints as arrays.

    Attributes:
        a: (m,) index of the submap in whose frame it was measured.
        b: (m,) index of the node, or of another submap.
        z: (m, 3) measured x, y, yaw of b in the frame of a.
        information: (m, 3, 3) inverse covariance of z.
        robust: (m,) whether it may be wrong altogether.
    """

    a: IntArray
    b: IntArray
    z: FloatArray
    information: FloatArray
    robust: BoolArray

    @staticmethod
    def of(rows: Sequence[tuple[int, int, FloatArray, FloatArray, bool]]) -> Edges:
        """Stack (a, b, z, information, robust) of each constraint."""
        return Edges(
            np.array([r[0] for r in rows], dtype=np.int64),
            np.array([r[1] for r in rows], dtype=np.int64),
            np.array([r[2] for r in rows], dtype=np.float64).reshape(-1, 3),
            np.array([r[3] for r in rows], dtype=np.float64).reshape(-1, 3, 3),
            np.array([r[4] for r in rows], dtype=np.bool_),
        )


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
