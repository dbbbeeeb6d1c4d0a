"""Global SLAM: pose graph of submaps and nodes, optimized in small steps.

Hess et al. 2016, section V. Constraints come from local SLAM (a node in the submaps that it entered),
from odometry (from one submap to the next) and from loops. Each update does a bounded share of the
searches and at most one step of an optimization; its result is applied when it has converged.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from copy import copy, deepcopy
from dataclasses import dataclass

import numpy as np

from lirs_wct.geometry import ByteArray, FloatArray, IntArray, Pose2, in_axes_of
from slam_baselines.cartographer.config import CartographerConfig
from slam_baselines.cartographer.local_slam import NOWHERE, LocalSlam, Node, compose_estimates
from slam_baselines.cartographer.loop_closure import (
    CandidateQueue,
    ConstraintBuilder,
    LoopConstraint,
    LoopEvent,
    LoopVerification,
)
from slam_baselines.cartographer.pose_graph import (
    OptimizationProblem,
    PoseConstraint,
    PoseConstraints,
    Solution,
    iterate,
    optimize,
    start_optimization,
)
from slam_baselines.cartographer.submap import Submap


@dataclass(frozen=True, slots=True)
class _Covered:
    """Squares that a submap covers, in its own frame: bits of rows, packed.

    The corner (2,) is column and row of the first square.
    """

    bits: ByteArray
    cols: int
    corner: IntArray

    @staticmethod
    def by(points: FloatArray, square: float) -> _Covered:
        """Return the squares, of edge `square`, that (n, 2) points lie in."""
        cells = np.floor(points / square).astype(np.int64)
        corner = cells.min(axis=0, initial=0)
        cols, rows = (cells.max(axis=0, initial=0) - corner + 1).tolist()
        mask = np.zeros((rows, cols), np.bool_)
        mask[cells[:, 1] - corner[1], cells[:, 0] - corner[0]] = True
        return _Covered(np.packbits(mask, axis=1), cols, corner)

    def centers(self, square: float) -> FloatArray:
        """Return (n, 2) centers of the squares."""
        mask = np.unpackbits(self.bits, axis=1, count=self.cols)
        cells = np.argwhere(mask)[:, ::-1] + self.corner
        return np.asarray((cells + 0.5) * square, dtype=np.float64)

    def corners(self, square: float) -> FloatArray:
        """Return (4, 2) corners of the box around all squares."""
        (x0, y0), (rows, cols) = self.corner, (len(self.bits), self.cols)
        box = ((x0, y0), (x0 + cols, y0), (x0, y0 + rows), (x0 + cols, y0 + rows))
        return np.asarray(box, dtype=np.float64) * square


class Trimmer:
    """Area that each finished submap covers, in the submap's own frame."""

    def __init__(self, config: CartographerConfig) -> None:
        self._config = config
        self._square = config.trimming_cell / 2
        self._covered: dict[int, _Covered] = {}
        self._trimmed_at = 0
        self._finished = 0

    @property
    def nbytes(self) -> int:
        """Memory of the areas."""
        return sum(covered.bits.nbytes for covered in self._covered.values())

    def add_finished_submap(self, index: int, submap: Submap) -> None:
        """Record the area of a finished submap."""
        self._finished += 1
        self._covered[index] = _Covered.by(submap.pose.inverse().apply(submap.known_points), self._square)

    def trimming_due(self) -> bool:
        """Whether there are enough new submaps to trim again."""
        return self._finished - self._trimmed_at >= self._config.min_added_submaps_count

    def pop_redundant(self, poses: Sequence[Pose2]) -> list[int]:
        """Return the redundant finished submaps by all `T_map_submap`, and drop their areas."""
        c, self._trimmed_at = self._config, self._finished
        corners = [poses[i].apply(covered.corners(self._square)) for i, covered in self._covered.items()]
        low, high = (np.floor(f(np.concatenate(corners), axis=0) / c.trimming_cell) for f in (np.min, np.max))
        count = np.zeros((high - low).astype(np.int64)[::-1] + 1, np.int16)
        redundant = []
        for index in sorted(self._covered, reverse=True):
            points = poses[index].apply(self._covered[index].centers(self._square))
            cells = (np.floor(points / c.trimming_cell) - low).astype(np.int64)
            mine = np.zeros(count.shape, np.bool_)
            mine[cells[:, 1], cells[:, 0]] = True
            fresh = np.count_nonzero(mine & (count < c.fresh_submaps_count))
            if fresh * c.trimming_cell**2 < c.min_covered_area:
                redundant.append(index)
                del self._covered[index]
            else:
                count += mine
        return redundant


class GlobalSlam:
    """Pose graph.

    Attributes:
        nodes: Nodes in the local frame.
        poses: `T_map_base` of each node.
        submap_poses: `T_map_submap` of each submap.
        T_map_local: Pose of the local frame in the map at present.
        loops: Constraints found and accepted.
        events: Closed loops, for users.
        trimmed: Number of submaps trimmed.
        optimizations: Number of optimizations applied.
        looped: Index of the first node of the earliest submap in a loop that was optimized.
    """

    def __init__(self, config: CartographerConfig, local: LocalSlam) -> None:
        self.config = config
        self.nodes: list[Node] = []
        self.poses: list[Pose2] = []
        self.submap_poses: list[Pose2] = []
        self.T_map_local = Pose2()
        self.builder = ConstraintBuilder(config)
        self.candidates = CandidateQueue(config)
        self.loops: list[LoopConstraint] = []
        self.events: list[LoopEvent] = []
        self.optimizations = self.trimmed = 0
        self.looped = sys.maxsize
        self.trimmer = Trimmer(config)
        self._local = local
        self._verification = LoopVerification(config)
        self._to_nodes: list[PoseConstraint] = []
        self._to_submaps: list[PoseConstraint] = []
        self._running: tuple[OptimizationProblem, Solution] | None = None
        self._optimized_at = (0, 0)
        self._loops_at_start = self._rows_optimized = 0
        self._sampled = 0.0
        self._drift: list[float] = []
        self._finished: list[int] = []
        self._ended: tuple[tuple[int, int, int, bool], list[Pose2], Pose2] | None = None
        self._since_submap = NOWHERE
        self._constrained_at: dict[int, list[float]] = {}
        t, r = config.matcher_translation_error, config.matcher_rotation_error
        self._matcher_covariance = np.diag((t**2, t**2, r**2))
        t, r = config.drift_translation, config.drift_rotation
        self._drift_covariance = np.diag((t**2, t**2, r**2))

    def add_node(self, node: Node) -> None:
        """Add a node, its constraints to the submaps that it entered, and its loop candidates."""
        index, submaps = len(self.nodes), self._local.submaps.all
        self.nodes.append(node)
        self.poses.append(self.T_map_local @ node.pose)
        while len(self.submap_poses) < len(submaps):
            self.submap_poses.append(self.T_map_local @ submaps[len(self.submap_poses)].pose)
        step = node.distance_traveled - self.nodes[index - 1].distance_traveled if index > 0 else 0.0
        self._drift.append((self._drift[-1] if index > 0 else 0.0) + step**3)
        for i in node.submaps:
            drift = self._drift_covariance * (self._drift[index] - self._drift[submaps[i].nodes[0]])
            covariance = self._matcher_covariance + drift + node.covariance
            information = np.asarray(np.linalg.inv(covariance), np.float64)
            z = (submaps[i].pose.inverse() @ node.pose).as_array()
            in_submap = in_axes_of(submaps[i].pose, information)
            self._to_nodes.append(PoseConstraint(i, index, z, in_submap, robust=False))
        self._since_submap = compose_estimates(self._since_submap, node.motion)
        if node.submaps and submaps[node.submaps[-1]].nodes[0] == index:
            # The newest submap has just begun: odometry ties it to the one before.
            odometry, self._since_submap = self._since_submap, NOWHERE
            submap, z = node.submaps[-1], odometry.pose.as_array()
            if submap > 0:
                known = np.asarray(np.linalg.inv(odometry.covariance), np.float64)
                self._to_submaps.append(PoseConstraint(submap - 1, submap, z, known, robust=True))
        if node.localizable:
            self._add_candidates(index, node)

    def run_work_share(self) -> None:
        """Do a bounded share of the loop searches and of the optimization."""
        for _ in range(self.config.searches_per_update):
            candidate = self.candidates.next_candidate()
            if candidate is not None:
                self._search_loop(*candidate)
        nodes, loops = self._optimized_at
        enough = len(self.nodes) - nodes >= self.config.optimize_every_n_nodes
        if self._running is None and enough and len(self.loops) > loops:
            self._running, self._loops_at_start = self._start_optimization(), len(self.loops)
            self._rows_optimized = len(self._to_nodes)
        elif self._running is not None:
            problem, solution = self._running
            solution = iterate(problem, solution)
            self._running = problem, solution
            if solution.converged:
                self._running = None
                self._apply_solution(solution)
                if self.trimmer.trimming_due():
                    self._trim_submaps()

    def optimized_poses(self) -> tuple[list[Pose2], Pose2]:
        """Return the nodes' poses and `T_map_local` as if the drive ended here.

        These are the poses after all waiting searches and an optimization to convergence. The graph itself
        stays.
        """
        state = len(self.nodes), self.builder.counts.searched, self.optimizations, self._running is None
        if self._ended is None or self._ended[0] != state:
            end = self._copy()
            end._finish()
            self._ended = state, end.poses, end.T_map_local
        return self._ended[1], self._ended[2]

    def _copy(self) -> GlobalSlam:
        """Return an independent graph over the same nodes and submaps."""
        same = copy(self)
        same.nodes, same.loops, same.events = self.nodes.copy(), self.loops.copy(), self.events.copy()
        same._to_nodes, same._finished = self._to_nodes.copy(), self._finished.copy()
        same._constrained_at = {submap: at.copy() for submap, at in self._constrained_at.items()}
        same.builder, same.candidates = deepcopy(self.builder), deepcopy(self.candidates)
        same._verification = deepcopy(self._verification)
        return same

    def _finish(self) -> None:
        """Do all waiting searches; optimize after each share that found loops."""
        while True:
            for _ in range(self.config.optimize_every_n_nodes):
                candidate = self.candidates.next_candidate()
                if candidate is None:
                    break
                self._search_loop(*candidate)
            if self._optimized_at[1] < len(self.loops) or self._running is not None:
                self._running, self._loops_at_start = None, len(self.loops)
                self._apply_solution(optimize(*self._start_optimization()))
                self._rows_optimized = len(self._to_nodes)
            if candidate is None:
                break

    def _add_candidates(self, index: int, node: Node) -> None:
        """Queue pairs of nodes and finished submaps that may see the same place."""
        submaps = self._local.submaps.all
        self._sampled += self._samples(index)
        if self._sampled >= 1:
            self._sampled -= 1
            for i in self._finished:
                self._add_candidate_if_near(index, i, new_node=True)
        first = node.submaps[0]
        if submaps[first].finished:
            self._finished.append(first)
            self.trimmer.add_finished_submap(first, submaps[first])
            own = set(submaps[first].nodes)
            samples = 1.0 - self._samples(0)
            for j in range(index):
                samples += self._samples(j)
                if samples < 1:
                    continue
                samples -= 1
                if j not in own and not self.nodes[j].trimmed:
                    self._add_candidate_if_near(j, first, new_node=False)

    def _samples(self, node: int) -> float:
        """Return the sampling rate of loop searches at a node, up to 1."""
        c, before = self.config, self.nodes[max(0, node - 1)]
        step = self.nodes[node].distance_traveled - before.distance_traveled
        return max(c.sampling_ratio, min(1.0, step / c.sampling_distance))

    def _add_candidate_if_near(self, node: int, submap: int, *, new_node: bool) -> None:
        pose, near = self.poses[node], self.config.max_constraint_distance
        members = self._local.submaps.all[submap].nodes
        if min(pose.distance(self.poses[members[k]]) for k in (0, len(members) // 2, -1)) <= near:
            self.candidates.add_candidate(node, self.nodes[node].submaps[-1], submap, new_node=new_node)

    def _search_loop(self, index: int, submap_index: int) -> None:
        """Search for a node in a submap; add the constraint if it is verified."""
        node, submap = self.nodes[index], self._local.submaps.all[submap_index]
        if node.trimmed or submap_index not in self._finished:
            return
        ground, known = self._local.ground_filter, node.min_slopes
        walls = ground.match_walls(node.scan, node.pose, node.height, known=known) > 0
        submap.set_wall_slope(ground.match_wall_slope)
        expected = submap.pose @ self.submap_poses[submap_index].inverse() @ self.poses[index]
        match = self.builder.compute_constraint(
            submap, node.scan.hits[walls], expected, self._traveled_between(node, submap_index)
        )
        self._local.submaps.note_search(submap_index)
        self.candidates.record_result(index, submap_index, found=match is not None)
        if match is None:
            return
        T_submap_node = submap.pose.inverse() @ match.pose
        information = in_axes_of(submap.pose, match.information)
        loop = LoopConstraint(submap_index, index, T_submap_node, information, match.score)
        for accepted in self._verification.verify_loop(
            loop, node.distance_traveled, self.submap_poses, self.poses
        ):
            z = accepted.T_submap_node.as_array()
            self._to_nodes.append(
                PoseConstraint(accepted.submap, accepted.node, z, accepted.information, robust=True)
            )
            self.loops.append(accepted)
            self.events.append(self._loop_event(accepted))

    def _traveled_between(self, node: Node, submap: int) -> float:
        """Return the distance traveled from a node to the nearest one constrained to a submap."""
        members = self._local.submaps.all[submap].nodes
        known = self._constrained_at.setdefault(submap, [self.nodes[i].distance_traveled for i in members])
        return min(abs(node.distance_traveled - distance_traveled) for distance_traveled in known)

    def _loop_event(self, loop: LoopConstraint) -> LoopEvent:
        first = self._local.submaps.all[loop.submap].nodes[0]
        stamps = self.nodes[loop.node].scan.stamp, self.nodes[first].scan.stamp
        after = self.submap_poses[loop.submap] @ loop.T_submap_node
        return LoopEvent(*stamps, self.poses[loop.node], after, loop.score)

    def _trim_submaps(self) -> None:
        """Drop the grids of redundant submaps, and the points of scans in no other submap."""
        submaps = self._local.submaps.all
        for index in self.trimmer.pop_redundant(self.submap_poses):
            self.trimmed += 1
            self._finished.remove(index)
            submaps[index].drop_grids()
            for i in submaps[index].nodes:
                if not any(k in self._finished or not submaps[k].finished for k in self.nodes[i].submaps):
                    self.nodes[i] = self.nodes[i].without_points()

    def _start_optimization(self) -> tuple[OptimizationProblem, Solution]:
        """Return the problem of the present graph, and its start."""
        problem = OptimizationProblem(
            self.config,
            PoseConstraints.stack(self._to_nodes),
            PoseConstraints.stack(self._to_submaps),
            np.zeros(3),
        )
        submaps = np.array([p.as_array() for p in self.submap_poses])
        nodes = np.array([p.as_array() for p in self.poses])
        return problem, start_optimization(problem, submaps, nodes, self._rows_optimized)

    def _apply_solution(self, solution: Solution) -> None:
        """Take the poses of a solution; later nodes and submaps follow its last node."""
        self.optimizations += 1
        loops = self._optimized_at[1]
        self._optimized_at = len(solution.nodes), self._loops_at_start
        for loop in self.loops[loops : self._loops_at_start]:
            self._constrained_at[loop.submap].append(self.nodes[loop.node].distance_traveled)
            self.looped = min(self.looped, self._local.submaps.all[loop.submap].nodes[0])
        poses = [Pose2(*p) for p in solution.nodes.tolist()]
        self.T_map_local = poses[-1] @ self.nodes[len(poses) - 1].pose.inverse()
        self.poses = poses + [self.T_map_local @ node.pose for node in self.nodes[len(poses) :]]
        submaps = [Pose2(*p) for p in solution.submaps.tolist()]
        newer = self._local.submaps.all[len(submaps) :]
        self.submap_poses = submaps + [self.T_map_local @ submap.pose for submap in newer]
