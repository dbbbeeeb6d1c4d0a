"""Local SLAM: registration of each scan in a submap; the pose graph corrects the drift.

Hess et al. 2016, section IV. The local frame is continuous: nothing that was added to it moves again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from lirs_wct.arrays import ByteArray, FloatArray
from lirs_wct.geometry.pose import Pose2, wrap_angle
from lirs_wct.geometry.scan import Imu, LaserScan
from slam_baselines.cartographer.config import LocalConfig
from slam_baselines.cartographer.node import NOWHERE, Node, compose_estimates
from slam_baselines.cartographer.submap import Submaps
from slam_baselines.mapping.bootstrap import register_backwards
from slam_baselines.mapping.ground_filter import IN_FULL, GroundFilter, Limits
from slam_baselines.mapping.occupancy_map import bounding_box, union_of
from slam_baselines.matching.gauss_newton import Match
from slam_baselines.matching.localizability import LocalizabilityMonitor
from slam_baselines.matching.registration import Registration
from slam_baselines.matching.tracking_monitor import TrackingMonitor
from slam_baselines.motion.dead_reckoning import DeadReckoning, PoseEstimate
from slam_baselines.motion.motion_filter import MotionFilter
from slam_baselines.scan.interpolation import interpolate_hits
from slam_baselines.scan.leveling import LeveledScan, ScanLeveler, ScanPoints


class LocalSlam:
    """Poses and submaps in the local frame.

    Attributes:
        submaps: all of them.
        ground_filter: in the local frame.
        registration: of scans in the matching submap.
        localizability: monitor of the matches to walls; observes scans whose attitude is known.
        estimate: `T_local_base`.
        received: scans so far.
        matched: of these, registered in a submap.
        lost_scans: scans during which the mapper was lost.
        implausible: matches that no motion of the robot explains.
    """

    def __init__(self, config: LocalConfig, clear_range: float, max_range: float) -> None:
        """Take the range limits of ScanLeveler, meters."""
        self.config = config
        self.submaps = Submaps(config.submaps)
        self.ground_filter = GroundFilter(config.ground_filter)
        self.registration = Registration(config.registration)
        self.estimate = PoseEstimate(Pose2(), np.zeros((3, 3)))
        self.received = self.matched = self.lost_scans = self.implausible = self.nodes = 0
        self._stamp = -math.inf
        self._leveler = ScanLeveler(clear_range, max_range)
        self._reckoning = DeadReckoning(config.motion)
        self._increment = NOWHERE
        self.localizability = LocalizabilityMonitor(config.localizability)
        self._reckoned_yaw = 0.0
        self._tracking = TrackingMonitor(config.tracking)
        self._distance_traveled = self._drawn_at = 0.0
        self._filter = MotionFilter(config.motion_filter)

    @property
    def lost(self) -> bool:
        """Whether too many scans in a row contradict the map."""
        return self._tracking.lost

    def add_range_data(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Node | None:
        """Match a scan and move the estimate; return the node where it entered the submaps."""
        level = self._leveler.level(scan, imu)
        before = self.estimate.pose
        step = self._reckoning.step(odometry, imu, scan.stamp)
        expected = self.estimate if step is None else step.after(self.estimate)
        self._increment = self._increment if step is None else step.after(self._increment)
        seconds, self._stamp = scan.stamp - self._stamp, scan.stamp
        fits = self._fits(self._match(level, expected, seconds))
        self._distance_traveled += before.distance(self.estimate.pose)
        if level.leveled:
            moved = before.inverse() @ self.estimate.pose
            self.ground_filter.move(moved, level, registered=self.localizability.localizable)
        due = fits and self._filter.due(level, self.estimate.pose)
        return self._insert_into_submaps(level) if due else None

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

    def _match(self, scan: LeveledScan, expected: PoseEstimate, seconds: float) -> Match | None:
        """Set the estimate to the registered pose, or to the expected one without a match."""
        before, self.estimate = self.estimate.pose, expected
        self.received += 1
        self._reckoned_yaw += wrap_angle(expected.pose.yaw - before.yaw)
        if len(scan.hits) == 0 or not self.submaps.all:
            return None
        weights = self.walls(scan, expected.pose, self.ground_filter.height, None)
        submap = self.submaps.matching_submap
        submap.set_wall_slope(self.ground_filter.match_wall_slope)
        fitted, match = self.registration.register(submap.pyramid, scan.hits, weights, expected, before)
        if self.ground_filter.match_wall_slope > 0 and not self._plausible(expected, fitted.pose, seconds):
            self.implausible += 1
            fitted, match = expected, None
        if scan.leveled:
            off = 0.0 if match is None else wrap_angle(match.pose[2] - self._reckoned_yaw)
            self.localizability.observe(None if match is None else match.score, off, seconds)
        if self.localizability.believed:
            self.estimate = fitted
        self.matched += match is not None
        return match

    def _plausible(self, expected: PoseEstimate, pose: Pose2, seconds: float) -> bool:
        """Return whether odometry and wheel slip allow `pose`.

        Checked on uneven ground only: a hill taken for a wall displaces a scan faster than wheels can slip.
        """
        c, (x, y, yaw) = self.config, expected.covariance.diagonal().tolist()
        slip, turn = pose.distance(expected.pose), abs(wrap_angle(pose.yaw - expected.pose.yaw))
        reach = c.slip_speed * seconds
        return slip <= reach + c.slip_deviations * math.sqrt(
            max(x, y)
        ) and turn <= reach + c.slip_deviations * math.sqrt(yaw)

    def _fits(self, match: Match | None) -> bool:
        """Return whether the scan may enter the submaps; before walls are proven, any may."""
        if match is None or (self.localizability.scans and not self.localizability.proven):
            fits = self._tracking.observe(None)
        else:
            fits = self._tracking.observe(match.score, match.known)
        self.lost_scans += self.lost
        return fits

    def _insert_into_submaps(self, scan: LeveledScan) -> Node:
        """Draw the scan into the submaps."""
        pose, height, ground_filter = self.estimate.pose, self.ground_filter.height, self.ground_filter
        placed, min_slopes = ground_filter.insert(scan, pose)
        drawn = placed, min_slopes
        if self._distance_traveled - self._drawn_at >= self.config.sparse_distance:
            spacing = self.config.submaps.resolution
            drawn = interpolate_hits(placed, min_slopes, spacing, self.config.interpolation)
        self._drawn_at = self._distance_traveled
        entered = self.submaps.insert_range_data(self.nodes, pose, *drawn, ground_filter.match_wall_slope)
        step, self._increment = self._increment, NOWHERE
        self.nodes += 1
        self._filter.note(scan, pose)
        return Node(
            scan, pose, height, min_slopes, step, self.estimate.covariance,
            self.localizability.believed, entered, ground_filter.distance_traveled,
            ground_filter.drift, ground_filter.tilt, self._distance_traveled,
        )  # fmt: skip

    def refine(self, nodes: Sequence[Node]) -> list[Node]:
        """Draw the submaps again from the start with the present knowledge of ground and walls.

        On uneven ground no wall is known at first: the robot starts on odometry alone, and the first scans
        would keep its errors. So the scans are matched from the last to the first, in a map that grows from
        known walls, and drawn at the registered poses.

        Args:
            nodes: all so far.

        Returns:
            The same nodes with new poses.
        """
        self.submaps = self.submaps.empty_copy(
            replace(self.config.submaps, num_range_data=len(nodes) + 1, max_distance=math.inf)
        )
        found = register_backwards(nodes, partial(self._register, nodes[0]))
        self.submaps = self.submaps.empty_copy(self.config.submaps)
        drawn = [self._known_walls(node, e.pose) for node, e in zip(nodes, found, strict=True)]
        self.submaps.reserve(found[0].pose, union_of([bounding_box(placed) for placed, _ in drawn]))
        again: list[Node] = []
        for node, estimate, (placed, min_slopes) in zip(nodes, found, drawn, strict=True):
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
        T_new_old = estimate.pose @ nodes[-1].pose.inverse()
        self.estimate = PoseEstimate(T_new_old @ self.estimate.pose, self.estimate.covariance)
        self._filter.correct_pose(estimate.pose)
        return again

    def _register(self, final: Node, node: Node, later: Node | None, last: PoseEstimate) -> PoseEstimate:
        """Return a node's estimate in the submap so far; draw it there unless it is the final one."""
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
        """Return a node's scan in the local frame and the present minimum slopes of its hits."""
        known = node.min_slopes
        slopes = self.ground_filter.min_slopes(node.scan, pose, node.height, known=known, limits=limits)
        return node.scan.transformed(pose, node.height), slopes
