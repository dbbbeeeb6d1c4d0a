"""Keyframes: the scans that entered the map, and the trajectory hung up on them."""

from __future__ import annotations

from dataclasses import dataclass

from lirs_wct.arrays import ByteArray
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.trajectory import Trajectory
from slam_baselines.motion.dead_reckoning import OdometryIncrement
from slam_baselines.scan.leveling import LeveledScan


@dataclass(frozen=True, slots=True)
class Keyframe:
    """A scan that entered the map.

    Attributes:
        scan: leveled.
        pose: `T_map_base`.
        height: of the base in the map frame, metres.
        moves: by odometry since the keyframe before; None where there was no odometry.
        min_slopes: (n,) minimum slopes of its hits, SLOPE_STEP.
    """

    scan: LeveledScan
    pose: Pose2
    height: float
    moves: tuple[OdometryIncrement | None, ...]
    min_slopes: ByteArray


class KeyframeTrajectory:
    """Every scan's pose hung up on a keyframe: when a keyframe moves, its scans move with it."""

    def __init__(self) -> None:
        self._keyframes: list[Pose2] = []
        # Where a keyframe stood when scans were hung up on it, and its number; -1 before the first.
        self._anchors: list[tuple[int, Pose2]] = [(-1, Pose2())]
        self._scans: dict[float, tuple[int, Pose2]] = {}

    def __len__(self) -> int:
        return len(self._scans)

    def add_keyframe(self, pose: Pose2) -> None:
        """Hang up what follows on a new keyframe."""
        self._anchors.append((len(self._keyframes), pose))
        self._keyframes.append(pose)

    def add(self, stamp: float, pose: Pose2) -> None:
        """Note the pose of a scan; a later scan of the same stamp takes the place of the earlier."""
        self._scans[stamp] = len(self._anchors) - 1, pose

    def move(self, poses: list[Pose2]) -> Pose2:
        """Give the first keyframes new poses; return how the last of them moved, `T_new_old`."""
        last = len(poses) - 1
        old = self._keyframes[last]
        self._keyframes[: len(poses)] = poses
        self._anchors.append((len(self._keyframes) - 1, self._keyframes[-1]))
        return poses[-1] @ old.inverse()

    def trajectory(self) -> Trajectory:
        """Return the pose of every scan in the map frame, by stamp."""
        moved = [self._moved(*anchor) for anchor in self._anchors]
        stamps = sorted(self._scans)
        scans = [self._scans[t] for t in stamps]
        return Trajectory.from_poses(stamps, [moved[anchor] @ pose for anchor, pose in scans])

    def _moved(self, keyframe: int, then: Pose2) -> Pose2:
        """Return how a keyframe has moved since then, `T_new_old`."""
        return Pose2() if keyframe < 0 else self._keyframes[keyframe] @ then.inverse()
