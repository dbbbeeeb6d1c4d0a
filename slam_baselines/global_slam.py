"""Global SLAM: the pose graph that holds submaps and nodes together, grown and solved a bit at a time.

Hess et al. 2016, section V. Constraints come from local SLAM (a node in the submaps that it entered),
from odometry (from one submap to the next) and from loops. Each update does a bounded share of the
searches and at most one step of an optimisation; its result is taken over when it has converged.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lirs_wct.errors import ConfigError
from lirs_wct.pose import Pose2
from slam_baselines.constraint import ConstraintBuilder, ConstraintConfig, seen_from
from slam_baselines.local_slam import LocalSlam, Node
from slam_baselines.odometry import Estimate
from slam_baselines.pose_graph import Edges, OptimizationConfig, Problem, Solution, begin, improve

Array = NDArray[np.float64]
Row = tuple[int, int, Array, Array, bool]


@dataclass(frozen=True, kw_only=True)
class GlobalConfig:
    """Parameters of global SLAM; names as in Cartographer's pose_graph.

    Attributes:
        constraints: searches for loops.
        optimization: of the graph.
        optimize_every_n_nodes: the graph is solved after so many new nodes, if there are new loops.
        searches_per_update: at most so many searches in one update.
        matcher_translation_error: standard deviation of a node's place in a submap that it entered, metres.
        matcher_rotation_error: likewise of its yaw, radians.

    Raises:
        ConfigError: a value that is not above 0.
    """

    constraints: ConstraintConfig = field(default_factory=ConstraintConfig)
    optimization: OptimizationConfig = field(default_factory=OptimizationConfig)
    optimize_every_n_nodes: int = 20
    searches_per_update: int = 1
    matcher_translation_error: float = 0.02
    matcher_rotation_error: float = math.radians(0.2)

    def __post_init__(self) -> None:
        if min(self.optimize_every_n_nodes, self.searches_per_update) < 1:
            raise ConfigError("optimize_every_n_nodes and searches_per_update must be at least 1")
        if not (self.matcher_translation_error > 0 and self.matcher_rotation_error > 0):
            raise ConfigError("matcher_translation_error and matcher_rotation_error must be above 0")


class GlobalSlam:
    """The graph.

    Attributes:
        nodes: all of them, in the local frame.
        poses: `T_map_base` of each node.
        submap_poses: `T_map_submap` of each submap.
        T_map_local: how the local frame lies in the map at present.
        builder: searches for loops.
        loops: constraints found, as (node, submap).
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
        self.loops: list[tuple[int, int]] = []
        self.optimizations = self.version = 0
        self._local = local
        self._to_nodes: list[Row] = []
        self._to_submaps: list[Row] = []
        self._running: tuple[Problem, Solution] | None = None
        self._optimized_at = (0, 0)
        self._sampled = 0.0
        self._finished: list[int] = []
        t, r = config.matcher_translation_error, config.matcher_rotation_error
        self._matcher_information = np.diag((t**-2, t**-2, r**-2))

    def add(self, node: Node, odometry: Estimate | None) -> None:
        """Tie a new node to the submaps that it entered, and ask for loops.

        Args:
            node: as local SLAM made it.
            odometry: `T_before_now` by dead reckoning from the first node of the submap before, where the node
                began a submap that is not the first one.
        """
        index, submaps = len(self.nodes), self._local.submaps.all
        self.nodes.append(node)
        self.poses.append(self.T_map_local @ node.pose)
        while len(self.submap_poses) < len(submaps):
            self.submap_poses.append(self.T_map_local @ submaps[len(self.submap_poses)].pose)
        for i in node.submaps:
            T_submap_node = submaps[i].pose.inverse() @ node.pose
            self._to_nodes.append((i, index, T_submap_node.as_array(), self._matcher_information, False))
        if odometry is not None:
            z, information = odometry.pose.as_array(), np.linalg.inv(odometry.covariance)
            self._to_submaps.append((len(submaps) - 2, len(submaps) - 1, z, information, True))
        self._ask(index, node)

    def work(self) -> None:
        """Do a bounded share of what is to be done."""
        for _ in range(min(self.config.searches_per_update, len(self.builder))):
            self._search(*self.builder.next())
        if self._running is None and self._optimization_due():
            self._running = self._begin()
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
        self._sampled += self.config.constraints.sampling_ratio
        if self._sampled >= 1:
            self._sampled -= 1
            for i in self._finished:
                self._ask_near(index, i)
        first = node.submaps[0]
        if submaps[first].finished:
            self._finished.append(first)
            own = set(submaps[first].nodes)
            stride = max(1, round(1 / self.config.constraints.sampling_ratio))
            for j in range(0, index, stride):
                if j not in own:
                    self._ask_near(j, first)

    def _ask_near(self, node: int, submap: int) -> None:
        pose, near = self.poses[node], self.config.constraints.max_constraint_distance
        members = self._local.submaps.all[submap].nodes
        if min(pose.distance(self.poses[members[k]]) for k in (0, len(members) // 2, -1)) <= near:
            self.builder.ask(node, submap)

    def _search(self, index: int, submap_index: int) -> None:
        """Search for a node in a submap; tie them together where it is found."""
        node, submap = self.nodes[index], self._local.submaps.all[submap_index]
        submap.revalue(self._local.relief.match_bound)
        walls = self._local.walls(node.scan, node.pose, node.height, node.steep) > 0
        expected = submap.pose @ self.submap_poses[submap_index].inverse() @ self.poses[index]
        found = self.builder.search(submap, node.scan.hits[walls], expected)
        if found is None:
            return
        pose, information, _ = found
        z = (submap.pose.inverse() @ pose).as_array()
        self._to_nodes.append((submap_index, index, z, seen_from(submap.pose, information), True))
        self.loops.append((index, submap_index))

    def _optimization_due(self) -> bool:
        nodes, loops = self._optimized_at
        return len(self.loops) > loops and len(self.nodes) - nodes >= self.config.optimize_every_n_nodes

    def _begin(self) -> tuple[Problem, Solution]:
        problem = Problem(
            self.config.optimization, Edges.of(self._to_nodes), Edges.of(self._to_submaps), np.zeros(3)
        )
        submaps = np.array([p.as_array() for p in self.submap_poses])
        nodes = np.array([p.as_array() for p in self.poses])
        return problem, begin(problem, submaps, nodes)

    def _take(self, solution: Solution) -> None:
        """Take the solution over; what was added since moves along with the last node in it."""
        self.optimizations += 1
        self.version += 1
        self._optimized_at = len(solution.nodes), len(self.loops)
        poses = [Pose2(*p) for p in solution.nodes.tolist()]
        self.T_map_local = poses[-1] @ self.nodes[len(poses) - 1].pose.inverse()
        self.poses = poses + [self.T_map_local @ node.pose for node in self.nodes[len(poses) :]]
        submaps = [Pose2(*p) for p in solution.submaps.tolist()]
        newer = self._local.submaps.all[len(submaps) :]
        self.submap_poses = submaps + [self.T_map_local @ submap.pose for submap in newer]
