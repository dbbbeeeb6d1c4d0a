"""Normal equations of the pose graph: constraint by constraint, then without the nodes.

With R the rotation of submap a, d the way from a to b in the map's axes, and W the information, the
derivatives of the error e are Jb = diag(R', 1) and Ja = -Jb M, with M = [[1, 0, -dy], [0, 1, dx], [0, 0, 1]].
All blocks follow from K = Jb' W Jb and k = Jb' W e: Ja' W Ja = M' K M, Ja' W Jb = -M' K, Ja' W e = -M' k.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from lirs_wct.arrays import BoolArray, FloatArray, IntArray
from lirs_wct.kernels import njit
from slam_baselines.common.linalg import invert3

Rows = tuple[IntArray, IntArray, FloatArray, FloatArray, BoolArray]
"""a, b, z, information and robust of (m,) constraints (see `PoseConstraints`)."""


@dataclass(frozen=True, slots=True)
class BlockPattern:
    """Where the matrix over the submaps has (3, 3) blocks that are not 0.

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
    def of(to_nodes: Rows, to_submaps: Rows, submaps: int) -> BlockPattern:
        """Return the pattern of a graph with a number of submaps."""
        order = np.argsort(to_nodes[1], kind="stable")
        node, submap = to_nodes[1][order], to_nodes[0][order]
        pairs = _pairs(np.flatnonzero(np.diff(node, prepend=-1)), submap, submaps)
        a, b = to_submaps[0], to_submaps[1]
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


@njit(cache=True, nogil=True)
def _pairs(first: IntArray, submap: IntArray, submaps: int) -> IntArray:
    """Return row * submaps + column of each two constraints of a node, whose constraints begin at `first`."""
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


@njit(cache=True, nogil=True)
def robust_cost(rows: Rows, submaps: FloatArray, targets: FloatArray, scale: float) -> float:
    """Return the sum of e'We, of robust constraints under Cauchy's loss of a scale."""
    a, b, z, information, robust = rows
    total, c2 = 0.0, scale * scale
    for k in range(len(a)):
        x, y, yaw = pose_error(submaps[a[k]], targets[b[k]], z[k])
        chi2 = _squared(information[k], x, y, yaw)
        total += c2 * math.log1p(chi2 / c2) if robust[k] else chi2
    return total


@njit(cache=True, nogil=True)
def linearize(
    rows: Rows,
    submaps: FloatArray,
    targets: FloatArray,
    scale: float,
    of_submaps: tuple[FloatArray, FloatArray],
    of_targets: tuple[FloatArray, FloatArray],
    cross: FloatArray,
) -> None:
    """Add Ja'WJa and Ja'We to those of the submaps, (s, 3, 3) and (s, 3), Jb'WJb and Jb'We to the targets'.

    `cross` (m, 3, 3) is filled with Ja'WJb. A robust constraint weighs as the derivative of its loss.
    """
    a, b, z, information, robust = rows
    M, J, e, c2 = np.eye(3), np.eye(3), np.zeros(3), scale * scale
    WJ, K, MK, MKM = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for k in range(len(a)):
        i, j = a[k], b[k]
        e[0], e[1], e[2] = pose_error(submaps[i], targets[j], z[k])
        weight = 1.0
        if robust[k]:
            weight = 1.0 / (1.0 + _squared(information[k], e[0], e[1], e[2]) / c2)
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


@njit(cache=True, nogil=True)
def eliminate_nodes(
    pattern: tuple[IntArray, IntArray, IntArray],
    submap: IntArray,
    cross: FloatArray,
    of_nodes: tuple[FloatArray, FloatArray],
    blocks: FloatArray,
    gradient: FloatArray,
    inverse: FloatArray,
) -> None:
    """Take the nodes out of the equations of the submaps (Schur complement), block by block.

    Args:
        pattern: order, node and pair of the `BlockPattern`.
        submap: (m,) of each constraint to a node.
        cross: (m, 3, 3) Ja'WJb of each.
        of_nodes: damped blocks (n, 3, 3) and gradients (n, 3).
        blocks: (k, 3, 3) of the submaps' matrix; goes on.
        gradient: (s, 3) of the submaps; goes on.
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


@njit(cache=True, nogil=True)
def node_steps(
    rows: Rows, cross: FloatArray, submap_steps: FloatArray, gradient: FloatArray, inverse: FloatArray
) -> FloatArray:
    """Return (n, 3) the steps of the nodes that follow from those of the submaps."""
    a, b = rows[0], rows[1]
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


@njit(cache=True, nogil=True)
def pose_error(a: FloatArray, b: FloatArray, z: FloatArray) -> tuple[float, float, float]:
    """Return the estimated minus the measured pose of b in the frame of a (eq. 6), each pose (3,)."""
    c, s, dx, dy = math.cos(a[2]), math.sin(a[2]), b[0] - a[0], b[1] - a[1]
    yaw = (b[2] - a[2] - z[2] + math.pi) % math.tau - math.pi
    return c * dx + s * dy - z[0], c * dy - s * dx - z[1], yaw


@njit(cache=True, nogil=True)
def _squared(W: FloatArray, x: float, y: float, yaw: float) -> float:
    """Return e'We."""
    total = x * (W[0, 0] * x + W[0, 1] * y + W[0, 2] * yaw)
    total += y * (W[1, 0] * x + W[1, 1] * y + W[1, 2] * yaw)
    total += yaw * (W[2, 0] * x + W[2, 1] * y + W[2, 2] * yaw)
    return float(total)


@njit(cache=True, nogil=True)
def _multiply(A: FloatArray, B: FloatArray, out: FloatArray) -> None:
    """Fill `out` with A B, each (3, 3)."""
    for i in range(3):
        for j in range(3):
            out[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]


@njit(cache=True, nogil=True)
def _multiply_transposed(A: FloatArray, B: FloatArray, out: FloatArray) -> None:
    """Fill `out` with A' B, each (3, 3)."""
    for i in range(3):
        for j in range(3):
            out[i, j] = A[0, i] * B[0, j] + A[1, i] * B[1, j] + A[2, i] * B[2, j]
