"""Front end of the planar mappers: the shared steps between a scan and the map.

Each scan is leveled, its pose is predicted by dead reckoning, and two monitors decide whether to use the
method's match and whether the scan may enter the map. On uneven ground the start of the map is refined.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Generic, Self, TypeVar

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
from slam_baselines.motion.dead_reckoning import PoseEstimate

K = TypeVar("K", bound=Keyframe[Any])
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
