"""The map drawn from all nodes at their poses: after a loop has closed, or where it is large, drawn again."""

from __future__ import annotations

from collections.abc import Sequence

from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.pose import Pose2
from slam_baselines.cartographer.node import Node
from slam_baselines.mapping.ground_filter import GroundFilter, GroundFilterConfig
from slam_baselines.mapping.occupancy_map import NO_WALL, OccupancyMap, UpdateConfig, bounding_box

MAX_KEPT_BYTES = 64_000_000
"""Memory up to which a drawing is kept for the next time."""


class NodeMap:
    """Draws nodes; keeps a small drawing as long as the nodes stay where they were."""

    def __init__(self, resolution: float, update: UpdateConfig, ground_filter: GroundFilterConfig) -> None:
        self._resolution = resolution
        self._update = update
        self._ground_filter_config = ground_filter
        self._drawn: list[tuple[Pose2, bool]] = []
        self._clear()

    def render(self, nodes: Sequence[Node], poses: Sequence[Pose2], *, walls: bool = True) -> OccupancyGrid:
        """Return the map of nodes at their poses `T_map_base`; without walls, theirs are unknown cells."""
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
        """Memory of what is kept."""
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
