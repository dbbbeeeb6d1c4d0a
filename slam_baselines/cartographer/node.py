"""Nodes of the pose graph, and the final map drawn from them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lirs_wct.arrays import FloatArray
from lirs_wct.geometry import OccupancyGrid, Pose2
from slam_baselines.mapping.ground_filter import GroundFilter, GroundFilterConfig
from slam_baselines.mapping.keyframe import Keyframe
from slam_baselines.mapping.occupancy_map import NO_WALL, OccupancyMap, UpdateConfig, bounding_box
from slam_baselines.motion.dead_reckoning import PoseEstimate

NOWHERE = PoseEstimate(Pose2(), np.zeros((3, 3)))
"""Dead reckoning without any motion."""


@dataclass(frozen=True, slots=True)
class Node(Keyframe[PoseEstimate]):
    """Keyframe that entered submaps; pose `T_local_base`, motion by dead reckoning.

    Attributes:
        covariance: (3, 3) of x, y, yaw in the local frame, given the matching submap.
        localizable: whether matches localized the robot: only such nodes are searched for loops.
        submaps: indices of the submaps that it entered.
        leveled_distance: traveled with known attitude until then, as the ground filter counts it, meters.
        drift: largest that the robot's height may have drifted until then, meters.
        tilt: largest of the robot until then, radians.
        distance_traveled: until then, meters.
    """

    covariance: FloatArray
    localizable: bool
    submaps: range
    leveled_distance: float
    drift: float
    tilt: float
    distance_traveled: float

    @property
    def trimmed(self) -> bool:
        """Whether its scan's points were dropped."""
        return len(self.scan.hits) == 0

    def without_points(self) -> Node:
        """Return the node without its scan's points."""
        nothing = np.empty((0, 3))
        scan = replace(self.scan, hits=nothing, free=nothing)
        return replace(self, scan=scan, min_slopes=np.empty(0, np.uint8))

    @property
    def nbytes(self) -> int:
        """Memory of the scan."""
        return self.scan.hits.nbytes + self.scan.free.nbytes + self.min_slopes.nbytes


def compose_estimates(first: PoseEstimate, then: PoseEstimate) -> PoseEstimate:
    """Return `first @ then`; the errors of the two are independent."""
    pose = first.pose @ then.pose
    c, s = math.cos(first.pose.yaw), math.sin(first.pose.yaw)
    R = np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))
    G = np.eye(3)
    G[0, 2], G[1, 2] = first.pose.y - pose.y, pose.x - first.pose.x
    return PoseEstimate(pose, G @ first.covariance @ G.T + R @ then.covariance @ R.T)


MAX_KEPT_BYTES = 64_000_000
"""Memory up to which a drawing is kept for the next time."""


class NodeMap:
    """Map drawn from nodes; a small one is kept while the nodes' poses stay."""

    def __init__(self, resolution: float, update: UpdateConfig, ground_filter: GroundFilterConfig) -> None:
        self._resolution = resolution
        self._update = update
        self._ground_filter_config = ground_filter
        self._drawn: list[tuple[Pose2, bool]] = []
        self._clear()

    def render(self, nodes: Sequence[Node], poses: Sequence[Pose2], *, walls: bool = True) -> OccupancyGrid:
        """Return the map of nodes at poses `T_map_base`; without walls, their cells are unknown."""
        state = [(pose, node.trimmed) for node, pose in zip(nodes, poses, strict=True)]
        if state[: len(self._drawn)] != self._drawn:
            self._clear()
        for node, (pose, trimmed) in zip(nodes[len(self._drawn) :], state[len(self._drawn) :], strict=True):
            if not trimmed:
                self._draw_node(node, pose)
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
        self._map = OccupancyMap(self._resolution, self._update)
        self._ground_filter = GroundFilter(self._ground_filter_config)
        self._drawn.clear()

    def _draw_node(self, node: Node, pose: Pose2) -> None:
        ground_filter = self._ground_filter
        ground_filter.height, ground_filter.drift = node.height, node.drift
        ground_filter.distance_traveled, ground_filter.tilt = node.leveled_distance, node.tilt
        placed, min_slopes = ground_filter.insert(node.scan, pose)
        self._map.update(placed, min_slopes, ground_filter.match_wall_slope, bounding_box(placed))
