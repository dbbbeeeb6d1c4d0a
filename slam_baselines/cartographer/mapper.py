"""Cartographer: local SLAM on submaps, loops by branch and bound, a sparse pose graph.

Hess, Kohler, Rapp, Andor 2016, "Real-time loop closure in 2D LIDAR SLAM", written from the paper.
Beyond it: the odometry is a prior of the registration, and a ground filter separates ground from walls.
"""

from __future__ import annotations

from lirs_wct.geometry import Imu, LaserScan, OccupancyGrid, Pose2, Trajectory
from slam_baselines.cartographer.config import (
    CartographerConfig,
    ConstraintConfig,
    GlobalConfig,
    LocalConfig,
    SubmapConfig,
)
from slam_baselines.cartographer.global_slam import GlobalSlam
from slam_baselines.cartographer.local_slam import LocalSlam
from slam_baselines.cartographer.localization import CartographerLocalizer, KnownMap
from slam_baselines.cartographer.loop_closure import LoopEvent
from slam_baselines.cartographer.node import Node, NodeMap
from slam_baselines.front_end import FrontEndConfig
from slam_baselines.leveling import LeveledScan
from slam_baselines.mapper import Mapper, MapperStats

WARM_UP = {
    "local": LocalConfig(submaps=SubmapConfig(num_range_data=20), sparse_distance=0.1),
    "graph": GlobalConfig(constraints=ConstraintConfig(linear_start=1.0), optimize_every_n_nodes=5),
}
"""Configuration with which a short drive reaches every kernel: small submaps, searched in a wide window."""


def make_cartographer(config: CartographerConfig) -> Mapper:
    """Return a mapper; where a map is given, a localizer in it.

    Raises:
        SourceError: the map's file cannot be used.
        ConfigError: there is no wall in the map.
    """
    c = config
    if c.map is None:
        return CartographerMapper(c)
    return CartographerLocalizer(c, KnownMap.load(c.map))


class CartographerMapper(LocalSlam):
    """Local SLAM on submaps; a pose graph corrects their drift at loops."""

    name = "cartographer"
    requires_odometry = True

    def __init__(self, config: CartographerConfig | None = None) -> None:
        self.config = c = config or CartographerConfig()
        front_end = FrontEndConfig(
            tracking=c.local.tracking, localizability=c.local.localizability, bootstrap=c.bootstrap,
            clear_range=c.clear_range, max_range=c.max_range,
        )  # fmt: skip
        super().__init__(c.local, front_end)
        self._graph = GlobalSlam(c.graph, self)
        self._map = NodeMap(c.map_resolution, c.update, c.local.ground_filter)

    @property
    def resolution(self) -> float:
        """Edge of a cell of the map, meters."""
        return self.config.map_resolution

    def process(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        """Match the scan to its submap and work on the graph; return `T_map_base`."""
        T_local_base = super().process(scan, odometry, imu)
        self._graph.run_work_share()
        return self._graph.T_map_local @ T_local_base

    def insert(self, scan: LeveledScan, pose: Pose2) -> Node:
        """Draw a scan into the submaps, and add its node to the graph."""
        node = super().insert(scan, pose)
        self._graph.add_node(node)
        return node

    def refine(self, keyframes: list[Node]) -> list[Node] | None:
        """Rebuild submaps and graph with the present knowledge of the ground, if possible."""
        refined = super().refine(keyframes)
        if refined is not None:
            self._graph = GlobalSlam(self.config.graph, self)
            for node in refined:
                self._graph.add_node(node)
        return refined

    def map(self) -> OccupancyGrid:
        """Return the map of all nodes at their optimized poses (see LocalizabilityMonitor.draws)."""
        poses, _ = self._graph.optimized_poses()
        return self._map.render(self._graph.nodes, poses, walls=self.draws_walls)

    def trajectory(self) -> Trajectory:
        """Return the pose of every scan, by stamp."""
        poses, T_map_local = self._graph.optimized_poses()
        return self.scans.trajectory(poses, self.path, None if self.path else T_map_local)

    @property
    def loops(self) -> list[LoopEvent]:
        """Loops closed so far, in the order of acceptance."""
        return list(self._graph.events)

    def counts(self) -> MapperStats:
        """Return used scans, memory and other counts."""
        graph, submaps = self._graph, self.submaps.all
        counts = graph.builder.counts
        return MapperStats(
            used=self.matched,
            memory=sum(submap.nbytes for submap in submaps)
            + sum(node.nbytes for node in graph.nodes)
            + self.ground_filter.grid.nbytes
            + graph.trimmer.nbytes
            + self._map.nbytes,
            counts={
                "nodes": len(graph.nodes),
                "submaps": len(submaps),
                "submaps_trimmed": graph.trimmed,
                "loops": len(graph.loops),
                "loop_searches": counts.searched,
                "loop_searches_ambiguous": counts.ambiguous,
                "loop_searches_given_up": counts.given_up,
                "loop_searches_waiting": len(graph.candidates),
                "loop_searches_dropped": graph.candidates.dropped,
                "optimizations": graph.optimizations,
                "second_looks": self.bootstrap.refinements,
                "searches": self.registration.searches,
                "matches_implausible": self.implausible,
            },
        )
