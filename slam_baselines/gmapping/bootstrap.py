"""Backward registration of the first keyframes in a new map, with the gyro's bias.

The gyro's bias follows from the long-run disagreement between walls and gyro; the next round removes it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from lirs_wct.arrays import ByteArray
from lirs_wct.geometry import Pose2, wrap_angle
from slam_baselines.gmapping.copy_on_write_map import PatchMaps
from slam_baselines.gmapping.proposal import Proposer
from slam_baselines.gmapping.scan_matching import ScanBeams
from slam_baselines.linalg import in_axes_of
from slam_baselines.mapping.bootstrap import register_backwards
from slam_baselines.mapping.ground_filter import IN_FULL, GroundFilter, Limits
from slam_baselines.mapping.keyframe import Keyframe
from slam_baselines.motion.dead_reckoning import PoseEstimate
from slam_baselines.motion.gyro_bias import GyroBias, GyroBiasConfig
from slam_baselines.motion.increment import remove_bias

ROUNDS = 2
"""Rounds of each refinement: one alone sees only a part of the bias, because of the prior."""


class GyroIncrement(NamedTuple):
    """Motion from one keyframe to the next.

    Attributes:
        reckoned: by odometry and gyro as they are.
        seconds: spent moving.
    """

    reckoned: PoseEstimate
    seconds: float


GmappingKeyframe = Keyframe[GyroIncrement]


class BiasedRegistration:
    """Registers keyframes in a map of one particle.

    Attributes:
        bias: of the gyro.
    """

    def __init__(self, proposer: Proposer, ground_filter: GroundFilter, gyro: GyroBiasConfig) -> None:
        self.bias = GyroBias.unknown(gyro)
        self._proposer = proposer
        self._ground_filter = ground_filter

    def refine(self, keyframes: Sequence[GmappingKeyframe], maps: PatchMaps) -> list[GmappingKeyframe]:
        """Register keyframes in an empty map and draw them; return them with new poses.

        Backwards, since the first scans know the fewest walls.
        """
        for _ in range(ROUNDS):
            reckoned = self.reckon(keyframes)
            register = partial(self._register, PatchMaps(1, maps.resolution), reckoned[0])
            poses = [estimate.pose for estimate in register_backwards(reckoned, register)]
            self.learn(keyframes, poses)
        found = [replace(k, pose=pose) for k, pose in zip(keyframes, poses, strict=True)]
        return [replace(k, min_slopes=self._draw(maps, k, k.pose, IN_FULL)) for k in found]

    def reckon(self, keyframes: Sequence[GmappingKeyframe]) -> list[GmappingKeyframe]:
        """Return keyframes with their poses by odometry and gyro, less the bias."""
        path = [Pose2()]
        for keyframe in keyframes[1:]:
            motion = keyframe.motion
            path.append(path[-1] @ remove_bias(motion.reckoned.pose, self.bias.value, motion.seconds))
        return [replace(k, pose=pose) for k, pose in zip(keyframes, path, strict=True)]

    def learn(self, keyframes: Sequence[GmappingKeyframe], poses: Sequence[Pose2]) -> None:
        """Estimate the bias from the disagreement between registered headings and the raw gyro."""
        self.bias = GyroBias.unknown(self.bias.config)
        for before, now, keyframe in zip(poses, poses[1:], keyframes[1:], strict=False):
            motion = keyframe.motion
            turned = wrap_angle(now.yaw - before.yaw - motion.reckoned.pose.yaw)
            self.bias = self.bias.learned(turned, motion.seconds)

    def _register(
        self, maps: PatchMaps, final: GmappingKeyframe, now: GmappingKeyframe,
        later: GmappingKeyframe | None, last: PoseEstimate,
    ) -> PoseEstimate:  # fmt: skip
        """Register a keyframe and draw it unless it is the final one; return its estimate."""
        pose = last.pose
        if later is not None:
            pose = pose @ (later.pose.inverse() @ now.pose)
            covariance = in_axes_of(pose.inverse(), later.motion.reckoned.covariance)
            ground = self._ground_filter
            drawn = maps.min_slope(0, now.scan.transformed(pose, now.height).hits)
            known = np.maximum(now.min_slopes, drawn)
            walls = ground.match_walls(now.scan, pose, now.height, known=known)
            view, beams = maps.view(0, ground.match_wall_slope), ScanBeams(now.scan.hits, walls)
            found = self._proposer.match_scan(view, beams, pose.as_array(), covariance)
            pose = pose if found is None else Pose2(*found.tolist())
        if now is not final:
            # Matching only distinguishes walls from the rest.
            wall = float(self._ground_filter.match_wall_slope)
            self._draw(maps, now, pose, (wall, wall))
        return PoseEstimate(pose, last.covariance)

    def _draw(self, maps: PatchMaps, keyframe: GmappingKeyframe, pose: Pose2, limits: Limits) -> ByteArray:
        """Draw a keyframe at a pose; return its hits' minimum slopes, exact between limits."""
        k, ground = keyframe, self._ground_filter
        slopes = ground.min_slopes(k.scan, pose, k.height, known=k.min_slopes, limits=limits)
        points = k.scan.transformed(Pose2(), k.height)
        maps.draw_scan(pose.as_array()[None], points, slopes, ground.match_wall_slope)
        return slopes
