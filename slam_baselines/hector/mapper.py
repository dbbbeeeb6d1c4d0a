"""HectorSLAM: match each scan to the map by Gauss-Newton, then enter it.

Kohlbrecher et al. 2011, "A flexible and scalable SLAM system with full 3D motion estimation", written
from the paper. Beyond it: the odometry is a prior and not only a start, a poor match leads to a search
in a wider window, a scan that fits nowhere does not enter the map, and a filter separates ground from walls.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from lirs_wct.errors import ConfigError
from lirs_wct.field_validators import require_within
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.pose import Pose2, wrap_angle
from lirs_wct.geometry.scan import Imu, LaserScan
from lirs_wct.geometry.trajectory import Trajectory
from slam_baselines.hector.bootstrap import HectorKeyframe, refine
from slam_baselines.mapper import MapperStats, Stopwatch
from slam_baselines.mapping.bootstrap import Bootstrap, BootstrapConfig
from slam_baselines.mapping.keyframe import Keyframe, KeyframeTrajectory
from slam_baselines.mapping.map_builder import BuilderConfig, MapBuilder
from slam_baselines.matching.gauss_newton import Match
from slam_baselines.matching.localizability import LocalizabilityConfig, LocalizabilityMonitor
from slam_baselines.matching.registration import Registration, RegistrationConfig
from slam_baselines.matching.tracking_monitor import TrackingConfig, TrackingMonitor
from slam_baselines.motion.calibration import CalibrationConfig
from slam_baselines.motion.dead_reckoning import DeadReckoning, MotionConfig, OdometryStep, PoseEstimate
from slam_baselines.scan.leveling import LeveledScan, ScanLeveler

WARM_UP = {"sparse_distance": 0.1}
"""Configuration with which a short drive reaches every kernel: the scans are sparse."""


REFINED_SHARE = 0.55
"""Share of the keyframes that must fit for a refined start: the first ones see few known walls."""


@dataclass(frozen=True, kw_only=True)
class HectorConfig(BuilderConfig):
    """Parameters, under hector_mapping's names where they exist.

    Attributes:
        motion: confidence in the odometry.
        calibration: rates at which the odometry's systematic errors are learned.
        registration: of a scan in the map.
        localizability: conditions for using matches on uneven ground.
        learning_steps: steps after which the calibration is used where there are no walls.
        bootstrap: when the map is built again.
        laser_max_dist: hits farther away are not used, meters.
        laser_clear_dist: range up to which a beam without return is free, meters.
        tracking: mean occupancy at the ends of the beams below which a scan does not enter the map.

    Raises:
        ConfigError: lost_score above search_threshold, or iterations not given for each level.
    """

    # The calibration learns slides. Standing wheels have no error; the stamps of logs are not reliable.
    motion: MotionConfig = field(
        default_factory=lambda: MotionConfig(
            slide_per_radian=1.0, translation_per_second=1e-5, rotation_per_second=1e-5
        )
    )
    calibration: CalibrationConfig = field(default_factory=CalibrationConfig)
    registration: RegistrationConfig = field(default_factory=RegistrationConfig)
    localizability: LocalizabilityConfig = field(default_factory=LocalizabilityConfig)
    learning_steps: int = 300
    bootstrap: BootstrapConfig = field(default_factory=BootstrapConfig)
    laser_max_dist: float = math.inf
    laser_clear_dist: float = 0.0
    tracking: TrackingConfig = field(default_factory=TrackingConfig)

    def __post_init__(self) -> None:
        super().__post_init__()
        r = self.registration
        require_within(self.tracking, f"(0, {r.search_threshold}]", "lost_score", of="the tracking")
        if len(r.match.iterations) < self.map_multi_res_levels:
            raise ConfigError(
                f"iterations are needed for {self.map_multi_res_levels} levels, got {r.match.iterations}"
            )


class HectorMapper:
    """Scan-to-map matching in one map, without loop closure."""

    requires_odometry = False

    def __init__(self, config: HectorConfig | None = None) -> None:
        self.config = config or HectorConfig()
        self._leveler = ScanLeveler(self.config.laser_clear_dist, self.config.laser_max_dist)
        self._reckoning = DeadReckoning(self.config.motion, self.config.calibration)
        self._registration = Registration(self.config.registration)
        self._builder = MapBuilder(self.config)
        self._bootstrap: Bootstrap[HectorKeyframe] = Bootstrap(self.config.bootstrap)
        self._estimate = PoseEstimate(Pose2(), np.zeros((3, 3)))
        self._keyframes: list[Pose2] = []
        self._scans = KeyframeTrajectory()
        self._motion: list[OdometryStep | None] = []
        self._received = self._matched = self._unmatched = self._lost_scans = 0
        self._tracking = TrackingMonitor(self.config.tracking)
        self._localizability = LocalizabilityMonitor(self.config.localizability)
        self._registered = False
        self._reckoned_yaw = 0.0
        self._stamp = -math.inf
        self._earlier: Pose2 | None = None
        self._stopwatch = Stopwatch()

    @property
    def resolution(self) -> float:
        """Edge of a cell of the map, meters."""
        return self.config.map_resolution

    def update(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        """Match the scan to the map, enter it, return `T_map_base`."""
        started = self._stopwatch.start()
        level = self._leveler.level(scan, imu)
        expected = self._reckoning.predict(self._estimate, odometry, imu, scan.stamp)
        if level.leveled and not self._bootstrap.over:
            self._motion.append(self._reckoning.increment)
        seconds, self._stamp = scan.stamp - self._stamp, scan.stamp
        match = self._match(level, expected, seconds)
        self._builder.move_base(level, self._estimate.pose, registered=self._registered)
        if self._fits(match) and self._builder.due(level, self._estimate.pose):
            self._enter(level)
        last = self._keyframes[-1] if self._keyframes else Pose2()
        self._scans.add(scan.stamp, len(self._keyframes) - 1, last.inverse() @ self._estimate.pose)
        self._stopwatch.stop(started)
        return self._estimate.pose

    def map(self) -> OccupancyGrid:
        """Return the finest level of the map; without walls if dead reckoning placed most of them."""
        driven = self._builder.ground_filter.distance_traveled
        return self._builder.map(walls=self._localizability.draws(driven))

    def trajectory(self) -> Trajectory:
        """Return the pose of every scan, by stamp."""
        return self._scans.trajectory(self._keyframes)

    @property
    def lost(self) -> bool:
        """Whether too many scans in a row contradict the map."""
        return self._tracking.lost

    @property
    def stats(self) -> MapperStats:
        """Counts, times and memory so far."""
        return MapperStats(
            received=self._received,
            used=self._matched,
            skipped={"too few walls in view to match": self._unmatched} if self._unmatched else {},
            lost=self._lost_scans,
            memory=self._builder.memory,
            counts={
                "map_updates": self._builder.updates,
                "searches": self._registration.searches,
                "second_looks": self._bootstrap.refinements,
            },
            **self._stopwatch.summary(),
        )

    def _match(self, scan: LeveledScan, expected: PoseEstimate, seconds: float) -> Match | None:
        """Set the estimate to the registered pose, or to the expected one without a match."""
        before, self._estimate = self._estimate.pose, expected
        self._received += 1
        self._registered = False
        self._reckoned_yaw += wrap_angle(expected.pose.yaw - before.yaw)
        if self._builder.updates == 0:
            return None
        weights = self._builder.match_weights(scan, expected.pose)
        found, match = self._registration.register(
            self._builder.pyramid, scan.hits, weights, expected, before, self._earlier
        )
        self._earlier = before
        if scan.leveled:
            self._observe_localizability(match, seconds)
        self._believe(match, found, before)
        if match is None:
            self._unmatched += 1
        else:
            self._matched += 1
        return match

    def _observe_localizability(self, match: Match | None, seconds: float) -> None:
        """Update the localizability monitor, and switch the odometry's calibration on or off."""
        off = 0.0 if match is None else wrap_angle(match.pose[2] - self._reckoned_yaw)
        self._localizability.observe(None if match is None else match.score, off, seconds)
        mature = self._reckoning.learned >= self.config.learning_steps
        self._reckoning.calibrated = self._localizability.steady or mature

    def _believe(self, match: Match | None, found: PoseEstimate, before: Pose2) -> None:
        """Accept the registered pose if matches localize the robot; calibrate the odometry."""
        c, leveled = self.config, self._localizability.scans > 0
        if match is None or not self._localizability.believed:
            return
        self._estimate = found
        needed = c.localizability.score if leveled else c.registration.search_threshold
        self._registered = match.score >= needed
        if self._registered:
            self._reckoning.learn(before, found.pose)

    def _fits(self, match: Match | None) -> bool:
        """Return whether the scan may enter the map.

        Where the attitude is known, a poor match does not count until walls are proven: the earlier scans may
        show hillsides, and dead reckoning is used.
        """
        poor = match is not None and match.score < self.config.tracking.lost_score
        if match is None or (poor and self._localizability.scans and not self._localizability.proven):
            return self._tracking.observe(None)
        fits = self._tracking.observe(match.score, match.known)
        self._lost_scans += self.lost
        return fits

    def _enter(self, scan: LeveledScan) -> None:
        """Make the scan a keyframe; refine all keyframes when due."""
        builder, pose = self._builder, self._estimate.pose
        min_slopes = builder.enter(scan, pose)
        self._keyframes.append(pose)
        if not scan.leveled:
            return
        ground, bootstrap = builder.ground_filter, self._bootstrap
        keyframe: HectorKeyframe = Keyframe(scan, pose, ground.height, min_slopes, tuple(self._motion))
        self._motion.clear()
        if bootstrap.add(keyframe, ground.distance_traveled):
            localizability = LocalizabilityMonitor(replace(self.config.localizability, share=REFINED_SHARE))
            bootstrap.replace(
                refine(bootstrap.keyframes, builder, self._registration, self._reckoning, localizability)
            )
            self._keyframes[: len(bootstrap.keyframes)] = [k.pose for k in bootstrap.keyframes]
            T_new_old = self._keyframes[-1] @ pose.inverse()
            self._estimate = PoseEstimate(T_new_old @ pose, self._estimate.covariance)
            builder.correct_pose(self._estimate.pose)
