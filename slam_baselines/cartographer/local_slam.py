"""Local SLAM: each scan is matched to the submap in front of it; drift is left to the pose graph.

Hess et al. 2016, section IV. The local frame is continuous: what is added to it never moves again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lirs_wct.arrays import ByteArray, FloatArray
from lirs_wct.geometry.pose import Pose2, wrap_angle
from lirs_wct.geometry.scan import Imu, LaserScan
from slam_baselines.cartographer.config import LocalConfig
from slam_baselines.cartographer.node import NOWHERE, Node, compounded
from slam_baselines.cartographer.submap import Submaps
from slam_baselines.mapping.ground_filter import Relief
from slam_baselines.matching.gauss_newton import Match
from slam_baselines.matching.local_matching import LocalMatcher
from slam_baselines.motion.dead_reckoning import DeadReckoning, Estimate
from slam_baselines.motion.motion_filter import MotionFilter
from slam_baselines.scan.leveling import LevelledScan, ScanLeveller


class LocalSlam:
    """Poses and submaps in the local frame.

    Attributes:
        submaps: all of them.
        relief: of the ground, in the local frame.
        matcher: with the count of its searches.
        estimate: `T_local_base`.
        received: scans so far.
        matched: of these, fitted into a submap.
        lost_scans: scans during which the mapper was lost.
        implausible: matches that no motion of the robot explains.
    """

    def __init__(self, config: LocalConfig, clear_range: float, max_range: float) -> None:
        """Use what ScanLeveller takes of ranges, metres."""
        self.config = config
        self.submaps = Submaps(config.submaps)
        self.relief = Relief(config.relief)
        self.matcher = LocalMatcher(config.matching)
        self.estimate = Estimate(Pose2(), np.zeros((3, 3)))
        self.received = self.matched = self.lost_scans = self.implausible = self.nodes = 0
        self._stamp = -math.inf
        self._leveller = ScanLeveller(clear_range, max_range)
        self._reckoning = DeadReckoning(config.motion)
        self._since_node = DeadReckoning(config.motion)
        self._step = NOWHERE
        self._poor_in_a_row = 0
        self._way = 0.0
        self._filter = MotionFilter(config.motion_filter)

    @property
    def lost(self) -> bool:
        """Whether so many scans in a row fit nowhere that the pose is not to be believed."""
        return self._poor_in_a_row >= self.config.lost_after

    def update(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Node | None:
        """Match a scan and move the estimate; return the node where it entered the submaps."""
        level = self._leveller.level(scan, imu)
        before = self.estimate.pose
        expected = self._reckoning.predict(self.estimate, odometry, imu, scan.stamp)
        self._step = self._since_node.predict(self._step, odometry, imu, scan.stamp)
        seconds, self._stamp = scan.stamp - self._stamp, scan.stamp
        fits = self._count(self._match(level, expected, seconds))
        self._way += before.distance(self.estimate.pose)
        if level.levelled:
            self.relief.move(before.inverse() @ self.estimate.pose, level)
        due = fits and self._filter.due(level, self.estimate.pose)
        return self._enter(level) if due else None

    def walls(self, scan: LevelledScan, pose: Pose2, height: float, steep: ByteArray | None) -> FloatArray:
        """Return (n,) 1 for hits on what is known by now to be a wall, 0 for those that may be ground.

        Args:
            scan: levelled.
            pose: `T_local_base`.
            height: of the base in the local frame, metres.
            steep: (n,) what was proven before, if anything.
        """
        bound = self.relief.match_bound
        if bound == 0:
            return np.ones(len(scan.hits))
        origin, hits, _ = scan.placed(pose, height)
        proven = self.relief.steepness(origin, hits, pose)
        known = self.submaps.front.steepness(hits) if steep is None else steep
        return (np.maximum(proven, known) >= bound).astype(np.float64)

    def _match(self, scan: LevelledScan, expected: Estimate, seconds: float) -> Match | None:
        """Move the estimate to where the scan fits; to the expected one, if there is nothing to fit."""
        before, self.estimate = self.estimate.pose, expected
        self.received += 1
        if len(scan.hits) == 0 or not self.submaps.all:
            return None
        weights = self.walls(scan, expected.pose, self.relief.height, None)
        front = self.submaps.front
        front.revalue(self.relief.match_bound)
        fitted, match = self.matcher.fit(front.pyramid, scan.hits, weights, expected, before)
        if self.relief.match_bound > 0 and not self._plausible(expected, fitted.pose, seconds):
            self.implausible += 1
            return None
        self.estimate = fitted
        self.matched += match is not None
        return match

    def _plausible(self, expected: Estimate, pose: Pose2, seconds: float) -> bool:
        """Return whether the robot can be at `pose`, by odometry and what wheels may slip.

        Asked on uneven ground only: a hill taken for a wall pulls a scan away at once, and no wheel does.
        """
        c, sd = self.config, np.sqrt(np.diag(expected.covariance))
        slip, turn = pose.distance(expected.pose), abs(wrap_angle(pose.yaw - expected.pose.yaw))
        reach = c.slip_speed * seconds
        return bool(
            slip <= reach + c.slip_deviations * max(sd[0], sd[1])
            and turn <= reach + c.slip_deviations * sd[2]
        )

    def _count(self, match: Match | None) -> bool:
        """Keep count of poor matches; return whether the scan may enter the submaps."""
        known = self.config.matching.known_share
        fits = match is None or match.known < known or match.score >= self.config.lost_score
        self._poor_in_a_row = 0 if fits else self._poor_in_a_row + 1
        self.lost_scans += self.lost
        return fits

    def _enter(self, scan: LevelledScan) -> Node:
        """Draw the scan into the submaps."""
        pose, height, relief = self.estimate.pose, self.relief.height, self.relief
        origin, hits, free = scan.placed(pose, height)
        steep = relief.observe(origin, hits, free, pose) if scan.levelled else relief.unproven(len(hits))
        entered = self.submaps.insert(self.nodes, pose, origin, hits, free, steep, relief.match_bound)
        step, self._step = self._step, NOWHERE
        self.nodes += 1
        self._filter.note(scan, pose)
        return Node(
            scan, pose, self.estimate.covariance, height, steep, entered, step, relief.travelled, relief.tilt,
            self._way,
        )  # fmt: skip

    def look_again(self, nodes: Sequence[Node]) -> list[Node]:
        """Draw the submaps again from the start with what is known by now about ground and walls.

        On uneven ground nothing is known to be a wall at first: the robot begins on odometry alone, and the
        first scans would stand where it put them for ever. So they are matched from the last to the first, to
        a map that grows from where walls are known, and drawn where they fit.

        Args:
            nodes: all so far.

        Returns:
            The same nodes with new poses.
        """
        found = self._backwards(nodes)
        self.submaps = Submaps(self.config.submaps)
        again: list[Node] = []
        for node, estimate in zip(nodes, found, strict=True):
            origin, hits, free = node.scan.placed(estimate.pose, node.height)
            steep = np.maximum(node.steep, self.relief.steepness(origin, hits, estimate.pose))
            entered = self.submaps.insert(
                len(again), estimate.pose, origin, hits, free, steep, self.relief.match_bound
            )
            again.append(
                replace(
                    node, pose=estimate.pose, covariance=estimate.covariance, steep=steep, submaps=entered
                )
            )
        T_new_old = estimate.pose @ nodes[-1].pose.inverse()
        self.estimate = Estimate(T_new_old @ self.estimate.pose, self.estimate.covariance)
        self._filter.moved(estimate.pose)
        return again

    def _backwards(self, nodes: Sequence[Node]) -> list[Estimate]:
        """Match the nodes from the last to the first; return where they are, the first where it was."""
        self.submaps = Submaps(replace(self.config.submaps, num_range_data=len(nodes) + 1))
        found: list[Estimate] = []
        estimate = Estimate(nodes[-1].pose, np.zeros((3, 3)))
        for i in range(len(nodes) - 1, -1, -1):
            node = nodes[i]
            if found:
                step = nodes[i + 1].odometry
                estimate = self._again(
                    node, compounded(estimate, Estimate(step.pose.inverse(), step.covariance))
                )
            found.append(estimate)
            origin, hits, free = node.scan.placed(estimate.pose, node.height)
            steep = np.maximum(node.steep, self.relief.steepness(origin, hits, estimate.pose))
            self.submaps.insert(i, estimate.pose, origin, hits, free, steep, self.relief.match_bound)
        found.reverse()
        move = nodes[0].pose @ found[0].pose.inverse()
        return [Estimate(move @ e.pose, e.covariance) for e in found]

    def _again(self, node: Node, expected: Estimate) -> Estimate:
        weights = self.walls(node.scan, expected.pose, node.height, None)
        front = self.submaps.front
        front.revalue(self.relief.match_bound)
        fitted, _ = self.matcher.fit(front.pyramid, node.scan.hits, weights, expected, expected.pose)
        return fitted
