"""Local SLAM: registration of each scan in a submap; the pose graph corrects the drift.

Hess et al. 2016, section IV. The local frame is continuous: nothing that was added to it moves again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from lirs_wct.geometry import ByteArray, FloatArray, Imu, LaserScan, Pose2, in_axes_of
from slam_baselines.cartographer.config import CartographerConfig
from slam_baselines.cartographer.submap import Submaps
from slam_baselines.dead_reckoning import DeadReckoning, PoseEstimate, moved_covariance
from slam_baselines.front_end import REFINED_SHARE, FrontEnd, Keyframe, MotionFilter, StartUp
from slam_baselines.ground_filter import IN_FULL, GroundFilter, Limits
from slam_baselines.leveling import LeveledScan, ScanPoints, interpolate_hits
from slam_baselines.occupancy_map import bounding_box, union_of
from slam_baselines.registration import Match, Registration, ScanMatcher

NOWHERE = PoseEstimate(Pose2(), np.zeros((3, 3)))
"""Dead reckoning without any motion."""


@dataclass(frozen=True, slots=True)
class Node(Keyframe):
    """Keyframe that entered submaps; its pose is `T_local_base`.

    Attributes:
        motion: Motion since the node before by dead reckoning.
        covariance: (3, 3) of x, y, yaw in the local frame, given the matching submap.
        localizable: Whether matches localized the robot: only such nodes are searched for loops.
        submaps: Indices of the submaps that it entered.
        leveled_distance: Distance traveled with known attitude, as the ground filter counts it, meters.
        drift: Largest drift of the robot's height until then, meters.
        tilt: Largest tilt of the robot until then, radians.
        distance_traveled: Distance traveled until then, meters.
    """

    motion: PoseEstimate
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
    moved = moved_covariance(first.covariance, pose.x - first.pose.x, pose.y - first.pose.y, 0.0, 0.0)
    return PoseEstimate(pose, moved + in_axes_of(first.pose.inverse(), then.covariance))


class LocalSlam:
    """Poses and submaps in the local frame."""

    def __init__(self, config: CartographerConfig) -> None:
        self._config = c = config
        self.front = FrontEnd(c, c.clear_range, c.max_range, c.resolution)
        self.ground_filter = GroundFilter(c)
        self.submaps = Submaps(c)
        self.registration = Registration(c, ScanMatcher(exact=True))
        self.start = StartUp[Node](c)
        self._reckoning = DeadReckoning(c)
        self._motion = NOWHERE
        self._distance_traveled = self._drawn_at = 0.0
        self._filter = MotionFilter(
            c.max_distance_meters, c.max_angle_radians, c.max_tilt_radians, c.max_time_seconds
        )

    def add_scan(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> tuple[list[Node], bool]:
        """Predict the pose of a scan, register it, and draw it if due.

        Returns nodes for the pose graph, and whether they replace all nodes so far, as the start was refined.
        """
        front, before = self.front, self.front.estimate.pose
        level = front.leveler.level(scan, imu)
        step = self._reckoning.step(odometry, imu, scan.stamp)
        self._motion = self._motion if step is None else step.after(self._motion)
        prior = front.estimate if step is None else step.after(front.estimate)
        estimate, match = self._register(level, prior)
        fits = front.monitor(level, prior, estimate, match, floor=self.ground_filter.flat)
        pose = front.estimate.pose
        self._distance_traveled += before.distance(pose)
        if level.leveled:
            registered = front.monitors.localizability.localizable
            self.ground_filter.move(before.inverse() @ pose, level, registered=registered)
        due = fits and self._filter.due(level, pose)
        added = self._insert(level, pose) if due else ([], False)
        front.note(scan.stamp)
        return added

    def walls(self, scan: LeveledScan, pose: Pose2, height: float) -> FloatArray:
        """Return (n,) weights of hits: 1 for walls that the matching submap knows, 0 for possible ground.

        Pose and height, meters, are those of the base in the local frame.
        """
        ground, drawn = self.ground_filter, self.submaps.matching_submap.coarsest
        return ground.match_weights(scan, pose, drawn, ground.match_wall_slope, height)

    def _register(self, scan: LeveledScan, prior: PoseEstimate) -> tuple[PoseEstimate, Match | None]:
        """Match a scan to the matching submap."""
        if not self.front.path:
            return prior, None
        submap, wall_slope = self.submaps.matching_submap, self.ground_filter.match_wall_slope
        height = self.ground_filter.height
        weights = None if wall_slope == 0 else self.walls(scan, prior.pose, height)
        submap.set_wall_slope(wall_slope)
        trusted = self.front.monitors.localizability.trusted_score
        return self.registration.register(
            submap.pyramid, scan.hits, weights, prior, self.front.estimate, trusted_score=trusted
        )

    def _insert(self, scan: LeveledScan, pose: Pose2) -> tuple[list[Node], bool]:
        """Draw a scan into the submaps; refine the start when due."""
        front, ground = self.front, self.ground_filter
        height = ground.height
        drawn = placed, min_slopes = ground.insert(scan, pose)
        if self._distance_traveled - self._drawn_at >= self._config.sparse_distance:
            drawn = interpolate_hits(placed, min_slopes, self._config.resolution)
        self._drawn_at = self._distance_traveled
        entered = self.submaps.insert_range_data(len(front.path), pose, *drawn, ground.match_wall_slope)
        motion, self._motion = self._motion, NOWHERE
        self._filter.note(scan, pose)
        node = Node(
            scan, pose, height, min_slopes, motion, front.estimate.covariance,
            front.monitors.localizability.believed, entered, ground.distance_traveled,
            ground.drift, ground.tilt, self._distance_traveled,
        )  # fmt: skip
        front.add_keyframe(scan, pose)
        refined = self._refine(self.start.keyframes) if self.start.add(node, ground.distance_traveled) else []
        if not refined:
            return [node], False
        self.start.replace(refined)
        front.replace_start(refined)
        self._filter.correct_pose(front.estimate.pose)
        return refined, True

    def _refine(self, nodes: list[Node]) -> list[Node]:
        """Return the nodes with new poses, drawn again with present knowledge of the walls.

        On uneven ground no wall is known at first: the robot starts on odometry alone, and the first scans
        would keep its errors. So the scans are matched from the last to the first, in a map that grows from
        known walls, and drawn at the registered poses. Without known walls, or once a submap is finished,
        there are none.
        """
        if not self.front.monitors.localizability.believed:
            return []
        wall_slope = self.ground_filter.match_wall_slope
        if wall_slope == 0 or self.submaps.all[0].finished:
            self.start.close()
            return []
        before = self.submaps
        estimates, fits = self._register_backwards(nodes, wall_slope)
        if fits < REFINED_SHARE * (len(nodes) - 1):
            self.submaps = before
            return []
        self.submaps = self.submaps.empty_copy(self._config)
        drawn = [self._known_walls(node, e.pose) for node, e in zip(nodes, estimates, strict=True)]
        self.submaps.reserve(estimates[0].pose, union_of([bounding_box(placed) for placed, _ in drawn]))
        refined: list[Node] = []
        for node, estimate, (placed, min_slopes) in zip(nodes, estimates, drawn, strict=True):
            pose, covariance = estimate.pose, estimate.covariance
            entered = self.submaps.insert_range_data(len(refined), pose, placed, min_slopes, wall_slope)
            refined.append(
                replace(node, pose=pose, covariance=covariance, min_slopes=min_slopes, submaps=entered)
            )
        return refined

    def _register_backwards(self, nodes: list[Node], wall_slope: int) -> tuple[list[PoseEstimate], int]:
        """Return estimates in one new submap and how many fit; the first keeps its pose."""
        whole = replace(self._config, num_range_data=len(nodes) + 1, submap_distance=math.inf)
        self.submaps = self.submaps.empty_copy(whole)
        estimates = [PoseEstimate(nodes[-1].pose, NOWHERE.covariance)]
        registration, fits = self.registration.again(), 0
        for node, later in zip(nodes[::-1], [None, *nodes[:0:-1]], strict=True):
            estimate = estimates[-1]
            if later is not None:
                back = PoseEstimate(later.motion.pose.inverse(), later.motion.covariance)
                expected, submap = compose_estimates(estimate, back), self.submaps.matching_submap
                weights = self.walls(node.scan, expected.pose, node.height)
                submap.set_wall_slope(wall_slope)
                estimate, match = registration.register(
                    submap.pyramid, node.scan.hits, weights, expected, estimate, trusted_score=math.inf
                )
                fits += match is not None and match.score >= self._config.localizable_score
            if node is not nodes[0]:
                # Matching only distinguishes walls from the rest.
                drawn = self._known_walls(node, estimate.pose, (float(wall_slope), float(wall_slope)))
                self.submaps.insert_range_data(0, estimate.pose, *drawn, wall_slope)
            estimates.append(estimate)
        T_new_old = nodes[0].pose @ estimates[-1].pose.inverse()
        return [PoseEstimate(T_new_old @ e.pose, e.covariance) for e in estimates[:0:-1]], fits

    def _known_walls(self, node: Node, pose: Pose2, limits: Limits = IN_FULL) -> tuple[ScanPoints, ByteArray]:
        """Return a node's scan in the local frame and its hits' present minimum slopes."""
        known = node.min_slopes
        slopes = self.ground_filter.min_slopes(node.scan, pose, node.height, known=known, limits=limits)
        return node.scan.transformed(pose, node.height), slopes
