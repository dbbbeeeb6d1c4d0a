"""Pose graph of the original and its loop search in finished submaps.

As in the original's pose_graph_2d, work that its threads do later is done at once here, in the same order.

Loops: Hess et al. 2016, section V-B, as in the original's fast_correlative_scan_matcher_2d and
constraint_builder_2d.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import block_diag, cho_solve_banded, cholesky_banded, solve

from lirs_extensions.originals.cartographer.config import CartographerOriginalConfig
from lirs_extensions.originals.cartographer.local_slam import GridSubmap, TrajectoryNode
from lirs_extensions.originals.cartographer.probability_grid import COST, MAX_COST, MIN_COST, ProbabilityGrid
from lirs_extensions.originals.cartographer.scan_matching import (
    NormalEquations,
    match_scan,
    minimize,
    rotated_cells,
    shifted_pose,
)
from lirs_wct.geometry import ByteArray, Float32Array, FloatArray, Pose2, njit
from slam_baselines.cartographer.branch_and_bound import fill_bounds
from slam_baselines.cartographer.loop_closure import LoopEvent
from slam_baselines.cartographer.pose_graph import PoseConstraint, PoseConstraints, errors, linearize

MAX_BOUND = 255
"""Bound that stands for the largest probability of a cell; 0 is the smallest, as of unknown cells."""


class LoopSearcher:
    """Searches one finished submap; its bounds are computed once."""

    def __init__(self, grid: ProbabilityGrid, config: CartographerOriginalConfig) -> None:
        self._grid, self._config = grid, config
        self._bounds = bound_grids(grid, config.branch_and_bound_depth)
        self._num_pulses = self._num_samples = 0

    @property
    def nbytes(self) -> int:
        """Memory of the bounds."""
        return self._bounds.nbytes

    def draw_sample(self) -> bool:
        """Return whether the next node is searched for: a fixed share of them."""
        self._num_pulses += 1
        if self._num_samples / self._num_pulses >= self._config.sampling_ratio:
            return False
        self._num_samples += 1
        return True

    def search(self, points: Float32Array, expected: Pose2) -> tuple[Pose2, float] | None:
        """Return the best pose of points (n, 2) near an expected one, and its score, if good enough.

        The score is the mean probability before refinement.
        """
        c, grid = self._config, self._grid
        cells, turns, reach = rotated_cells(
            grid, points, expected, c.linear_search_window, c.angular_search_window
        )
        size = np.array(grid.cells.shape)
        low = np.maximum(-reach, np.minimum(0, -cells.max(axis=1)))
        high = np.minimum(reach, np.maximum(0, size - 1 - cells.min(axis=1)))
        scale = float(MAX_COST - MIN_COST) / MAX_BOUND
        least = (c.min_score - float(1 - MAX_COST)) / scale * len(points)
        margin = (1 << (c.branch_and_bound_depth - 1)) - 1
        indices = np.ascontiguousarray(cells.transpose(0, 2, 1)) + margin
        total, k, row, col = _best_candidate(self._bounds, indices, low, high, math.floor(least))
        if total < 0:
            return None
        edge = grid.resolution
        found = shifted_pose(expected, row * edge, col * edge, float(turns[k]))
        score = float(1 - MAX_COST) + scale * total / len(points)
        return match_scan(grid, points, found, found, c.loop_matcher), score


def bound_grids(grid: ProbabilityGrid, depth: int) -> ByteArray:
    """Return (depth, rows + margin, cols + margin) upper bounds of the probability.

    Level i holds the largest of the 2^i x 2^i cells that begin at a cell. The margin of 2^(depth - 1) - 1
    cells lies before the first row and column.
    """
    margin = (1 << (depth - 1)) - 1
    probability = (MAX_COST - COST[grid.cells]) * (MAX_BOUND / (MAX_COST - MIN_COST))
    rows, cols = grid.cells.shape
    bounds = np.zeros((depth, rows + margin, cols + margin), np.uint8)
    bounds[0, margin:, margin:] = np.floor(probability + 0.5)
    fill_bounds(bounds)
    return bounds


@njit
def _best_candidate(bounds: Any, cells: Any, low: Any, high: Any, least: int) -> tuple[int, int, int, int]:
    """Return the best sum above `least` on the finest level: sum, turn, rows, columns.

    The sum is -1 where none is above. The candidate with the largest bound is expanded first; the stack holds
    bound, level, turn, rows and columns of each.
    """
    top, count, sums = len(bounds) - 1, 0, np.empty(4, np.int64)
    stack = np.empty((_coarse_candidates(low, high, 1 << top) + 4 * len(bounds), 5), np.int64)
    for k in range(len(cells)):
        for col in range(low[k, 1], high[k, 1] + 1, 1 << top):
            for row in range(low[k, 0], high[k, 0] + 1, 1 << top):
                _sum_bounds(bounds[top], cells[k], row, col, 0, sums)
                if sums[0] > least:
                    _put(stack, count, count, sums[0], (top, k, row, col))
                    count += 1
    stack[:count] = stack[np.argsort(stack[:count, 0])]
    best = (-1, 0, 0, 0)
    while count > 0:
        count -= 1
        total, level, k, row, col = stack[count]
        if total <= least:
            continue
        if level == 0:
            best, least = (total, k, row, col), total
            continue
        half, first = 1 << (level - 1), count
        _sum_bounds(bounds[level - 1], cells[k], row, col, half, sums)
        for j in range(4):
            r, c = row + half * (j & 1), col + half * (j >> 1)
            if sums[j] > least and r <= high[k, 0] and c <= high[k, 1]:
                _put(stack, first, count, sums[j], (level - 1, k, r, c))
                count += 1
    return best


@njit
def _coarse_candidates(low: Any, high: Any, step: int) -> int:
    """Return the number of candidates on the coarsest level."""
    count = 0
    for k in range(len(low)):
        rows, cols = high[k, 0] - low[k, 0] + step, high[k, 1] - low[k, 1] + step
        count += (rows // step) * (cols // step)
    return count


@njit
def _put(stack: Any, first: int, count: int, total: int, candidate: Any) -> None:
    """Insert a candidate into the stack of `count`, ordered by bounds from `first` on."""
    at = count
    while at > first and stack[at - 1, 0] > total:
        for i in range(5):
            stack[at, i] = stack[at - 1, i]
        at -= 1
    stack[at, 0] = total
    for i in range(4):
        stack[at, i + 1] = candidate[i]


@njit
def _sum_bounds(bounds: Any, cells: Any, row: int, col: int, half: int, sums: Any) -> None:
    """Fill the sums (4,) of bounds at cells (2, n) after four shifts.

    They are (row, col), and the same with `half` more rows, more columns, and both.
    """
    # Unsigned: a negative index is beyond the last row or column, too.
    rows, cols, h = np.uintp(bounds.shape[0]), np.uintp(bounds.shape[1]), np.uintp(half)
    near = right = above = far = np.int64(0)
    for i in range(cells.shape[1]):
        r, c = np.uintp(cells[0, i] + row), np.uintp(cells[1, i] + col)
        p, q = r + h, c + h
        if r < rows and p < rows and c < cols and q < cols:
            near += bounds[r, c]
            above += bounds[p, c]
            right += bounds[r, q]
            far += bounds[p, q]
            continue
        if c < cols:
            near += bounds[r, c] if r < rows else 0
            above += bounds[p, c] if p < rows else 0
        if q < cols:
            right += bounds[r, q] if r < rows else 0
            far += bounds[p, q] if p < rows else 0
    sums[0], sums[1], sums[2], sums[3] = near, above, right, far


def pose_constraint(
    a: int, b: int, measured: Pose2, weights: tuple[float, float], *, loop: bool = False
) -> PoseConstraint:
    """Return a constraint of pose b in a's frame, weighted in 1/m and 1/rad."""
    translation, rotation = weights
    information = np.diag((translation**2, translation**2, rotation**2))
    return PoseConstraint(a, b, measured.as_array(), information, loop)


class GraphHessian(NamedTuple):
    """J'J of the pose graph without the first submap: diagonal and other blocks.

    The chain (n - 1, 3, 3) holds the blocks of each node and the next, `cross` (3 n, 3 s) those of nodes and
    submaps.
    """

    submaps: FloatArray
    nodes: FloatArray
    chain: FloatArray
    cross: FloatArray


@dataclass(frozen=True)
class PoseGraphProblem:
    """Least-squares problem over all submaps but the first (3,), and all nodes.

    Constraints lead from submaps (a) to nodes, and from the node before (a). A loop counts linearly from the
    weighted error `huber_scale` on.
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
        cost, weighted = self._weigh_constraints(submaps, nodes)
        B, E = np.empty((len(weighted.a), 3, 3)), np.empty((len(self.to_nodes.a), 3, 3))
        linearize(weighted, submaps, nodes, 1.0, (Hs, gs), (Hn, gn), B)
        linearize(self.to_nodes, nodes, nodes, 1.0, (Hn, gn), (Hn, gn), E)
        chain, cross = np.zeros((max(0, n - 1), 3, 3)), np.zeros((n, 3, s, 3))
        np.add.at(chain, self.to_nodes.a, E)
        # A node is constrained to a submap at most once.
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
        S = block_diag(*H.submaps) + np.diag(damping[:split]) - H.cross.T @ solved[:, :-1]
        step = -solve(S, equations.gradient[:split] - H.cross.T @ solved[:, -1], assume_a="pos")
        return np.concatenate((step, -solved[:, -1] - solved[:, :-1] @ step))

    def _weigh_constraints(self, submaps: FloatArray, nodes: FloatArray) -> tuple[float, PoseConstraints]:
        """Return the cost, and the constraints to submaps with the weights of Huber's loss."""
        by_scan, chain = self.to_submaps, self.to_nodes
        square, by_chain = (
            np.einsum("mi,mij,mj->m", e, t.information, e)
            for t, e in (
                (by_scan, errors(submaps[by_scan.a], nodes[by_scan.b], by_scan.z)),
                (chain, errors(nodes[chain.a], nodes[chain.b], chain.z)),
            )
        )
        a = self.huber_scale
        length = np.sqrt(square)
        far = by_scan.robust & (length > a)
        cost = 0.5 * float(np.where(far, a * (2 * length - a), square).sum() + by_chain.sum())
        weights = np.where(far, a / np.maximum(length, a), 1.0)
        information = by_scan.information * weights[:, None, None]
        return cost, by_scan._replace(information=information, robust=np.zeros(len(by_scan.a), np.bool_))


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
    adjusted = ([Pose2(*pose) for pose in poses.tolist()] for poses in problem.poses(point))
    return next(adjusted), next(adjusted)


class OriginalPoseGraph:
    """Poses of submaps and nodes in the map frame; counts loop searches and optimizations."""

    def __init__(self, config: CartographerOriginalConfig, submaps: list[GridSubmap]) -> None:
        """Use the submaps of local SLAM; the list grows there."""
        self._config, self._submaps = config, submaps
        self.nodes: list[TrajectoryNode] = []
        self.events: list[LoopEvent] = []
        self.loop_searches = self.optimizations = 0
        self._node_poses: list[Pose2] = []
        self._submap_poses: list[Pose2] = []
        self._searchers: dict[int, LoopSearcher] = {}
        self._members: list[set[int]] = []
        self._to_submaps: list[PoseConstraint] = []
        self._chain: list[PoseConstraint] = []
        self._nodes_since = 0
        self._optimized = 0

    @property
    def T_map_local(self) -> Pose2:  # noqa: N802
        """Correction of local SLAM since the last optimization."""
        if not self._optimized:
            return Pose2()
        last = self._optimized - 1
        return self._submap_poses[last] @ self._submaps[last].pose.inverse()

    @property
    def nbytes(self) -> int:
        """Memory of the searched bounds and of the nodes' points."""
        searched = sum(searcher.nbytes for searcher in self._searchers.values())
        return searched + sum(node.points.nbytes for node in self.nodes)

    def add_node(self, node: TrajectoryNode) -> None:
        """Constrain a node to its submaps, search loops, optimize if due."""
        c, index = self._config, len(self.nodes)
        self._add_submaps(node)
        oldest = node.submaps[0]
        self.nodes.append(node)
        self._node_poses.append(self._submap_poses[oldest] @ self._submaps[oldest].pose.inverse() @ node.pose)
        self._constrain(node, index)
        for submap in self._searchers:
            self._search(index, submap)
        if node.finished:
            self._searchers[oldest] = LoopSearcher(self._submaps[oldest].grid, c)
            for earlier in range(index + 1):
                if earlier not in self._members[oldest]:
                    self._search(earlier, oldest)
        self._nodes_since += 1
        if self._nodes_since > c.optimize_every_n_nodes:
            self._submap_poses, self._node_poses = self._adjust([c.max_num_iterations])
            self.optimizations += 1
            self._nodes_since, self._optimized = 0, len(self._submap_poses)

    def final_poses(self) -> list[Pose2]:
        """Return `T_map_base` of all nodes after the last optimization; the graph stays as it is."""
        if not self.nodes:
            return []
        c = self._config
        _, poses = self._adjust([c.max_num_iterations, c.max_num_final_iterations])
        return [pose @ Pose2(yaw=node.heading) for pose, node in zip(poses, self.nodes, strict=True)]

    def _add_submaps(self, node: TrajectoryNode) -> None:
        """Give a new submap its pose relative to the one before."""
        for i in node.submaps[len(self._submap_poses) - node.submaps[0] :]:
            pose = self._submaps[i].pose
            if i:
                pose = self._submap_poses[i - 1] @ self._submaps[i - 1].pose.inverse() @ pose
            self._submap_poses.append(pose)
            self._members.append(set())

    def _constrain(self, node: TrajectoryNode, index: int) -> None:
        """Constrain a node to its submaps, and to the last node by SLAM and odometry."""
        c = self._config
        for i in node.submaps:
            self._members[i].add(index)
            measured = self._submaps[i].pose.inverse() @ node.pose
            weights = c.matcher_translation_weight, c.matcher_rotation_weight
            self._to_submaps.append(pose_constraint(i, index, measured, weights))
        for before, now in pairwise(self.nodes[-2:]):
            if before.odometry is not None and now.odometry is not None:
                moved = before.odometry.inverse() @ now.odometry
                moved = Pose2(yaw=before.heading) @ moved @ Pose2(yaw=-now.heading)
                weights = c.odometry_translation_weight, c.odometry_rotation_weight
                self._chain.append(pose_constraint(index - 1, index, moved, weights))
            weights = c.local_slam_pose_translation_weight, c.local_slam_pose_rotation_weight
            moved = before.pose.inverse() @ now.pose
            self._chain.append(pose_constraint(index - 1, index, moved, weights))

    def _search(self, index: int, submap: int) -> None:
        """Search for a node in a finished submap near it; constrain it if found."""
        c, node, searcher = self._config, self.nodes[index], self._searchers[submap]
        relative = self._submap_poses[submap].inverse() @ self._node_poses[index]
        if relative.distance(Pose2()) > c.max_constraint_distance or not searcher.draw_sample():
            return
        self.loop_searches += 1
        T_local_submap = self._submaps[submap].pose
        found = searcher.search(node.points, T_local_submap @ relative)
        if found is None:
            return
        pose, score = found
        measured = T_local_submap.inverse() @ pose
        weights = c.loop_closure_translation_weight, c.loop_closure_rotation_weight
        self._to_submaps.append(pose_constraint(submap, index, measured, weights, loop=True))
        seen = self.nodes[min(self._members[submap])].stamp
        base = Pose2(yaw=node.heading)
        before, after = self._node_poses[index] @ base, self._submap_poses[submap] @ measured @ base
        self.events.append(LoopEvent(node.stamp, seen, before, after, score))

    def _adjust(self, iterations: list[int]) -> tuple[list[Pose2], list[Pose2]]:
        scale = self._config.huber_scale
        return adjust(self._submap_poses, self._node_poses, self._to_submaps, self._chain, scale, iterations)
