"""Cartographer: local SLAM on submaps, loops by branch and bound, a sparse pose graph.

Hess, Kohler, Rapp, Andor 2016, "Real-time loop closure in 2D LIDAR SLAM", written from the paper.
Beyond it: the odometry is a prior of the registration, and a ground filter separates ground from walls.
"""

from __future__ import annotations

from collections.abc import Sequence

from lirs_wct.geometry import Imu, LaserScan, OccupancyGrid, Pose2, Trajectory, in_axes_of
from slam_baselines.cartographer.config import CartographerConfig
from slam_baselines.cartographer.global_slam import GlobalSlam
from slam_baselines.cartographer.local_slam import LocalSlam, Node
from slam_baselines.cartographer.localization import CartographerLocalizer, KnownMap
from slam_baselines.cartographer.loop_closure import LoopEvent
from slam_baselines.ground_filter import GroundFilter
from slam_baselines.mapper import Mapper, MapperStats, PlanarMapper
from slam_baselines.occupancy_map import NO_WALL, OccupancyMap, bounding_box

WARM_UP = {
    "num_range_data": 20,
    "sparse_distance": 0.1,
    "loop_linear_start": 1.0,
    "optimize_every_n_nodes": 5,
}
"""Configuration with which a short drive reaches every kernel: small submaps, searched in a wide window."""
MAX_KEPT_BYTES = 64_000_000
"""Memory up to which a drawing is kept for the next time."""


def make_cartographer(config: CartographerConfig) -> Mapper:
    """Return a mapper; where a map is given, a localizer in it."""
    c = config
    if c.map is None:
        return CartographerMapper(c)
    return CartographerLocalizer(c, KnownMap.load(c.map))


class CartographerMapper(PlanarMapper):
    """Local SLAM on submaps; a pose graph corrects their drift at loops."""

    name = "cartographer"
    requires_odometry = True

    def __init__(self, config: CartographerConfig | None = None) -> None:
        super().__init__()
        self.config = c = config or CartographerConfig()
        self.local = LocalSlam(c)
        self._graph = GlobalSlam(c, self.local)
        self._map = NodeMap(c)

    def process(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        """Match the scan to its submap and work on the graph; return `T_map_base`."""
        nodes, restarted = self.local.add_scan(scan, odometry, imu)
        self.lost = self.local.front.monitors.tracking.lost
        if restarted:
            self._graph = GlobalSlam(self.config, self.local)
        for node in nodes:
            self._graph.add_node(node)
        self._graph.run_work_share()
        front, T_map_local = self.local.front, self._graph.T_map_local
        if front.path:
            front.drift.first = min(self.local.submaps.matching_submap.nodes[0], self._graph.looped)
        self.covariance = in_axes_of(T_map_local.inverse(), front.drift.covariance)
        return T_map_local @ front.estimate.pose

    def map(self) -> OccupancyGrid:
        """Return the map of all nodes at their optimized poses (see LocalizabilityMonitor.draws)."""
        poses, _ = self._graph.optimized_poses()
        walls = self.local.front.monitors.localizability.draws(self.local.ground_filter.distance_traveled)
        return self._map.render(self._graph.nodes, poses, walls=walls)

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
            + self.local.ground_filter.grid.nbytes
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
                "second_looks": self.local.start.refinements,
                "searches": self.local.registration.searches,
            },
        )


class NodeMap:
    """Map drawn from nodes; a small one is kept while the nodes' poses stay."""

    def __init__(self, config: CartographerConfig) -> None:
        self._config = config
        self._drawn: list[tuple[Pose2, bool]] = []
        self._clear()

    def render(self, nodes: Sequence[Node], poses: Sequence[Pose2], *, walls: bool = True) -> OccupancyGrid:
        """Return the map of nodes at poses `T_map_base`; without walls, their cells are unknown."""
        state = [(pose, node.trimmed) for node, pose in zip(nodes, poses, strict=True)]
        if state[: len(self._drawn)] != self._drawn:
            self._clear()
        for node, (pose, trimmed) in zip(nodes[len(self._drawn) :], state[len(self._drawn) :], strict=True):
            if not trimmed:
                ground = self._ground_filter
                ground.height, ground.drift = node.height, node.drift
                ground.distance_traveled, ground.tilt = node.leveled_distance, node.tilt
                placed, min_slopes = ground.insert(node.scan, pose)
                self._map.update(placed, min_slopes, ground.match_wall_slope, bounding_box(placed))
            self._drawn.append((pose, trimmed))
        grid = self._map.occupancy_grid(self._ground_filter.wall_slope if walls else NO_WALL)
        if self.nbytes > MAX_KEPT_BYTES:
            self._clear()
        return grid

    @property
    def nbytes(self) -> int:
        """Memory of the kept map."""
        return self._map.grid.nbytes + self._ground_filter.grid.nbytes

    def _clear(self) -> None:
        self._map = OccupancyMap(self._config.map_resolution, self._config)
        self._ground_filter = GroundFilter(self._config)
        self._drawn.clear()
