"""Local SLAM: registration of each scan in a submap; the pose graph corrects the drift.

Hess et al. 2016, section IV. The local frame is continuous: nothing that was added to it moves again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from lirs_wct.arrays import ByteArray, FloatArray
from lirs_wct.geometry import Imu, LaserScan, OccupancyGrid, Pose2, wrap_angle
from slam_baselines.cartographer.config import CartographerConfig
from slam_baselines.cartographer.submap import Submaps
from slam_baselines.dead_reckoning import DeadReckoning, PoseEstimate
from slam_baselines.front_end import Keyframe, MotionFilter, Registered, ScanToMapFrontEnd, register_backwards
from slam_baselines.ground_filter import IN_FULL, GroundFilter, GroundFilterConfig, Limits
from slam_baselines.leveling import LeveledScan, ScanPoints, interpolate_hits
from slam_baselines.occupancy_map import NO_WALL, OccupancyMap, UpdateConfig, bounding_box, union_of
from slam_baselines.registration import Registration

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


class AddedNodes(NamedTuple):
    """Result of a scan for the pose graph.

    Attributes:
        nodes: Nodes that were added.
        anew: Whether they replace all nodes so far, because the start was refined.
    """

    nodes: tuple[Node, ...] = ()
    anew: bool = False


class LocalSlam:
    """Poses and submaps in the local frame.

    Attributes:
        front: front end, with the present estimate.
        ground_filter: separates ground from walls.
        submaps: all of them.
        registration: of scans in the matching submap.
        implausible: matches that no motion of the robot explains.
    """

    def __init__(self, parameters: CartographerConfig) -> None:
        self._local = config = parameters.local
        self.ground_filter = GroundFilter(config.ground_filter)
        self.front = ScanToMapFrontEnd[Node].make(
            self.ground_filter, config.tracking, config.localizability, parameters.bootstrap,
            parameters.clear_range, parameters.max_range,
        )  # fmt: skip
        self.submaps = Submaps(config.submaps)
        self.registration = Registration(config.registration)
        self.implausible = 0
        self._reckoning = DeadReckoning(config.motion)
        self._motion = NOWHERE
        self._distance_traveled = self._drawn_at = 0.0
        self._filter = MotionFilter(config.motion_filter)

    def add_scan(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> AddedNodes:
        """Predict the pose of a scan, register it, and draw it into the submaps if due."""
        front, before = self.front, self.front.pose
        level = front.leveler.level(scan, imu)
        step = self._reckoning.step(odometry, imu, scan.stamp)
        self._motion = self._motion if step is None else step.after(self._motion)
        prior = front.estimate if step is None else step.after(front.estimate)
        match = front.match(level, prior, self._match)
        self._distance_traveled += before.distance(front.pose)
        if level.leveled:
            registered = front.localizability.localizable
            self.ground_filter.move(before.inverse() @ front.pose, level, registered=registered)
        added = AddedNodes()
        if front.fits(match) and self._filter.due(level, front.pose):
            added = self._insert(level)
        front.note(scan.stamp)
        return added

    def walls(self, scan: LeveledScan, pose: Pose2, height: float, known: ByteArray | None) -> FloatArray:
        """Return (n,) weights of hits: 1 for walls, 0 for possible ground.

        Args:
            scan: leveled.
            pose: `T_local_base`.
            height: of the base in the local frame, meters.
            known: (n,) minimum slopes known before; None: as the matching submap knows them.
        """
        drawn = self.submaps.matching_submap.coarsest if known is None else None
        return self.ground_filter.match_walls(scan, pose, height, known=known, drawn=drawn)

    def _match(self, scan: LeveledScan, prior: PoseEstimate, seconds: float) -> Registered:
        """Match a scan to the matching submap; reject implausible matches on uneven ground."""
        weights = self.walls(scan, prior.pose, self.ground_filter.height, None)
        submap, wall_slope = self.submaps.matching_submap, self.ground_filter.match_wall_slope
        submap.set_wall_slope(wall_slope)
        estimate, match = self.registration.register(
            submap.pyramid, scan.hits, weights, prior, self.front.pose
        )
        if wall_slope > 0 and not self._plausible(prior, estimate.pose, seconds):
            self.implausible += 1
            return prior, None
        return estimate, match

    def _plausible(self, expected: PoseEstimate, pose: Pose2, seconds: float) -> bool:
        """Return whether odometry and wheel slip allow `pose`.

        Checked on uneven ground only: a hill taken for a wall displaces a scan faster than wheels can slip.
        """
        c, (x, y, yaw) = self._local, expected.covariance.diagonal().tolist()
        slip, turn = pose.distance(expected.pose), abs(wrap_angle(pose.yaw - expected.pose.yaw))
        reach = c.slip_speed * seconds
        return slip <= reach + c.slip_deviations * math.sqrt(
            max(x, y)
        ) and turn <= reach + c.slip_deviations * math.sqrt(yaw)

    def _insert(self, scan: LeveledScan) -> AddedNodes:
        """Draw a scan into the submaps; refine the start when due."""
        front, pose = self.front, self.front.pose
        height, ground_filter = self.ground_filter.height, self.ground_filter
        placed, min_slopes = ground_filter.insert(scan, pose)
        drawn = placed, min_slopes
        if self._distance_traveled - self._drawn_at >= self._local.sparse_distance:
            spacing = self._local.submaps.resolution
            drawn = interpolate_hits(placed, min_slopes, spacing, self._local.interpolation)
        self._drawn_at = self._distance_traveled
        entered = self.submaps.insert_range_data(
            len(front.path), pose, *drawn, ground_filter.match_wall_slope
        )
        motion, self._motion = self._motion, NOWHERE
        self._filter.note(scan, pose)
        node = Node(
            scan, pose, height, min_slopes, motion, front.estimate.covariance,
            front.localizability.believed, entered, ground_filter.distance_traveled,
            ground_filter.drift, ground_filter.tilt, self._distance_traveled,
        )  # fmt: skip
        if not front.enter(node, self._refine):
            return AddedNodes((node,))
        self._filter.correct_pose(front.pose)
        return AddedNodes(tuple(front.bootstrap.keyframes), anew=True)

    def _refine(self, keyframes: list[Node]) -> list[Node] | None:
        """Draw the submaps again from the start with the present knowledge of ground and walls.

        On uneven ground no wall is known at first: the robot starts on odometry alone, and the first scans
        would keep its errors. So the scans are matched from the last to the first, in a map that grows from
        known walls, and drawn at the registered poses.

        Args:
            keyframes: all nodes so far.

        Returns:
            The same nodes with new poses; None without known walls, or once a submap is finished.
        """
        if not self.front.localizability.believed:
            return None
        if self.ground_filter.match_wall_slope == 0 or self.submaps.all[0].finished:
            self.front.bootstrap.close()
            return None
        self.submaps = self.submaps.empty_copy(
            replace(self._local.submaps, num_range_data=len(keyframes) + 1, max_distance=math.inf)
        )
        found = register_backwards(keyframes, partial(self._register, keyframes[0]))
        self.submaps = self.submaps.empty_copy(self._local.submaps)
        drawn = [self._known_walls(node, e.pose) for node, e in zip(keyframes, found, strict=True)]
        self.submaps.reserve(found[0].pose, union_of([bounding_box(placed) for placed, _ in drawn]))
        again: list[Node] = []
        for node, estimate, (placed, min_slopes) in zip(keyframes, found, drawn, strict=True):
            entered = self.submaps.insert_range_data(
                len(again), estimate.pose, placed, min_slopes, self.ground_filter.match_wall_slope
            )
            again.append(
                replace(
                    node,
                    pose=estimate.pose,
                    covariance=estimate.covariance,
                    min_slopes=min_slopes,
                    submaps=entered,
                )
            )
        return again

    def _register(self, final: Node, node: Node, later: Node | None, last: PoseEstimate) -> PoseEstimate:
        """Return a node's estimate in the submap; draw it unless it is the final one."""
        estimate, wall_slope = last, self.ground_filter.match_wall_slope
        if later is not None:
            back = PoseEstimate(later.motion.pose.inverse(), later.motion.covariance)
            expected, submap = compose_estimates(last, back), self.submaps.matching_submap
            weights = self.walls(node.scan, expected.pose, node.height, None)
            submap.set_wall_slope(wall_slope)
            estimate, _ = self.registration.register(
                submap.pyramid, node.scan.hits, weights, expected, expected.pose
            )
        if node is not final:
            # Matching only distinguishes walls from the rest.
            drawn = self._known_walls(node, estimate.pose, (float(wall_slope), float(wall_slope)))
            self.submaps.insert_range_data(0, estimate.pose, *drawn, wall_slope)
        return estimate

    def _known_walls(self, node: Node, pose: Pose2, limits: Limits = IN_FULL) -> tuple[ScanPoints, ByteArray]:
        """Return a node's scan in the local frame and its hits' present minimum slopes."""
        known = node.min_slopes
        slopes = self.ground_filter.min_slopes(node.scan, pose, node.height, known=known, limits=limits)
        return node.scan.transformed(pose, node.height), slopes
