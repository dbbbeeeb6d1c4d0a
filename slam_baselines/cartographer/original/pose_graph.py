"""Pose graph of the original: nodes tied to submaps and to the next node, loops.

As in the original's pose_graph_2d, work that its threads do later is done at once here, in the same order.
"""

from __future__ import annotations

from itertools import pairwise

from lirs_wct.geometry import Pose2
from slam_baselines.cartographer.loop_closure import LoopEvent
from slam_baselines.cartographer.original.config import PoseGraphConfig
from slam_baselines.cartographer.original.local_slam import GridSubmap, TrajectoryNode
from slam_baselines.cartographer.original.loop_search import LoopSearcher
from slam_baselines.cartographer.original.optimization import adjust, pose_tie
from slam_baselines.cartographer.pose_graph import PoseConstraint


class OriginalPoseGraph:
    """Poses of submaps and nodes in the map frame.

    Attributes:
        nodes: all of them, in the local frame.
        events: loops closed so far.
        loop_searches: number of them.
        optimizations: number of them.
    """

    def __init__(self, config: PoseGraphConfig, submaps: list[GridSubmap]) -> None:
        """Use the submaps of local SLAM; the list grows there."""
        self._config, self._submaps = config, submaps
        self.nodes: list[TrajectoryNode] = []
        self.events: list[LoopEvent] = []
        self.loop_searches = self.optimizations = 0
        self._node_poses: list[Pose2] = []
        self._submap_poses: list[Pose2] = []
        self._searchers: dict[int, LoopSearcher] = {}
        self._members: list[set[int]] = []
        self._ties: list[PoseConstraint] = []
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
        """Tie a node to its submaps, search loops, optimize if due."""
        c, index = self._config, len(self.nodes)
        self._add_submaps(node)
        oldest = node.submaps[0]
        self.nodes.append(node)
        self._node_poses.append(self._submap_poses[oldest] @ self._submaps[oldest].pose.inverse() @ node.pose)
        self._tie(node, index)
        for submap in self._searchers:
            self._search(index, submap)
        if node.finished:
            builder = c.constraint_builder
            self._searchers[oldest] = LoopSearcher(self._submaps[oldest].grid, builder)
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

    def _tie(self, node: TrajectoryNode, index: int) -> None:
        """Tie a node to its submaps, and to the last node by local SLAM and odometry."""
        c = self._config
        for i in node.submaps:
            self._members[i].add(index)
            measured = self._submaps[i].pose.inverse() @ node.pose
            weights = c.matcher_translation_weight, c.matcher_rotation_weight
            self._ties.append(pose_tie(i, index, measured, weights))
        for before, now in pairwise(self.nodes[-2:]):
            if before.odometry is not None and now.odometry is not None:
                moved = before.odometry.inverse() @ now.odometry
                moved = Pose2(yaw=before.heading) @ moved @ Pose2(yaw=-now.heading)
                weights = c.odometry_translation_weight, c.odometry_rotation_weight
                self._chain.append(pose_tie(index - 1, index, moved, weights))
            weights = c.local_slam_pose_translation_weight, c.local_slam_pose_rotation_weight
            moved = before.pose.inverse() @ now.pose
            self._chain.append(pose_tie(index - 1, index, moved, weights))

    def _search(self, index: int, submap: int) -> None:
        """Search for a node in a finished submap if it is near; tie it if found."""
        builder, node, searcher = self._config.constraint_builder, self.nodes[index], self._searchers[submap]
        relative = self._submap_poses[submap].inverse() @ self._node_poses[index]
        if relative.distance(Pose2()) > builder.max_constraint_distance or not searcher.draw_sample():
            return
        self.loop_searches += 1
        T_local_submap = self._submaps[submap].pose
        found = searcher.search(node.points, T_local_submap @ relative)
        if found is None:
            return
        measured = T_local_submap.inverse() @ found.pose
        weights = builder.loop_closure_translation_weight, builder.loop_closure_rotation_weight
        self._ties.append(pose_tie(submap, index, measured, weights, loop=True))
        seen = self.nodes[min(self._members[submap])].stamp
        base = Pose2(yaw=node.heading)
        before, after = self._node_poses[index] @ base, self._submap_poses[submap] @ measured @ base
        self.events.append(LoopEvent(node.stamp, seen, before, after, found.score))

    def _adjust(self, iterations: list[int]) -> tuple[list[Pose2], list[Pose2]]:
        return adjust(
            self._submap_poses,
            self._node_poses,
            self._ties,
            self._chain,
            self._config.huber_scale,
            iterations,
        )
