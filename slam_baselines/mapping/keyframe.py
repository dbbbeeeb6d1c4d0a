"""Keyframes (scans that entered a map), and the trajectory of all scans."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from lirs_wct.arrays import ByteArray, FloatArray, IntArray
from lirs_wct.geometry import Pose2, Trajectory
from slam_baselines.leveling import LeveledScan
from slam_baselines.linalg import compose_poses, relative_poses, wrap

Motion = TypeVar("Motion")


@dataclass(frozen=True, slots=True)
class Keyframe(Generic[Motion]):
    """A scan that entered the map.

    Attributes:
        scan: leveled.
        pose: `T_map_base`.
        height: of the base in the map frame, meters.
        min_slopes: (n,) minimum slopes of its hits, SLOPE_STEP.
        motion: from the keyframe before, as the method measures it.
    """

    scan: LeveledScan
    pose: Pose2
    height: float
    min_slopes: ByteArray
    motion: Motion


LEVER = 0.5
"""Meters per radian of turn in the distance over which an error is spread."""


class KeyframeTrajectory:
    """Poses of all scans relative to their last keyframes, 36 bytes a scan."""

    def __init__(self) -> None:
        self._keyframes, self._numbers = array("i"), array("d")

    def add(self, stamp: float, keyframe: int, T_keyframe_scan: Pose2) -> None:
        """Add a scan; a later scan of the same stamp replaces the earlier one.

        Args:
            stamp: seconds.
            keyframe: index of the last one; -1 before the first, when the pose is in the start frame.
            T_keyframe_scan: pose of the base at the scan.
        """
        pose = T_keyframe_scan
        self._keyframes.append(keyframe)
        self._numbers.extend((stamp, pose.x, pose.y, pose.yaw))

    def trajectory(
        self,
        keyframes: Sequence[Pose2],
        measured: Sequence[Pose2] | None = None,
        T_map_start: Pose2 | None = None,
    ) -> Trajectory:
        """Return the pose of every scan in the map frame, by stamp.

        Args:
            keyframes: `T_map_base` of the keyframes.
            measured: poses of the keyframes by the motion from one to the next; their difference from
                `keyframes` is spread over the scans between. None: scans keep their poses relative to the
                keyframe before them, as they were matched one by one.
            T_map_start: of the start frame, for scans before the first keyframe; None: the pose by
                `measured`, else the map frame.
        """
        if not self._keyframes:
            return Trajectory.from_poses([], [])
        stamps, last, scans = self._by_stamp()
        if T_map_start is None:
            T_map_start = keyframes[0] @ measured[0].inverse() if measured and keyframes else Pose2()
        poses = compose_poses(T_map_start.as_array(), scans)
        at = last >= 0
        if at.any():
            final = np.array([p.as_array() for p in keyframes])
            poses[at] = compose_poses(final[last[at]], scans[at])
            if measured is not None:
                by_motion = np.array([p.as_array() for p in measured])
                poses[at] = _spread(poses[at], scans[at], last[at], final, by_motion)
        return Trajectory.from_poses(stamps, (Pose2(*pose.tolist()) for pose in poses))

    def _by_stamp(self) -> tuple[FloatArray, IntArray, FloatArray]:
        """Return ordered stamps (n,), keyframes (n,) and poses (n, 3), the last of each stamp."""
        rows = np.array(self._numbers).reshape(-1, 4)
        order = np.argsort(rows[:, 0], kind="stable")
        ordered = rows[order, 0]
        order = order[np.append(ordered[1:] != ordered[:-1], True)]
        return rows[order, 0], np.array(self._keyframes, dtype=np.int64)[order], rows[order, 1:]


def _spread(
    poses: FloatArray, scans: FloatArray, last: IntArray, final: FloatArray, measured: FloatArray
) -> FloatArray:
    """Interpolate between the poses by the previous and by the next keyframe."""
    after = np.clip(last + 1, 0, len(final) - 1)
    ahead = relative_poses(measured[after], compose_poses(measured[last], scans))
    near, far = (np.hypot(d[:, 0], d[:, 1]) + LEVER * abs(wrap(d[:, 2])) for d in (scans, ahead))
    delta = compose_poses(final[after], ahead) - poses
    delta[:, 2] = wrap(delta[:, 2])
    return np.asarray(poses + (near / np.maximum(near + far, 1e-12))[:, None] * delta)
