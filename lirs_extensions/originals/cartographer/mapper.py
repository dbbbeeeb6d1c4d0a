"""Planar Cartographer as in Google's program, without IMU.

Hess et al. 2016, as the authors' program has it (cartographer 2D): local SLAM in submaps of probabilities, a
pose graph with constraints between consecutive nodes by odometry and local SLAM, loops without verification.
No attitude, no ground filter: on uneven ground hillsides are walls. It never reports that it is lost.
"""

from __future__ import annotations

import numpy as np

from lirs_extensions.originals.cartographer.config import CartographerOriginalConfig
from lirs_extensions.originals.cartographer.local_slam import TrajectoryBuilder
from lirs_extensions.originals.cartographer.pose_graph import OriginalPoseGraph
from lirs_wct.geometry import Imu, LaserScan, OccupancyGrid, Pose2, Trajectory
from slam_baselines.cartographer.loop_closure import LoopEvent
from slam_baselines.front_end import KeyframeTrajectory
from slam_baselines.leveling import LeveledScan, ScanLeveler
from slam_baselines.mapper import MapperStats, PlanarMapper
from slam_baselines.occupancy_map import OccupancyMap, bounding_box

__all__ = ["CartographerOriginalConfig", "CartographerOriginalMapper"]

WARM_UP = {
    "num_range_data": 20,
    "use_online_correlative_scan_matching": True,
    "optimize_every_n_nodes": 5,
    "min_score": 0.3,
}
"""Configuration with which a short drive reaches every kernel: small submaps, often optimized."""


class CartographerOriginalMapper(PlanarMapper):
    """Local SLAM on submaps and a pose graph, as published by its authors.

    Without odometry the velocity of the last poses predicts the next.
    """

    name = "cartographer_original"

    def __init__(self, config: CartographerOriginalConfig | None = None) -> None:
        super().__init__()
        self.config = c = config or CartographerOriginalConfig()
        self._local = TrajectoryBuilder(c)
        self._graph = OriginalPoseGraph(c, self._local.submaps)
        self._leveler = ScanLeveler(c.missing_data_ray_length, c.max_range)
        self._scans = KeyframeTrajectory()
        self._kept: list[LeveledScan] = []
        self._used = 0

    def process(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        """Match the scan, add a node if due, search loops; return `T_map_base`."""
        pose, matched, node = self._local.add_scan(scan, odometry)
        self._used += matched
        nodes = self._graph.nodes
        if node is not None:
            self._graph.add_node(node)
            self._kept.append(self._leveler.level(scan, None))
        since = nodes[-1].T_local_base.inverse() @ pose if nodes else pose
        self._scans.add(scan.stamp, len(nodes) - 1, since)
        return self._graph.T_map_local @ pose

    def map(self) -> OccupancyGrid:
        """Return the map of all nodes at their final poses (see OccupancyMap)."""
        drawn = OccupancyMap(self.config.resolution)
        for scan, pose in zip(self._kept, self._graph.final_poses(), strict=True):
            placed = scan.transformed(pose, 0.0)
            drawn.update(placed, np.zeros(len(placed.hits), np.uint8), 0, bounding_box(placed))
        return drawn.occupancy_grid(0)

    def trajectory(self) -> Trajectory:
        """Return the pose of every scan: its node's final pose, and local SLAM since then."""
        return self._scans.trajectory(self._graph.final_poses())

    @property
    def loops(self) -> list[LoopEvent]:
        """Loops closed so far."""
        return list(self._graph.events)

    def counts(self) -> MapperStats:
        """Return used and skipped scans, memory and other counts."""
        graph, submaps = self._graph, self._local.submaps
        return MapperStats(
            used=self._used,
            skipped={"no return": self.received - self._used},
            memory=sum(submap.grid.cells.nbytes for submap in submaps) + graph.nbytes,
            counts={
                "nodes": len(graph.nodes),
                "submaps": len(submaps),
                "loops": len(graph.events),
                "loop_searches": graph.loop_searches,
                "optimizations": graph.optimizations,
            },
        )
