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
from slam_baselines.cartographer.local_slam import LocalSlam, NodeMap
from slam_baselines.cartographer.localization import CartographerLocalizer, KnownMap
from slam_baselines.cartographer.loop_closure import LoopEvent
from slam_baselines.front_end import PlanarMapper
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


class CartographerMapper(PlanarMapper):
    """Local SLAM on submaps; a pose graph corrects their drift at loops.

    Attributes:
        config: its parameters.
        local: local SLAM.
    """

    name = "cartographer"
    requires_odometry = True

    def __init__(self, config: CartographerConfig | None = None) -> None:
        self.config = c = config or CartographerConfig()
        self.local = LocalSlam(c)
        super().__init__(self.local.front.tracking)
        self._graph = GlobalSlam(c.graph, self.local)
        self._map = NodeMap(c.map_resolution, c.update, c.local.ground_filter)

    @property
    def resolution(self) -> float:
        """Edge of a cell of the map, meters."""
        return self.config.map_resolution

    def process(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        """Match the scan to its submap and work on the graph; return `T_map_base`."""
        added = self.local.add_scan(scan, odometry, imu)
        if added.anew:
            self._graph = GlobalSlam(self.config.graph, self.local)
        for node in added.nodes:
            self._graph.add_node(node)
        self._graph.run_work_share()
        return self._graph.T_map_local @ self.local.front.pose

    def map(self) -> OccupancyGrid:
        """Return the map of all nodes at their optimized poses (see LocalizabilityMonitor.draws)."""
        poses, _ = self._graph.optimized_poses()
        return self._map.render(self._graph.nodes, poses, walls=self.local.front.draws_walls)

    def trajectory(self) -> Trajectory:
        """Return the pose of every scan, by stamp."""
        (poses, T_map_local), front = self._graph.optimized_poses(), self.local.front
        return front.scans.trajectory(poses, front.path, None if front.path else T_map_local)

    @property
    def loops(self) -> list[LoopEvent]:
        """Loops closed so far, in the order of acceptance."""
        return list(self._graph.events)

    def counts(self) -> MapperStats:
        """Return used scans, memory and other counts."""
        graph, submaps, front = self._graph, self.local.submaps.all, self.local.front
        counts = graph.builder.counts
        return MapperStats(
            used=front.matched,
            memory=sum(submap.nbytes for submap in submaps)
            + sum(node.nbytes for node in graph.nodes)
            + front.ground_filter.grid.nbytes
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
                "second_looks": front.bootstrap.refinements,
                "searches": self.local.registration.searches,
                "matches_implausible": self.local.implausible,
            },
        )
