"""Local SLAM: registration of each scan in a submap; the pose graph corrects the drift.

Hess et al. 2016, section IV. The local frame is continuous: nothing that was added to it moves again.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

from lirs_wct.arrays import ByteArray, FloatArray
from lirs_wct.geometry import Pose2, wrap_angle
from slam_baselines.cartographer.config import LocalConfig
from slam_baselines.cartographer.node import NOWHERE, Node, compose_estimates
from slam_baselines.cartographer.submap import Submaps
from slam_baselines.front_end import FrontEndConfig, Registered, ScanToMapFrontEnd
from slam_baselines.leveling import LeveledScan, ScanPoints, interpolate_hits
from slam_baselines.mapping.bootstrap import register_backwards
from slam_baselines.mapping.ground_filter import IN_FULL, GroundFilter, Limits
from slam_baselines.mapping.occupancy_map import bounding_box, union_of
from slam_baselines.matching.registration import Registration
from slam_baselines.motion.dead_reckoning import DeadReckoning, MotionStep, PoseEstimate
from slam_baselines.motion.motion_filter import MotionFilter


class LocalSlam(ScanToMapFrontEnd[Node]):
    """Poses and submaps in the local frame.

    Attributes:
        submaps: all of them.
        registration: of scans in the matching submap.
        implausible: matches that no motion of the robot explains.
    """

    def __init__(self, config: LocalConfig, front_end: FrontEndConfig) -> None:
        super().__init__(front_end, GroundFilter(config.ground_filter), DeadReckoning(config.motion))
        self._local = config
        self.submaps = Submaps(config.submaps)
        self.registration = Registration(config.registration)
        self.implausible = 0
        self._motion = NOWHERE
        self._drawn_at = 0.0
        self._filter = MotionFilter(config.motion_filter)

    def add_motion(self, scan: LeveledScan, step: MotionStep | None) -> None:
        """Add a step by dead reckoning to the motion since the last node."""
        self._motion = self._motion if step is None else step.after(self._motion)

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

    def register(self, scan: LeveledScan, prior: PoseEstimate, seconds: float) -> Registered:
        """Match a scan to the matching submap; reject implausible matches on uneven ground."""
        weights = self.walls(scan, prior.pose, self.ground_filter.height, None)
        submap, wall_slope = self.submaps.matching_submap, self.ground_filter.match_wall_slope
        submap.set_wall_slope(wall_slope)
        found = Registered(
            *self.registration.register(submap.pyramid, scan.hits, weights, prior, self.estimate.pose)
        )
        if wall_slope > 0 and not self._plausible(prior, found.estimate.pose, seconds):
            self.implausible += 1
            return Registered(prior, None)
        return found

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

    def due(self, scan: LeveledScan) -> bool:
        """Return whether the motion filter lets the scan become a node."""
        return self._filter.due(scan, self.estimate.pose)

    def insert(self, scan: LeveledScan, pose: Pose2) -> Node:
        """Draw a scan into the submaps; return its node."""
        height, ground_filter = self.ground_filter.height, self.ground_filter
        placed, min_slopes = ground_filter.insert(scan, pose)
        drawn = placed, min_slopes
        if self.distance_traveled - self._drawn_at >= self._local.sparse_distance:
            spacing = self._local.submaps.resolution
            drawn = interpolate_hits(placed, min_slopes, spacing, self._local.interpolation)
        self._drawn_at = self.distance_traveled
        entered = self.submaps.insert_range_data(
            len(self.path) - 1, pose, *drawn, ground_filter.match_wall_slope
        )
        motion, self._motion = self._motion, NOWHERE
        self._filter.note(scan, pose)
        return Node(
            scan, pose, height, min_slopes, motion, self.estimate.covariance,
            self.localizability.believed, entered, ground_filter.distance_traveled,
            ground_filter.drift, ground_filter.tilt, self.distance_traveled,
        )  # fmt: skip

    def refine(self, keyframes: list[Node]) -> list[Node] | None:
        """Draw the submaps again from the start with the present knowledge of ground and walls.

        On uneven ground no wall is known at first: the robot starts on odometry alone, and the first scans
        would keep its errors. So the scans are matched from the last to the first, in a map that grows from
        known walls, and drawn at the registered poses.

        Args:
            keyframes: all nodes so far.

        Returns:
            The same nodes with new poses; None without known walls, or once a submap is finished.
        """
        if not self.localizability.believed:
            return None
        if self.ground_filter.match_wall_slope == 0 or self.submaps.all[0].finished:
            self.bootstrap.close()
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

    def correct_pose(self, pose: Pose2) -> None:
        """Correct the pose of the last node."""
        self._filter.correct_pose(pose)

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
