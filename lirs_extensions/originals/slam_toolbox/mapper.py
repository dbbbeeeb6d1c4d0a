"""Planar slam_toolbox as in its authors' program: gate, correlative matching, pose graph.

Macenski and Jambrecic 2021, driven as by its synchronous node. No attitude, no ground filter: on uneven
ground hillsides are walls. It never reports that it is lost.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from lirs_extensions.originals.slam_toolbox.config import SlamToolboxOriginalConfig
from lirs_extensions.originals.slam_toolbox.pose_graph import TOLERANCE, SlamToolboxGraph
from lirs_extensions.originals.slam_toolbox.scan_matching import ScanNode
from lirs_wct.errors import SourceError, reason_of
from lirs_wct.formats.yaml_text import load_yaml
from lirs_wct.geometry import Imu, LaserScan, OccupancyGrid, Pose2, Trajectory, wrap_angle
from slam_baselines.cartographer.loop_closure import LoopEvent
from slam_baselines.front_end import KeyframeTrajectory
from slam_baselines.leveling import LeveledScan, ScanLeveler
from slam_baselines.mapper import MapperStats, PlanarMapper, make_mapper, parameters
from slam_baselines.occupancy_map import OccupancyMap, bounding_box

WARM_UP = {
    "link_scan_maximum_distance": 0.3,
    "loop_search_maximum_distance": 0.4,
    "loop_match_minimum_chain_size": 1,
}
"""Configuration with which a short drive closes a loop."""
GATE_SHARE = 0.8
"""Share of the squared travel distance after which a scan passes the gate."""
FIRST_SCANS = 5
"""Number of the first scan that can pass the gate as the second one."""
MAX_INTERVAL = 3600.0
"""Time since the last node after which a scan that passed the gate becomes one, seconds."""


class SlamToolboxOriginalMapper(PlanarMapper):
    """Scan matching with the last ten nodes, near chains and loops; no attitude.

    Inside, the map frame is the odometry frame, as in the original: its optimizer depends on the origin.
    """

    name = "slam_toolbox_original"
    requires_odometry = True

    def __init__(self, config: SlamToolboxOriginalConfig | None = None) -> None:
        super().__init__()
        self.config = c = config or SlamToolboxOriginalConfig()
        self._graph = SlamToolboxGraph(c)
        self._leveler = ScanLeveler(0.0, c.max_laser_range)
        self._scans = KeyframeTrajectory()
        self._kept: list[LeveledScan] = []
        self._running: list[int] = []
        self._let_in: tuple[float, Pose2] | None = None

    def process(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        """Make the scan a node if due; return `T_map_base`."""
        assert odometry is not None, "it is required"
        nodes = self._graph.nodes
        if self._passes_gate(scan.stamp, odometry) and self._is_node_due(scan, odometry):
            self._add_node(ScanNode(scan, odometry, self.config))
            self._kept.append(self._leveler.level(scan, None))
        since = nodes[-1].odometry.inverse() @ odometry
        self._scans.add(scan.stamp, len(nodes) - 1, since)
        return nodes[0].odometry.inverse() @ nodes[-1].pose @ since

    def map(self) -> OccupancyGrid:
        """Return the map of all nodes at their poses now (see OccupancyMap)."""
        drawn = OccupancyMap(self.config.resolution)
        for scan, pose in zip(self._kept, self._poses(), strict=True):
            placed = scan.transformed(pose, 0.0)
            drawn.update(placed, np.zeros(len(placed.hits), np.uint8), 0, bounding_box(placed))
        return drawn.occupancy_grid(0)

    def trajectory(self) -> Trajectory:
        """Return the pose of every scan: its node's pose now, and the odometry since then."""
        return self._scans.trajectory(self._poses())

    @property
    def loops(self) -> list[LoopEvent]:
        """Loops closed so far."""
        return list(self._graph.events)

    def counts(self) -> MapperStats:
        """Return used and skipped scans, memory and other counts."""
        graph, used = self._graph, len(self._graph.nodes)
        counts = {"nodes": used, "edges": len(graph.links)}
        counts |= {"loops": len(graph.events), "loop_searches": graph.loop_searches}
        memory = graph.matcher.cells.nbytes + graph.loop_matcher.cells.nbytes
        skipped = {"not moved": self.received - used}
        return MapperStats(used=used, skipped=skipped, memory=memory, counts=counts)

    def _poses(self) -> list[Pose2]:
        """Return `T_map_base` of all nodes."""
        nodes = self._graph.nodes
        return [nodes[0].odometry.inverse() @ node.pose for node in nodes]

    def _passes_gate(self, stamp: float, odometry: Pose2) -> bool:
        """Return whether time and distance since the last scan that passed suffice."""
        c = self.config
        if self._let_in is not None:
            then, last = self._let_in
            early = stamp - then < c.minimum_time_interval or self.received < FIRST_SCANS
            near = last.distance(odometry) ** 2 < GATE_SHARE * c.minimum_travel_distance**2
            if early or near or self.received % c.throttle_scans:
                return False
        self._let_in = stamp, odometry
        return True

    def _is_node_due(self, scan: LaserScan, odometry: Pose2) -> bool:
        """Return whether distance, turn or time since the last node are large enough."""
        c, nodes = self.config, self._graph.nodes
        if not nodes:
            return True
        last, now = nodes[-1], odometry @ scan.T_base_laser.to_pose2()
        before = last.odometry @ last.mount
        return (
            before.distance(now) ** 2 >= c.minimum_travel_distance**2 - TOLERANCE
            or abs(wrap_angle(now.yaw - before.yaw)) >= c.minimum_travel_heading
            or scan.stamp - last.stamp >= MAX_INTERVAL
        )

    def _add_node(self, node: ScanNode) -> None:
        """Match a node with the running buffer, link it and close its loops."""
        c, graph, running, match = self.config, self._graph, self._running, None
        if graph.nodes:
            last = graph.nodes[-1]
            node.place(last.pose @ last.odometry.inverse() @ node.odometry)
            if c.use_scan_matching:
                base = [graph.nodes[i] for i in running]
                match = graph.matcher.match(node, base, node.sensor, penalize=True)
                node.place(node.base_at(match.sensor))
        graph.add_node(node, match, running)
        running.append(len(graph.nodes) - 1)
        while len(running) > c.scan_buffer_size or (
            graph.nodes[running[0]].sensor.distance(node.sensor) > c.scan_buffer_maximum_scan_distance
        ):
            del running[0]
        if c.use_scan_matching and c.do_loop_closing:
            graph.close_loops(running[-1])


def read_ros_file(path: Path) -> str:
    """Return the parameters of a ROS file that are not the defaults, `NAME=VALUE,...`."""
    name, default = SlamToolboxOriginalMapper.name, SlamToolboxOriginalConfig()
    try:
        given = dict(load_yaml(path.read_text(encoding="utf-8"))["slam_toolbox"]["ros__parameters"])
        known = {key: given[key] for key in given if key in parameters(name)}
        make_mapper(name, **known)
    except (KeyError, TypeError) as error:
        raise SourceError(f"{path}: must hold `slam_toolbox: ros__parameters: NAME: VALUE`") from error
    except (OSError, ValueError) as error:
        raise SourceError(f"{path}: {reason_of(error)}") from error
    if ignored := sorted(map(str, given.keys() - known.keys())):
        warnings.warn(f"{path}: without effect on {name}: {', '.join(ignored)}", stacklevel=2)
    changed = [key for key in known if known[key] != getattr(default, key)]
    return ",".join(f"{key}={str(known[key]).lower()}" for key in changed)
