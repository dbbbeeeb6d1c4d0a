"""Local SLAM: registration of each scan in a submap; the pose graph corrects the drift.

Hess et al. 2016, section IV. The local frame is continuous: nothing that was added to it moves again.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import NamedTuple

from lirs_wct.arrays import ByteArray, FloatArray
from lirs_wct.geometry import Imu, LaserScan, Pose2, wrap_angle
from slam_baselines.cartographer.config import CartographerConfig
from slam_baselines.cartographer.node import NOWHERE, Node, compose_estimates
from slam_baselines.cartographer.submap import Submaps
from slam_baselines.front_end import Registered, ScanToMapFrontEnd
from slam_baselines.leveling import LeveledScan, ScanPoints, interpolate_hits
from slam_baselines.mapping.bootstrap import register_backwards
from slam_baselines.mapping.ground_filter import IN_FULL, GroundFilter, Limits
from slam_baselines.mapping.occupancy_map import bounding_box, union_of
from slam_baselines.matching.registration import Registration
from slam_baselines.motion.dead_reckoning import DeadReckoning, PoseEstimate
from slam_baselines.motion.motion_filter import MotionFilter


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
