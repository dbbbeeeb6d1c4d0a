"""Front end of the planar mappers: the shared steps between a scan and the map.

Each scan is leveled, its pose is predicted by dead reckoning, and two monitors decide whether to use the
method's match and whether the scan may enter the map. On uneven ground the start of the map is refined.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from lirs_wct.errors import limited
from lirs_wct.geometry import ByteArray, FloatArray, IntArray, Pose2, Trajectory, wrap_angle
from slam_baselines.dead_reckoning import PoseEstimate
from slam_baselines.ground_filter import GroundFilterConfig
from slam_baselines.leveling import LeveledScan, ScanLeveler
from slam_baselines.linalg import compose_poses, relative_poses, wrap
from slam_baselines.monitors import MonitorConfig, Monitors
from slam_baselines.registration import Match


@dataclass(frozen=True, kw_only=True)
class FrontEndConfig(GroundFilterConfig, MonitorConfig):
    """Parameters of ground filter, monitors and start-up refinement, which all methods share.

    Attributes:
        bootstrap_first: Distance traveled at the first start-up refinement, meters; the next are due at 2, 4,
            8 ... times that.
        bootstrap_last: Distance after which there is none, meters.
    """

    bootstrap_first: float = limited(4.0, "(0, inf]", "m")
    bootstrap_last: float = limited(40.0, "(0, inf]", "m")


@dataclass(frozen=True, slots=True)
class Keyframe:
    """A scan that entered the map.

    Attributes:
        scan: Leveled scan.
        pose: `T_map_base`.
        height: Height of the base in the map frame, meters.
        min_slopes: (n,) minimum slopes of its hits, SLOPE_STEP.
    """

    scan: LeveledScan
    pose: Pose2
    height: float
    min_slopes: ByteArray


class FrontEnd:
    """Pose of the latest scan by dead reckoning and by believed matches.

    Attributes:
        leveler: Leveling of the scans.
        monitors: Monitors of the matches.
        estimate: `T_map_base` and its covariance.
        matched: Scans with a match.
        unmatched: Scans with too few walls in view.
        path: Poses of the keyframes.
        scans: Poses of all scans relative to the keyframes.
        stamp: Time of the last scan, seconds.
    """

    def __init__(self, config: MonitorConfig, clear_range: float, max_range: float) -> None:
        self.leveler = ScanLeveler(clear_range, max_range)
        self.monitors = Monitors(config)
        self.estimate = PoseEstimate(Pose2(), np.zeros((3, 3)))
        self.matched = self.unmatched = 0
        self.path: list[Pose2] = []
        self.scans = KeyframeTrajectory()
        self.stamp = -math.inf

    def monitor(
        self, scan: LeveledScan, prior: PoseEstimate, estimate: PoseEstimate, match: Match | None
    ) -> bool:
        """Take over a believed registration; return whether the scan may enter the map.

        Args:
            scan: Leveled scan.
            prior: Estimate by dead reckoning.
            estimate: Estimate by the registration, `prior` without a match.
            match: Match to the map; None with too few walls in view.
        """
        seconds, self.stamp = scan.stamp - self.stamp, scan.stamp
        self.monitors.reckoned_yaw += wrap_angle(prior.pose.yaw - self.estimate.pose.yaw)
        score, known, yaw = (None, 1.0, 0.0) if match is None else (match.score, match.known, match.pose[2])
        if self.path:
            if scan.leveled:
                self.monitors.observe_match(score, float(yaw), seconds)
            self.matched += match is not None
            self.unmatched += match is None
        self.estimate = estimate if self.monitors.localizability.believed else prior
        return self.monitors.observe_fit(score, known)

    def replace_start(self, keyframes: Sequence[Keyframe]) -> None:
        """Correct path and estimate by the refined keyframes of the start."""
        before = self.path[-1]
        self.path[: len(keyframes)] = [keyframe.pose for keyframe in keyframes]
        T_new_old = self.path[-1] @ before.inverse()
        self.estimate = PoseEstimate(T_new_old @ before, self.estimate.covariance)

    def note(self, stamp: float) -> Pose2:
        """Add the scan to the trajectory; return `T_map_base`."""
        pose = self.estimate.pose
        self.scans.add(stamp, len(self.path) - 1, self.path[-1].inverse() @ pose if self.path else pose)
        return pose


class MotionFilter:
    """Selection of the scans that enter the map: those after enough motion."""

    def __init__(self, distance: float, angle: float, tilt: float, seconds: float = math.inf) -> None:
        """Start; limits in meters, radians of turn, radians of tilt and seconds."""
        self._limits = distance, angle, tilt, seconds
        self._pose: Pose2 | None = None
        self._slope = (0.0, 0.0)
        self._stamp = -math.inf

    def note(self, scan: LeveledScan, pose: Pose2) -> None:
        """Record a scan that enters the map."""
        self._pose, self._slope, self._stamp = pose, scan.ground_slope, scan.stamp

    def correct_pose(self, pose: Pose2) -> None:
        """Correct the pose of the last recorded scan."""
        self._pose = pose

    def due(self, scan: LeveledScan, pose: Pose2) -> bool:
        """Return whether the robot has moved, turned, tilted or waited enough since the last one."""
        last, (distance, angle, tilt, seconds) = self._pose, self._limits
        return (
            last is None
            or math.hypot(pose.x - last.x, pose.y - last.y) > distance
            or abs(math.remainder(pose.yaw - last.yaw, math.tau)) > angle
            or math.dist(scan.ground_slope, self._slope) > tilt
            or scan.stamp - self._stamp > seconds
        )


K = TypeVar("K", bound=Keyframe)


class StartUp(Generic[K]):
    """Schedule of the start-up refinements, and their keyframes.

    On uneven ground no wall is known at first. So the robot starts on odometry alone, and the first scans
    enter the map at poses with a small error that the map would keep. After some meters most walls in the
    first scans are known: a new map is built from them.

    Attributes:
        keyframes: First keyframes; empty when the last refinement is over.
        refinements: Number of refinements.
        over: Whether there will be no more refinement.
    """

    def __init__(self, config: FrontEndConfig) -> None:
        self.keyframes: list[K] = []
        self.refinements = 0
        self._last, self._next = config.bootstrap_last, config.bootstrap_first
        self._distance = 0.0
        self.over = self._next > self._last or self._next == math.inf

    def add(self, keyframe: K, distance_traveled: float) -> bool:
        """Keep a keyframe while it may be needed; return whether a refinement is due.

        Only where the attitude is known: on a floor the start needs no refinement.
        """
        if not keyframe.scan.leveled:
            return False
        if self.over or distance_traveled > self._last:
            self.close()
            return False
        self.keyframes.append(keyframe)
        self._distance = distance_traveled
        return distance_traveled >= self._next

    def replace(self, keyframes: Sequence[K]) -> None:
        """Replace the keyframes by refined ones; all refinements due so far are done."""
        self.keyframes = list(keyframes)
        self.refinements += 1
        while self._next <= self._distance:
            self._next *= 2
        self.over = self._next > self._last

    def close(self) -> None:
        """End the refinements."""
        self.keyframes.clear()
        self.over = True


LEVER = 0.5
"""Meters per radian of turn in the distance over which an error is spread."""


class KeyframeTrajectory:
    """Poses of all scans relative to their last keyframes, 36 bytes a scan."""

    def __init__(self) -> None:
        self._keyframes, self._numbers = array("i"), array("d")

    def add(self, stamp: float, keyframe: int, T_keyframe_scan: Pose2) -> None:
        """Add a scan; a later scan of the same stamp replaces the earlier one.

        Args:
            stamp: Seconds.
            keyframe: Index of the last keyframe; -1 before the first, when the pose is in the start frame.
            T_keyframe_scan: Pose of the base at the scan.
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
            measured: Poses of the keyframes by the motion from one to the next; their difference from
                `keyframes` is spread over the scans between. None: scans keep their poses relative to the
                keyframe before them, as they were matched one by one.
            T_map_start: Pose of the start frame, for scans before the first keyframe; None: the pose by
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
