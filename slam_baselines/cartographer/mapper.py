"""Cartographer: local SLAM on submaps, loops by branch and bound, a sparse pose graph.

Hess, Kohler, Rapp, Andor 2016, "Real-time loop closure in 2D LIDAR SLAM", written from the paper.
Beyond it: the odometry is a prior of the registration, and a ground filter separates ground from walls.
"""

from __future__ import annotations

from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.scan import Imu, LaserScan
from lirs_wct.geometry.trajectory import Trajectory
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
from slam_baselines.mapper import Mapper, MapperStats, Stopwatch, required_odometry
from slam_baselines.mapping.bootstrap import Bootstrap
from slam_baselines.mapping.keyframe import KeyframeTrajectory

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


class CartographerMapper:
    """Local SLAM on submaps; a pose graph corrects their drift at loops."""

    requires_odometry = True

    def __init__(self, config: CartographerConfig | None = None) -> None:
        self.config = c = config or CartographerConfig()
        self._local = LocalSlam(c.local, c.clear_range, c.max_range)
        self._graph = GlobalSlam(c.graph, self._local)
        self._map = NodeMap(c.map_resolution, c.update, c.local.ground_filter)
        self._scans = KeyframeTrajectory()
        self._bootstrap: Bootstrap[Node] = Bootstrap(c.bootstrap)
        self._stopwatch = Stopwatch()

    @property
    def resolution(self) -> float:
        """Edge of a cell of the map, meters."""
        return self.config.map_resolution

    def update(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        """Match the scan to its submap and work on the graph; return `T_map_base`.

        Raises:
            ConfigError: there is no odometry.
        """
        odometry = required_odometry("cartographer", odometry, scan.stamp)
        started = self._stopwatch.start()
        node = self._local.add_range_data(scan, odometry, imu)
        if node is not None:
            self._graph.add_node(node)
            if self._bootstrap.add(node, node.distance_traveled) and self._local.localizability.believed:
                self._refine_start()
        nodes, pose = self._graph.nodes, self._local.estimate.pose
        self._scans.add(scan.stamp, len(nodes) - 1, nodes[-1].pose.inverse() @ pose if nodes else pose)
        self._graph.run_work_share()
        self._stopwatch.stop(started)
        return self._graph.T_map_local @ self._local.estimate.pose

    def _refine_start(self) -> None:
        """Rebuild submaps and graph with the present knowledge of the ground, while no submap is finished."""
        local = self._local
        if local.ground_filter.match_wall_slope == 0 or local.submaps.all[0].finished:
            self._bootstrap.close()
            return
        self._bootstrap.replace(local.refine(self._bootstrap.keyframes))
        self._graph = GlobalSlam(self.config.graph, local)
        for node in self._bootstrap.keyframes:
            self._graph.add_node(node)

    def map(self) -> OccupancyGrid:
        """Return the map of all nodes at their optimized poses (see LocalizabilityMonitor.draws)."""
        poses, _ = self._graph.optimized_poses()
        draws = self._local.localizability.draws(self._local.ground_filter.distance_traveled)
        return self._map.render(self._graph.nodes, poses, walls=draws)

    def trajectory(self) -> Trajectory:
        """Return the pose of every scan, by stamp."""
        poses, T_map_local = self._graph.optimized_poses()
        measured = [node.pose for node in self._graph.nodes]
        return self._scans.trajectory(poses, measured, None if measured else T_map_local)

    @property
    def loops(self) -> list[LoopEvent]:
        """Loops closed so far, in the order of acceptance."""
        return list(self._graph.events)

    @property
    def lost(self) -> bool:
        """Whether too many scans in a row contradict the map."""
        return self._local.lost

    @property
    def stats(self) -> MapperStats:
        """Counts, times and memory so far."""
        local, graph = self._local, self._graph
        counts = graph.builder.counts
        return MapperStats(
            received=local.received,
            used=local.matched,
            lost=local.lost_scans,
            memory=sum(submap.nbytes for submap in local.submaps.all)
            + sum(node.nbytes for node in graph.nodes)
            + local.ground_filter.grid.nbytes
            + graph.trimmer.nbytes
            + self._map.nbytes,
            counts={
                "nodes": len(graph.nodes),
                "submaps": len(local.submaps.all),
                "submaps_trimmed": graph.trimmed,
                "loops": len(graph.loops),
                "loop_searches": counts.searched,
                "loop_searches_ambiguous": counts.ambiguous,
                "loop_searches_given_up": counts.given_up,
                "loop_searches_waiting": len(graph.candidates),
                "loop_searches_dropped": graph.candidates.dropped,
                "optimizations": graph.optimizations,
                "second_looks": self._bootstrap.refinements,
                "searches": local.registration.searches,
                "matches_implausible": local.implausible,
            },
            **self._stopwatch.summary(),
        )
