"""Pose-graph optimization: submaps and nodes, and the constraints between them.

Hess et al. 2016, section V-A (after Konolige et al. 2010): the poses minimize the sum of rho(e' Lambda e)
over all constraints, e the difference between the measured pose of b in the frame of a and the estimated one.
Every constraint has a submap at one end, so that nodes are constrained to submaps only: the Schur complement
eliminates them block by block, and the matrix that is factorized grows with the number of submaps alone.

With R the rotation of submap a, d the way from a to b in the map's axes, and W the information, the
derivatives of the error e are Jb = diag(R', 1) and Ja = -Jb M, with M = [[1, 0, -dy], [0, 1, dx], [0, 0, 1]].
All blocks follow from K = Jb' W Jb and k = Jb' W e: Ja' W Ja = M' K M, Ja' W Jb = -M' K, Ja' W e = -M' k.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from lirs_wct.geometry import BoolArray, FloatArray, IntArray, njit, relative_poses, wrap_angles
from slam_baselines.cartographer.config import CartographerConfig
from slam_baselines.registration import invert3


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


class PoseConstraints(NamedTuple):
    """Constraints as arrays (m, ...), with the fields of PoseConstraint."""

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


@dataclass(frozen=True)
class OptimizationProblem:
    """Nonlinear least-squares problem over the poses of submaps and nodes.

    The first node is held at the origin (3,).
    """

    config: CartographerConfig
    to_nodes: PoseConstraints
    to_submaps: PoseConstraints
    origin: FloatArray

    @cached_property
    def pattern(self) -> BlockPattern:
        """Block pattern of the submaps' matrix, the same in every step."""
        indices = (self.to_nodes.a, self.to_submaps.a, self.to_submaps.b)
        submaps = 1 + max(int(index.max(initial=-1)) for index in indices)
        return BlockPattern.of(self.to_nodes, self.to_submaps, submaps)

    def cost(self, submaps: FloatArray, nodes: FloatArray, width: float) -> float:
        """Return half the sum of robust squared errors of submaps (s, 3), nodes (n, 3).

        Cauchy's scale is `width` times the configured one.
        """
        scale = width * self.config.cauchy_scale
        total: float = robust_cost(self.to_nodes, submaps, nodes, scale)
        total += robust_cost(self.to_submaps, submaps, submaps, scale)
        gauge = nodes[0] - self.origin
        gauge[2] = wrap_angles(gauge[2])
        return 0.5 * (total + self.config.gauge_information * float(gauge @ gauge))

    def initial_width(self, submaps: FloatArray, nodes: FloatArray, since: int) -> float:
        """Return the loss width that holds the errors of all loops from row `since` on."""
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
        to_nodes, to_submaps = self.to_nodes, self.to_submaps
        cross, odometry = np.empty((len(to_nodes.a), 3, 3)), np.empty((len(to_submaps.a), 3, 3))
        linearize(to_nodes, submaps, nodes, scale, (Hs, gs), (Hn, gn), cross)
        linearize(to_submaps, submaps, submaps, scale, (Hs, gs), (Hs, gs), odometry)
        gauge = nodes[0] - self.origin
        gauge[2] = wrap_angles(gauge[2])
        Hn[0] += self.config.gauge_information * np.eye(3)
        gn[0] += self.config.gauge_information * gauge
        damped = 1 + damping * np.eye(3)
        blocks, inverse = np.zeros((len(pattern.row), 3, 3)), np.empty_like(Hn)
        blocks[pattern.diagonal] = Hs * damped
        np.add.at(blocks, pattern.odometry[0], odometry)
        np.add.at(blocks, pattern.odometry[1], odometry.transpose(0, 2, 1))
        places = (pattern.order, pattern.node, pattern.pair)
        eliminate_nodes(places, to_nodes.a, cross, (Hn * damped, gn), blocks, gs, inverse)
        ds = -splu(pattern.matrix(blocks)).solve(gs.ravel()).reshape(-1, 3)
        return _apply_steps(submaps, ds), _apply_steps(nodes, node_steps(to_nodes, cross, ds, gn, inverse))


@dataclass(frozen=True, slots=True)
class Solution:
    """State of an optimization: submaps (s, 3), nodes (n, 3), and their cost.

    The loss starts so wide that every new loop has its full weight, however far the map has drifted, and is
    narrowed from step to step (graduated non-convexity): outliers lose their weight in the end. Its width is
    in configured scales. Converged: no further step is worthwhile.
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
    """Try one Levenberg-Marquardt step; reject it if it does not lower the cost."""
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


def _apply_steps(poses: FloatArray, step: FloatArray) -> FloatArray:
    moved = poses + step
    moved[:, 2] = wrap_angles(moved[:, 2])
    return moved


def errors(a: FloatArray, b: FloatArray, z: FloatArray) -> FloatArray:
    """Return (m, 3) errors: estimated minus measured pose of b in the frame of a (eq. 6)."""
    e = relative_poses(a, b) - z
    e[:, 2] = wrap_angles(e[:, 2])
    return e


@dataclass(frozen=True, slots=True)
class BlockPattern:
    """Nonzero (3, 3) blocks of the matrix over the submaps.

    Attributes:
        order: (m,) constraints to nodes, by node.
        node: (m,) their nodes.
        row: (k,) block row of each block, ascending.
        col: (k,) block column.
        diagonal: (s,) the block of each submap itself.
        pair: the block of each two constraints of a node: node by node, in order, all with all.
        odometry: (2, q) the blocks of each constraint between submaps, above and below the diagonal.
    """

    order: IntArray
    node: IntArray
    row: IntArray
    col: IntArray
    diagonal: IntArray
    pair: IntArray
    odometry: IntArray

    @staticmethod
    def of(to_nodes: PoseConstraints, to_submaps: PoseConstraints, submaps: int) -> BlockPattern:
        """Return the pattern of a graph with a number of submaps."""
        order = np.argsort(to_nodes.b, kind="stable")
        node, submap = to_nodes.b[order], to_nodes.a[order]
        pairs = _pairs(np.flatnonzero(np.diff(node, prepend=-1)), submap, submaps)
        a, b = to_submaps.a, to_submaps.b
        keys = (np.arange(submaps) * (submaps + 1), pairs, a * submaps + b, b * submaps + a)
        found, place = np.unique(np.concatenate(keys), return_inverse=True)
        diagonal, pair, above, below = np.split(place, np.cumsum([len(key) for key in keys])[:-1])
        return BlockPattern(
            order, node, found // submaps, found % submaps, diagonal, pair, np.stack((above, below))
        )

    def matrix(self, blocks: FloatArray) -> sparse.csc_matrix:
        """Return the sparse matrix of (k, 3, 3) blocks."""
        s = len(self.diagonal)
        begin = np.searchsorted(self.row, np.arange(s + 1))
        return sparse.bsr_matrix((blocks, self.col, begin), shape=(3 * s, 3 * s)).tocsc()


@njit
def _pairs(first: IntArray, submap: IntArray, submaps: int) -> IntArray:
    """Return row * submaps + column for each pair of constraints of a node.

    The constraints of node n begin at `first[n]`.
    """
    total = 0
    for n in range(len(first)):
        count = (first[n + 1] if n + 1 < len(first) else len(submap)) - first[n]
        total += count * count
    keys, at = np.empty(total, np.int64), 0
    for n in range(len(first)):
        end = first[n + 1] if n + 1 < len(first) else len(submap)
        for p in range(first[n], end):
            for q in range(first[n], end):
                keys[at] = submap[p] * submaps + submap[q]
                at += 1
    return keys


@njit
def robust_cost(rows: PoseConstraints, submaps: FloatArray, targets: FloatArray, scale: float) -> float:
    """Return the sum of e'We, of robust constraints under Cauchy's loss of a scale."""
    a, b, z, information, robust = rows
    total, c2 = 0.0, scale * scale
    for k in range(len(a)):
        x, y, yaw = pose_error(submaps[a[k]], targets[b[k]], z[k])
        chi2 = _chi2(information[k], x, y, yaw)
        total += c2 * math.log1p(chi2 / c2) if robust[k] else chi2
    return total


@njit
def linearize(
    rows: PoseConstraints,
    submaps: FloatArray,
    targets: FloatArray,
    scale: float,
    of_submaps: tuple[FloatArray, FloatArray],
    of_targets: tuple[FloatArray, FloatArray],
    cross: FloatArray,
) -> None:
    """Add the constraints to the normal equations of submaps and targets.

    Ja'WJa and Ja'We are added to those of the submaps, (s, 3, 3) and (s, 3), Jb'WJb and Jb'We to those of the
    targets. `cross` (m, 3, 3) is filled with Ja'WJb. A robust constraint weighs as the derivative of its
    loss.
    """
    a, b, z, information, robust = rows
    M, J, e, c2 = np.eye(3), np.eye(3), np.zeros(3), scale * scale
    WJ, K, MK, MKM = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for k in range(len(a)):
        i, j = a[k], b[k]
        e[0], e[1], e[2] = pose_error(submaps[i], targets[j], z[k])
        weight = 1.0
        if robust[k]:
            weight = 1.0 / (1.0 + _chi2(information[k], e[0], e[1], e[2]) / c2)
        c, s = math.cos(submaps[i, 2]), math.sin(submaps[i, 2])
        J[0, 0], J[0, 1], J[1, 0], J[1, 1] = c, s, -s, c
        M[0, 2], M[1, 2] = submaps[i, 1] - targets[j, 1], targets[j, 0] - submaps[i, 0]
        _multiply(information[k], J, WJ)
        _multiply_transposed(J, WJ, K)
        _multiply_transposed(M, K, MK)
        _multiply(MK, M, MKM)
        for r in range(3):
            ke = weight * (WJ[0, r] * e[0] + WJ[1, r] * e[1] + WJ[2, r] * e[2])
            of_targets[1][j, r] += ke
            for q in range(3):
                # M'k, row by row of M'.
                of_submaps[1][i, q] -= M[r, q] * ke
                of_submaps[0][i, r, q] += weight * MKM[r, q]
                of_targets[0][j, r, q] += weight * K[r, q]
                cross[k, r, q] = -weight * MK[r, q]


@njit
def eliminate_nodes(
    pattern: tuple[IntArray, IntArray, IntArray],
    submap: IntArray,
    cross: FloatArray,
    of_nodes: tuple[FloatArray, FloatArray],
    blocks: FloatArray,
    gradient: FloatArray,
    inverse: FloatArray,
) -> None:
    """Eliminate the nodes from the equations of the submaps (Schur complement) by blocks.

    Args:
        pattern: Order, node and pair of the `BlockPattern`.
        submap: (m,) of each constraint to a node.
        cross: (m, 3, 3) Ja'WJb of each.
        of_nodes: Damped blocks (n, 3, 3) and gradients (n, 3).
        blocks: (k, 3, 3) of the submaps' matrix; updated in place.
        gradient: (s, 3) of the submaps; updated in place.
        inverse: (n, 3, 3) is filled with the inverses of the nodes' blocks.
    """
    order, node, pair = pattern
    H, g = of_nodes
    for n in range(len(H)):
        found = invert3(H[n])
        for r in range(3):
            for c in range(3):
                inverse[n, r, c] = found[r, c]
    Y, begin, at = np.empty((3, 3)), 0, 0
    while begin < len(order):
        n, end = node[begin], begin
        while end < len(order) and node[end] == n:
            end += 1
        for p in range(begin, end):
            _multiply(cross[order[p]], inverse[n], Y)
            i = submap[order[p]]
            for r in range(3):
                gradient[i, r] -= Y[r, 0] * g[n, 0] + Y[r, 1] * g[n, 1] + Y[r, 2] * g[n, 2]
            for q in range(begin, end):
                block, B = blocks[pair[at]], cross[order[q]]
                for r in range(3):
                    for c in range(3):
                        block[r, c] -= Y[r, 0] * B[c, 0] + Y[r, 1] * B[c, 1] + Y[r, 2] * B[c, 2]
                at += 1
        begin = end


@njit
def node_steps(
    rows: PoseConstraints,
    cross: FloatArray,
    submap_steps: FloatArray,
    gradient: FloatArray,
    inverse: FloatArray,
) -> FloatArray:
    """Return the (n, 3) steps of the nodes given those of the submaps."""
    a, b = rows.a, rows.b
    rest, steps = gradient.copy(), np.zeros(gradient.shape)
    for k in range(len(a)):
        for r in range(3):
            for q in range(3):
                rest[b[k], q] += cross[k, r, q] * submap_steps[a[k], r]
    for n in range(len(rest)):
        for r in range(3):
            for q in range(3):
                steps[n, r] -= inverse[n, r, q] * rest[n, q]
    return steps


@njit
def pose_error(a: FloatArray, b: FloatArray, z: FloatArray) -> tuple[float, float, float]:
    """Return the error: estimated minus measured pose of b in the frame of a (eq. 6)."""
    c, s, dx, dy = math.cos(a[2]), math.sin(a[2]), b[0] - a[0], b[1] - a[1]
    yaw = (b[2] - a[2] - z[2] + math.pi) % math.tau - math.pi
    return c * dx + s * dy - z[0], c * dy - s * dx - z[1], yaw


@njit
def _chi2(W: FloatArray, x: float, y: float, yaw: float) -> float:
    """Return e'We."""
    total = x * (W[0, 0] * x + W[0, 1] * y + W[0, 2] * yaw)
    total += y * (W[1, 0] * x + W[1, 1] * y + W[1, 2] * yaw)
    total += yaw * (W[2, 0] * x + W[2, 1] * y + W[2, 2] * yaw)
    return float(total)


@njit
def _multiply(A: FloatArray, B: FloatArray, out: FloatArray) -> None:
    """Fill `out` with A B, each (3, 3)."""
    for i in range(3):
        for j in range(3):
            out[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]


@njit
def _multiply_transposed(A: FloatArray, B: FloatArray, out: FloatArray) -> None:
    """Fill `out` with A' B, each (3, 3)."""
    for i in range(3):
        for j in range(3):
            out[i, j] = A[0, i] * B[0, j] + A[1, i] * B[1, j] + A[2, i] * B[2, j]
