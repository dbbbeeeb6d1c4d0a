"""Front end of the planar mappers: the shared steps between a scan and the map.

Each scan is leveled, its pose is predicted by dead reckoning, and two monitors decide whether to use the
method's match and whether the scan may enter the map. On uneven ground the start of the map is refined.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from lirs_wct.geometry import Imu, LaserScan, Pose2, wrap_angle
from slam_baselines.leveling import LeveledScan, ScanLeveler
from slam_baselines.mapper import MapperStats, Stopwatch, check_motion, required_odometry
from slam_baselines.mapping.bootstrap import Bootstrap, BootstrapConfig
from slam_baselines.mapping.ground_filter import GroundFilter
from slam_baselines.mapping.keyframe import Keyframe, KeyframeTrajectory
from slam_baselines.matching.localizability import LocalizabilityConfig, LocalizabilityMonitor
from slam_baselines.matching.registration import Match
from slam_baselines.matching.tracking_monitor import TrackingConfig, TrackingMonitor
from slam_baselines.motion.dead_reckoning import DeadReckoning, MotionStep, PoseEstimate

K = TypeVar("K", bound=Keyframe[Any])


class PlanarMapper(ABC):
    """Estimator of a pose from planar scans that counts and times them.

    Attributes:
        name: of the method, as in MAPPERS.
        requires_odometry: whether scans without odometry are refused.
        received: scans so far.
        lost_scans: scans during which the pose was unknown.
    """

    name = ""
    requires_odometry = False

    def __init__(self) -> None:
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
        """Whether the pose is unknown; always False for a method without a monitor."""
        return False

    @property
    def stats(self) -> MapperStats:
        """Counts, times and memory so far."""
        times = self._stopwatch.summary()
        return replace(self.counts(), received=self.received, lost=self.lost_scans, **times)


@dataclass(frozen=True, kw_only=True)
class FrontEndConfig:
    """Parameters of the front end, from those of the method.

    Attributes:
        tracking: fit of scans to the map below which they do not enter it.
        localizability: conditions for using matches on uneven ground.
        bootstrap: when the start is refined.
        clear_range: range up to which a beam without return is free, meters.
        max_range: range from which on hits are not used, meters.
    """

    tracking: TrackingConfig
    localizability: LocalizabilityConfig
    bootstrap: BootstrapConfig = field(default_factory=BootstrapConfig)
    clear_range: float = 0.0
    max_range: float = math.inf


class FrontEnd(PlanarMapper, Generic[K]):
    """Leveling, ground filter, monitors and start-up refinement.

    Attributes:
        leveler: of scans.
        ground_filter: separates ground from walls.
        localizability: monitor of the matches to walls; observes scans whose attitude is known.
        tracking: monitor of the scans that contradict the map.
        bootstrap: schedule of the start-up refinement, with its keyframes.
        reckoned_yaw: yaw by dead reckoning since the start, radians.
    """

    def __init__(self, config: FrontEndConfig, ground_filter: GroundFilter) -> None:
        super().__init__()
        self.leveler = ScanLeveler(config.clear_range, config.max_range)
        self.ground_filter = ground_filter
        self.localizability = LocalizabilityMonitor(config.localizability)
        self.tracking = TrackingMonitor(config.tracking)
        self.bootstrap: Bootstrap[K] = Bootstrap(config.bootstrap)
        self.reckoned_yaw = 0.0

    @property
    def lost(self) -> bool:
        """Whether too many scans in a row contradict the map."""
        return self.tracking.lost

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

    def refine_start(self, newest: K) -> bool:
        """Keep a keyframe for the start-up refinement; refine when due, and return whether it was.

        Only where the attitude is known: on a floor the start needs no refinement.
        """
        driven = self.ground_filter.distance_traveled
        if not newest.scan.leveled or not self.bootstrap.add(newest, driven):
            return False
        refined = self.refine(self.bootstrap.keyframes)
        if refined is None:
            return False
        self.bootstrap.replace(refined)
        return True

    @abstractmethod
    def refine(self, keyframes: list[K]) -> list[K] | None:
        """Build the map again from its first keyframes.

        Return the keyframes with their new poses, None if not possible.
        """


class Registered(NamedTuple):
    """Result of a registration.

    Attributes:
        estimate: of the pose; the prior without a match.
        match: of the scan; None with too few walls in view.
    """

    estimate: PoseEstimate
    match: Match | None


class ScanToMapFrontEnd(FrontEnd[K]):
    """Front end of a method that matches each scan to its map.

    Attributes:
        reckoning: dead reckoning.
        estimate: `T_map_base` and its covariance.
        matched: scans with a match.
        unmatched: scans with too few walls in view.
        distance_traveled: meters.
        path: poses of the keyframes.
        scans: poses of all scans relative to them.
    """

    def __init__(self, config: FrontEndConfig, ground_filter: GroundFilter, reckoning: DeadReckoning) -> None:
        super().__init__(config, ground_filter)
        self.reckoning = reckoning
        self.estimate = PoseEstimate(Pose2(), np.zeros((3, 3)))
        self.matched = self.unmatched = 0
        self.distance_traveled = 0.0
        self.path: list[Pose2] = []
        self.scans = KeyframeTrajectory()
        self._stamp = -math.inf

    @abstractmethod
    def register(self, scan: LeveledScan, prior: PoseEstimate, seconds: float) -> Registered:
        """Match a scan to the map.

        Args:
            scan: leveled.
            prior: the estimate by dead reckoning; `estimate` is still that of the scan before.
            seconds: since the scan before.
        """

    @abstractmethod
    def due(self, scan: LeveledScan) -> bool:
        """Return whether the robot has moved enough since the last keyframe."""

    @abstractmethod
    def insert(self, scan: LeveledScan, pose: Pose2) -> K:
        """Enter a scan into the map; return its keyframe."""

    @abstractmethod
    def add_motion(self, scan: LeveledScan, step: MotionStep | None) -> None:
        """Add a step by dead reckoning to the motion since the last keyframe."""

    def use_match(self, match: Match | None, before: Pose2) -> bool:
        """Return whether the height of the base follows from a registered pose.

        Args:
            match: of the scan.
            before: pose of the scan before.
        """
        return self.localizability.localizable

    def move_base(self, scan: LeveledScan, step: Pose2, *, registered: bool) -> None:
        """Update the height of the base by its step."""
        if scan.leveled:
            self.ground_filter.move(step, scan, registered=registered)

    def process(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        """Match a scan to the map, enter it if due; return `T_map_base`."""
        level, before = self.leveler.level(scan, imu), self.estimate.pose
        step = self.reckoning.step(odometry, imu, scan.stamp)
        self.add_motion(level, step)
        match = self._match(level, self.estimate if step is None else step.after(self.estimate))
        registered = self.use_match(match, before)
        self.distance_traveled += before.distance(self.estimate.pose)
        self.move_base(level, before.inverse() @ self.estimate.pose, registered=registered)
        fits = self.observe_fit(None, 1.0) if match is None else self.observe_fit(match.score, match.known)
        if fits and self.due(level):
            self._enter(level)
        last = self.path[-1].inverse() @ self.estimate.pose if self.path else self.estimate.pose
        self.scans.add(scan.stamp, len(self.path) - 1, last)
        return self.estimate.pose

    def _match(self, scan: LeveledScan, prior: PoseEstimate) -> Match | None:
        """Set the estimate to the registered pose or the prior."""
        seconds, self._stamp = scan.stamp - self._stamp, scan.stamp
        self.reckoned_yaw += wrap_angle(prior.pose.yaw - self.estimate.pose.yaw)
        if not self.path:
            self.estimate = prior
            return None
        estimate, match = self.register(scan, prior, seconds)
        if scan.leveled:
            score, yaw = (None, 0.0) if match is None else (match.score, float(match.pose[2]))
            self.observe_localizability(score, yaw, seconds)
        self.estimate = estimate if self.localizability.believed else prior
        self.matched += match is not None
        self.unmatched += match is None
        return match

    def _enter(self, scan: LeveledScan) -> None:
        """Make the scan a keyframe; correct the estimate if the start was refined."""
        pose = self.estimate.pose
        self.path.append(pose)
        if self.refine_start(self.insert(scan, pose)):
            refined: Sequence[K] = self.bootstrap.keyframes
            self.path[: len(refined)] = [keyframe.pose for keyframe in refined]
            T_new_old = self.path[-1] @ pose.inverse()
            self.estimate = PoseEstimate(T_new_old @ pose, self.estimate.covariance)
            self.correct_pose(self.estimate.pose)

    @abstractmethod
    def correct_pose(self, pose: Pose2) -> None:
        """Correct the pose of the last keyframe."""
