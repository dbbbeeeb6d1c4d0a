"""Front end of the planar mappers: the shared steps between a scan and the map.

Each scan is leveled, its pose is predicted by dead reckoning, and two monitors decide whether to use the
method's match and whether the scan may enter the map. On uneven ground the start of the map is refined.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Generic, Self, TypeVar

import numpy as np

from lirs_wct.arrays import ByteArray, FloatArray, IntArray
from lirs_wct.checks import Checked, limited
from lirs_wct.geometry import Imu, LaserScan, Pose2, Trajectory, wrap_angle
from slam_baselines.dead_reckoning import PoseEstimate
from slam_baselines.ground_filter import GroundFilter
from slam_baselines.leveling import LeveledScan, ScanLeveler
from slam_baselines.linalg import compose_poses, relative_poses, wrap
from slam_baselines.mapper import MapperStats, Stopwatch, check_motion, required_odometry
from slam_baselines.monitors import (
    LocalizabilityConfig,
    LocalizabilityMonitor,
    TrackingConfig,
    TrackingMonitor,
)
from slam_baselines.registration import Match

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


@dataclass(frozen=True, kw_only=True)
class MotionFilterConfig(Checked, of="the motion filter"):
    """Motion after which a scan becomes a node; names as in Cartographer's motion_filter.

    Attributes:
        max_time_seconds: longest time between two nodes.
        max_distance_meters: largest distance between two nodes.
        max_angle_radians: largest turn between two nodes.
        max_tilt_radians: largest change of tilt between two nodes; it shows other heights of the same things.
    """

    max_time_seconds: float = limited(math.inf, "[0, inf]")
    max_distance_meters: float = limited(0.2, "[0, inf]")
    max_angle_radians: float = limited(math.radians(10.0), "[0, inf]")
    max_tilt_radians: float = limited(math.radians(1.0), "[0, inf]")


class MotionFilter:
    """Comparison of scans with the last node."""

    def __init__(self, config: MotionFilterConfig) -> None:
        self._config = config
        self._pose: Pose2 | None = None
        self._slope = (0.0, 0.0)
        self._stamp = -math.inf

    def note(self, scan: LeveledScan, pose: Pose2) -> None:
        """Record a node."""
        self._pose, self._slope, self._stamp = pose, scan.ground_slope, scan.stamp

    def correct_pose(self, pose: Pose2) -> None:
        """Correct the last node's pose."""
        self._pose = pose

    def due(self, scan: LeveledScan, pose: Pose2) -> bool:
        """Whether the robot has moved enough since the last node."""
        if self._pose is None:
            return True
        c = self._config
        tilt = math.hypot(scan.ground_slope[0] - self._slope[0], scan.ground_slope[1] - self._slope[1])
        return (
            pose.distance(self._pose) > c.max_distance_meters
            or abs(wrap_angle(pose.yaw - self._pose.yaw)) > c.max_angle_radians
            or tilt > c.max_tilt_radians
            or scan.stamp - self._stamp > c.max_time_seconds
        )


K = TypeVar("K", bound=Keyframe[Any])
Register = Callable[[K, "K | None", PoseEstimate], PoseEstimate]
"""A method's registration of a keyframe in the new map, which it enters there.

Called with the keyframe, the one registered before it (None for the first, which keeps its pose) and
the estimate of that one; returns the estimate of the keyframe.
"""


@dataclass(frozen=True, kw_only=True)
class BootstrapConfig(Checked, of="the bootstrap"):
    """Distances at which the start is refined.

    Attributes:
        first: distance traveled at the first refinement, meters; the next are due at 2, 4, 8 ... times that.
        last: distance after which there is none, meters.
    """

    first: float = limited(4.0, "(0, inf]", "m")
    last: float = limited(40.0, "(0, inf]", "m")


class Bootstrap(Generic[K]):
    """Schedule of the refinements, and their keyframes.

    Attributes:
        keyframes: the first ones; empty when the last refinement is over.
        refinements: number of refinements.
    """

    def __init__(self, config: BootstrapConfig) -> None:
        self.keyframes: list[K] = []
        self.refinements = 0
        self._last = config.last
        self._next = config.first
        self._distance = 0.0

    @property
    def over(self) -> bool:
        """Whether there will be no more refinement."""
        return self._next > self._last or self._next == math.inf

    def add(self, keyframe: K, distance_traveled: float) -> bool:
        """Keep a keyframe while it may be needed; return whether a refinement is due."""
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

    def close(self) -> None:
        """End the refinements."""
        self.keyframes.clear()
        self._next = math.inf


def register_forwards(keyframes: Sequence[K], register: Register[K]) -> list[PoseEstimate]:
    """Register keyframes from the fixed first one to the last; return their estimates."""
    before, estimates = None, [PoseEstimate(keyframes[0].pose, np.zeros((3, 3)))]
    for keyframe in keyframes:
        estimates.append(register(keyframe, before, estimates[-1]))
        before = keyframe
    return estimates[1:]


def register_backwards(keyframes: Sequence[K], register: Register[K]) -> list[PoseEstimate]:
    """Register keyframes from the last to the first.

    So the new map grows from known walls.

    Returns:
        Estimates of the keyframes, moved such that the first keeps its pose.
    """
    estimates = register_forwards(keyframes[::-1], register)[::-1]
    T_new_old = keyframes[0].pose @ estimates[0].pose.inverse()
    return [PoseEstimate(T_new_old @ e.pose, e.covariance) for e in estimates]


Registered = tuple[PoseEstimate, Match | None]
"""Estimate by a registration, the prior without a match, and the match, None with too few walls in view."""
Refine = Callable[[list[K]], "list[K] | None"]
"""Function that builds a map again from its first keyframes.

It returns them with their new poses, or None if that is not possible.
"""


class PlanarMapper(ABC):
    """Estimator of a pose from planar scans that counts and times them.

    Attributes:
        name: of the method, as in MAPPERS.
        requires_odometry: whether scans without odometry are refused.
        tracking: monitor of the scans that contradict the map; None = the pose is never called unknown.
        received: scans so far.
        lost_scans: scans during which the pose was unknown.
    """

    name = ""
    requires_odometry = False

    def __init__(self, tracking: TrackingMonitor | None = None) -> None:
        self.tracking = tracking
        self.received = self.lost_scans = 0
        self._stopwatch = Stopwatch()

    def update(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        """Process a scan; return `T_map_base` at its stamp.

        Raises:
            ConfigError: there is no odometry, and the method requires it; or odometry or IMU are not finite.
        """
        check_motion(odometry, imu)
        if self.requires_odometry:
            odometry = required_odometry(self.name, odometry, scan.stamp)
        started = self._stopwatch.start()
        self.received += 1
        pose = self.process(scan, odometry, imu)
        self.lost_scans += self.lost
        self._stopwatch.stop(started)
        return pose

    @abstractmethod
    def process(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        """Process a scan as the method does; return `T_map_base`."""

    @abstractmethod
    def counts(self) -> MapperStats:
        """Return the method's part of the statistics: used and skipped scans, memory, other counts."""

    @property
    def lost(self) -> bool:
        """Whether the pose is unknown: too many scans in a row contradict the map."""
        return self.tracking is not None and self.tracking.lost

    @property
    def stats(self) -> MapperStats:
        """Counts, times and memory so far."""
        times = self._stopwatch.summary()
        return replace(self.counts(), received=self.received, lost=self.lost_scans, **times)


@dataclass
class FrontEnd(Generic[K]):
    """Leveling, ground filter, monitors and start-up refinement of a mapper.

    Attributes:
        leveler: of scans.
        ground_filter: separates ground from walls.
        localizability: monitor of the matches to walls; observes scans whose attitude is known.
        tracking: monitor of the scans that contradict the map.
        bootstrap: schedule of the start-up refinement, with its keyframes.
        reckoned_yaw: yaw by dead reckoning since the start, radians.
    """

    leveler: ScanLeveler
    ground_filter: GroundFilter
    tracking: TrackingMonitor
    localizability: LocalizabilityMonitor
    bootstrap: Bootstrap[K]
    reckoned_yaw: float = 0.0

    @classmethod
    def make(
        cls, ground_filter: GroundFilter, tracking: TrackingConfig, localizability: LocalizabilityConfig,
        bootstrap: BootstrapConfig, clear_range: float, max_range: float,
    ) -> Self:  # fmt: skip
        """Make a front end by the parameters of its parts."""
        leveler, monitor = ScanLeveler(clear_range, max_range), LocalizabilityMonitor(localizability)
        return cls(leveler, ground_filter, TrackingMonitor(tracking), monitor, Bootstrap(bootstrap))

    @property
    def draws_walls(self) -> bool:
        """Whether walls may be drawn; not if dead reckoning placed most of them."""
        return self.localizability.draws(self.ground_filter.distance_traveled)

    def observe_localizability(self, score: float | None, yaw: float, seconds: float) -> None:
        """Update the localizability monitor by a match; without one, the score is None."""
        off = 0.0 if score is None else wrap_angle(yaw - self.reckoned_yaw)
        self.localizability.observe(score, off, seconds)

    def observe_fit(self, score: float | None, known: float) -> bool:
        """Return whether a scan may enter the map; before walls are proven, any may."""
        unproven = self.localizability.scans and not self.localizability.proven
        return self.tracking.observe(None if unproven else score, known)

    def refine_start(self, newest: K, refine: Refine[K]) -> bool:
        """Keep a keyframe for the start-up refinement; refine when due, and return whether it was.

        Only where the attitude is known: on a floor the start needs no refinement.
        """
        driven = self.ground_filter.distance_traveled
        if not newest.scan.leveled or not self.bootstrap.add(newest, driven):
            return False
        refined = refine(self.bootstrap.keyframes)
        if refined is None:
            return False
        self.bootstrap.replace(refined)
        return True


@dataclass
class ScanToMapFrontEnd(FrontEnd[K]):
    """Front end of a method that matches each scan to its map.

    Attributes:
        estimate: `T_map_base` and its covariance.
        matched: scans with a match.
        unmatched: scans with too few walls in view.
        path: poses of the keyframes.
        scans: poses of all scans relative to them.
        stamp: of the last scan, seconds.
    """

    estimate: PoseEstimate = field(default_factory=lambda: PoseEstimate(Pose2(), np.zeros((3, 3))))
    matched: int = 0
    unmatched: int = 0
    path: list[Pose2] = field(default_factory=list)
    scans: KeyframeTrajectory = field(default_factory=KeyframeTrajectory)
    stamp: float = -math.inf

    @property
    def pose(self) -> Pose2:
        """`T_map_base`."""
        return self.estimate.pose

    def match(
        self,
        scan: LeveledScan,
        prior: PoseEstimate,
        register: Callable[[LeveledScan, PoseEstimate, float], Registered],
    ) -> Match | None:
        """Set the estimate to the registered pose, or without a match to the prior.

        Args:
            scan: Leveled scan.
            prior: Estimate by dead reckoning.
            register: Function of scan, prior and the seconds since the scan before that matches the scan to
                the map; `estimate` is still that of the scan before.
        """
        seconds, self.stamp = scan.stamp - self.stamp, scan.stamp
        self.reckoned_yaw += wrap_angle(prior.pose.yaw - self.pose.yaw)
        if not self.path:
            self.estimate = prior
            return None
        estimate, match = register(scan, prior, seconds)
        if scan.leveled:
            score, yaw = (None, 0.0) if match is None else (match.score, float(match.pose[2]))
            self.observe_localizability(score, yaw, seconds)
        self.estimate = estimate if self.localizability.believed else prior
        self.matched += match is not None
        self.unmatched += match is None
        return match

    def fits(self, match: Match | None) -> bool:
        """Return whether a scan may enter the map by its match."""
        return self.observe_fit(None, 1.0) if match is None else self.observe_fit(match.score, match.known)

    def enter(self, keyframe: K, refine: Refine[K]) -> bool:
        """Add a keyframe; return whether the start was refined, and path and estimate corrected."""
        self.path.append(keyframe.pose)
        refined = self.refine_start(keyframe, refine)
        if refined:
            start = self.bootstrap.keyframes
            self.path[: len(start)] = [keyframe.pose for keyframe in start]
            T_new_old = self.path[-1] @ keyframe.pose.inverse()
            self.estimate = PoseEstimate(T_new_old @ keyframe.pose, self.estimate.covariance)
        return refined

    def note(self, stamp: float) -> Pose2:
        """Add the scan to the trajectory; return `T_map_base`."""
        last = self.path[-1].inverse() @ self.pose if self.path else self.pose
        self.scans.add(stamp, len(self.path) - 1, last)
        return self.pose
