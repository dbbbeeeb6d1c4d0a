"""Global SLAM: the pose graph that holds submaps and nodes together, grown and solved a bit at a time.

Hess et al. 2016, section V. Constraints come from local SLAM (a node in the submaps that it entered),
from odometry (from one submap to the next) and from loops. Each update does a bounded share of the
searches and at most one step of an optimisation; its result is taken over when it has converged.
"""

from __future__ import annotations

import numpy as np

from lirs_wct.arrays import FloatArray
from lirs_wct.geometry.pose import Pose2
from slam_baselines.cartographer.config import GlobalConfig
from slam_baselines.cartographer.constraints.builder import Constraint, ConstraintBuilder
from slam_baselines.cartographer.constraints.candidates import LoopQueue
from slam_baselines.cartographer.constraints.loop_event import LoopEvent
from slam_baselines.cartographer.constraints.verification import Confirmation
from slam_baselines.cartographer.local_slam import LocalSlam
from slam_baselines.cartographer.node import NOWHERE, Node, compounded
from slam_baselines.cartographer.optimization import Edges, Problem, Solution, begin, improve
from slam_baselines.cartographer.trimmer import Trimmer
from slam_baselines.common.se2 import in_axes_of, inverted

Row = tuple[int, int, FloatArray, FloatArray, bool]


class GlobalSlam:
    """The graph.

    Attributes:
        nodes: all of them, in the local frame.
        poses: `T_map_base` of each node.
        submap_poses: `T_map_submap` of each submap.
        T_map_local: how the local frame lies in the map at present.
        queue: what is searched for next.
        builder: searches for loops.
        loops: constraints found and believed.
        events: the same for those who want to know.
        trimmed: submaps forgotten.
        optimizations: how often the graph was solved.
        version: changes whenever poses that were there before have changed.
    """

    def __init__(self, config: GlobalConfig, local: LocalSlam) -> None:
        self.config = config
        self.nodes: list[Node] = []
        self.poses: list[Pose2] = []
        self.submap_poses: list[Pose2] = []
        self.T_map_local = Pose2()
        self.builder = ConstraintBuilder(config.constraints)
        self.queue = LoopQueue(config.queue)
        self.loops: list[Constraint] = []
        self.events: list[LoopEvent] = []
        self.optimizations = self.version = self.trimmed = 0
        self._trimmer = Trimmer(config.trimming)
        self._local = local
        self._confirmation = Confirmation(config.confirmation)
        self._to_nodes: list[Row] = []
        self._to_submaps: list[Row] = []
        self._running: tuple[Problem, Solution] | None = None
        self._optimized_at = (0, 0)
        self._loops_begun = self._rows_solved = 0
        self._sampled = 0.0
        self._finished: list[int] = []
        self._since_submap = NOWHERE
        self._ties: dict[int, list[float]] = {}
        t, r = config.matcher_translation_error, config.matcher_rotation_error
        self._matcher_covariance = np.diag((t**2, t**2, r**2))

    def add(self, node: Node) -> None:
        """Tie a new node to the submaps that it entered, and ask for loops."""
        index, submaps = len(self.nodes), self._local.submaps.all
        self.nodes.append(node)
        self.poses.append(self.T_map_local @ node.pose)
        while len(self.submap_poses) < len(submaps):
            self.submap_poses.append(self.T_map_local @ submaps[len(self.submap_poses)].pose)
        information = inverted(self._matcher_covariance + node.covariance)
        for i in node.submaps:
            z = (submaps[i].pose.inverse() @ node.pose).as_array()
            self._to_nodes.append((i, index, z, in_axes_of(submaps[i].pose, information), False))
        self._since_submap = compounded(self._since_submap, node.odometry)
        if node.submaps and submaps[node.submaps[-1]].nodes[0] == index:
            self._tie_submap(node.submaps[-1])
        self._ask(index, node)

    def _tie_submap(self, index: int) -> None:
        """Tie a submap that has just begun to the one before by odometry."""
        odometry, self._since_submap = self._since_submap, NOWHERE
        if index > 0:
            z, information = odometry.pose.as_array(), inverted(odometry.covariance)
            self._to_submaps.append((index - 1, index, z, information, True))

    def work(self) -> None:
        """Do a bounded share of what is to be done."""
        for _ in range(self.config.searches_per_update):
            pair = self.queue.next()
            if pair is not None:
                self._search(*pair)
        if self._running is None and self._optimization_due():
            self._running, self._loops_begun = self._begin(), len(self.loops)
            self._rows_solved = len(self._to_nodes)
        elif self._running is not None:
            problem, solution = self._running
            solution = improve(problem, solution)
            self._running = problem, solution
            if solution.done:
                self._running = None
                self._take(solution)

    def settled(self) -> tuple[list[Pose2], Pose2]:
        """Return the nodes' poses and `T_map_local` after optimising to the end; changes nothing."""
        if self._optimized_at[1] == len(self.loops) and self._running is None:
            return self.poses, self.T_map_local
        problem, solution = self._begin()
        while not solution.done:
            solution = improve(problem, solution)
        poses = [Pose2(*p) for p in solution.nodes.tolist()]
        return poses, poses[-1] @ self.nodes[-1].pose.inverse()

    def _ask(self, index: int, node: Node) -> None:
        """Put pairs of nodes and finished submaps that may see the same place into the queue."""
        submaps = self._local.submaps.all
        self._sampled += self.config.queue.sampling_ratio
        if self._sampled >= 1:
            self._sampled -= 1
            for i in self._finished:
                self._ask_near(index, i, fresh=True)
        first = node.submaps[0]
        if submaps[first].finished:
            self._finished.append(first)
            self._trimmer.finished(first, submaps[first])
            own = set(submaps[first].nodes)
            stride = max(1, round(1 / self.config.queue.sampling_ratio))
            for j in range(0, index, stride):
                if j not in own and not self.nodes[j].bare:
                    self._ask_near(j, first, fresh=False)

    def _ask_near(self, node: int, submap: int, *, fresh: bool) -> None:
        pose, near = self.poses[node], self.config.queue.max_constraint_distance
        members = self._local.submaps.all[submap].nodes
        if min(pose.distance(self.poses[members[k]]) for k in (0, len(members) // 2, -1)) <= near:
            self.queue.ask(node, self.nodes[node].submaps[-1], submap, fresh=fresh)

    def _search(self, index: int, submap_index: int) -> None:
        """Search for a node in a submap; tie them together where it is found."""
        node, submap = self.nodes[index], self._local.submaps.all[submap_index]
        if node.bare or submap_index not in self._finished:
            return
        submap.revalue(self._local.relief.match_bound)
        walls = self._local.walls(node.scan, node.pose, node.height, node.steep) > 0
        expected = submap.pose @ self.submap_poses[submap_index].inverse() @ self.poses[index]
        ties = self._ties.setdefault(submap_index, [self.nodes[i].way for i in submap.nodes])
        way = min(abs(node.way - tie) for tie in ties)
        found = self.builder.search(submap, node.scan.hits[walls], expected, way)
        self.queue.note(index, submap_index, found=found is not None)
        if found is None:
            return
        pose, information, score = found
        T_submap_node = submap.pose.inverse() @ pose
        loop = Constraint(submap_index, index, T_submap_node, in_axes_of(submap.pose, information), score)
        for believed in self._confirmation.admit(loop, node.way, self.submap_poses, self.poses):
            z = believed.T_submap_node.as_array()
            self._to_nodes.append((believed.submap, believed.node, z, believed.information, True))
            self.loops.append(believed)
            self.events.append(self._event(believed))

    def _event(self, loop: Constraint) -> LoopEvent:
        first = self._local.submaps.all[loop.submap].nodes[0]
        stamps = self.nodes[loop.node].scan.stamp, self.nodes[first].scan.stamp
        after = self.submap_poses[loop.submap] @ loop.T_submap_node
        return LoopEvent(*stamps, self.poses[loop.node], after, loop.score)

    def _trim(self) -> None:
        """Forget submaps of places that were seen often enough since, and scans that are in no other."""
        submaps = self._local.submaps.all
        for index in self._trimmer.needless(self.submap_poses):
            self.trimmed += 1
            self._finished.remove(index)
            submaps[index].trim()
            for i in submaps[index].nodes:
                if not any(k in self._finished or not submaps[k].finished for k in self.nodes[i].submaps):
                    self.nodes[i] = self.nodes[i].trimmed()

    def _optimization_due(self) -> bool:
        nodes, loops = self._optimized_at
        return len(self.loops) > loops and len(self.nodes) - nodes >= self.config.optimize_every_n_nodes

    def _begin(self) -> tuple[Problem, Solution]:
        """Pose the problem as it is now."""
        problem = Problem(
            self.config.optimization, Edges.of(self._to_nodes), Edges.of(self._to_submaps), np.zeros(3)
        )
        submaps = np.array([p.as_array() for p in self.submap_poses])
        nodes = np.array([p.as_array() for p in self.poses])
        return problem, begin(problem, submaps, nodes, self._rows_solved)

    def _take(self, solution: Solution) -> None:
        """Take the solution over; what was added since moves along with the last node in it."""
        self.optimizations += 1
        self.version += 1
        loops = self._optimized_at[1]
        self._optimized_at = len(solution.nodes), self._loops_begun
        for loop in self.loops[loops : self._loops_begun]:
            self._ties[loop.submap].append(self.nodes[loop.node].way)
        poses = [Pose2(*p) for p in solution.nodes.tolist()]
        self.T_map_local = poses[-1] @ self.nodes[len(poses) - 1].pose.inverse()
        self.poses = poses + [self.T_map_local @ node.pose for node in self.nodes[len(poses) :]]
        submaps = [Pose2(*p) for p in solution.submaps.tolist()]
        newer = self._local.submaps.all[len(submaps) :]
        self.submap_poses = submaps + [self.T_map_local @ submap.pose for submap in newer]
        if self._trimmer.due():
            self._trim()
