"""Nodes: the scans that the pose graph holds."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from lirs_wct.arrays import FloatArray
from lirs_wct.geometry.pose import Pose2
from slam_baselines.mapping.keyframe import Keyframe
from slam_baselines.motion.dead_reckoning import PoseEstimate

NOWHERE = PoseEstimate(Pose2(), np.zeros((3, 3)))
"""Dead reckoning that has just begun."""


@dataclass(frozen=True, slots=True)
class Node(Keyframe[PoseEstimate]):
    """A keyframe that entered submaps; its pose is `T_local_base`, its motion that by dead reckoning.

    Attributes:
        covariance: (3, 3) of x, y, yaw in the local frame, given the matching submap.
        localizable: whether its match was to be believed: loops are searched for with such nodes only.
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


def composed(first: PoseEstimate, then: PoseEstimate) -> PoseEstimate:
    """Return `first @ then`; the errors of the two are independent."""
    pose = first.pose @ then.pose
    c, s = math.cos(first.pose.yaw), math.sin(first.pose.yaw)
    R = np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))
    G = np.eye(3)
    G[0, 2], G[1, 2] = first.pose.y - pose.y, pose.x - first.pose.x
    return PoseEstimate(pose, G @ first.covariance @ G.T + R @ then.covariance @ R.T)
