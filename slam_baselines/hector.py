"""HectorSLAM: match each scan to the map by Gauss-Newton, then enter it.

Kohlbrecher et al. 2011, "A flexible and scalable SLAM system with full 3D motion estimation", written
from the paper. Beyond it: the odometry is a prior and not only a start, a poor match leads to a search
in a wider window, a scan that fits nowhere does not enter the map, and a filter separates ground from walls.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from lirs_wct.checks import require_within
from lirs_wct.errors import ConfigError
from lirs_wct.geometry import Imu, LaserScan, OccupancyGrid, Pose2, Trajectory
from slam_baselines.dead_reckoning import (
    CalibrationConfig,
    DeadReckoning,
    MotionConfig,
    OdometryStep,
    PoseEstimate,
)
from slam_baselines.front_end import (
    BootstrapConfig,
    Keyframe,
    PlanarMapper,
    Registered,
    ScanToMapFrontEnd,
    register_forwards,
)
from slam_baselines.leveling import LeveledScan
from slam_baselines.map_builder import BuilderConfig, MapBuilder
from slam_baselines.mapper import MapperStats
from slam_baselines.monitors import LocalizabilityConfig, LocalizabilityMonitor, TrackingConfig
from slam_baselines.registration import Match, Registration, RegistrationConfig

WARM_UP = {"sparse_distance": 0.1}
"""Configuration with which a short drive reaches every kernel: the scans are sparse."""
REFINED_SHARE = 0.55
"""Share of the keyframes that must fit for a refined start: the first ones see few known walls."""
HectorKeyframe = Keyframe[tuple[OdometryStep | None, ...]]
"""Keyframe whose motion is that by odometry, scan by scan; None without odometry."""


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


class HectorMapper(PlanarMapper):
    """Scan-to-map matching in one map, without loop closure.

    Attributes:
        config: its parameters.
        front: front end, with the present estimate.
        reckoning: dead reckoning.
    """

    name = "hector"

    def __init__(self, config: HectorConfig | None = None) -> None:
        self.config = c = config or HectorConfig()
        self._builder = MapBuilder(c)
        self.front = ScanToMapFrontEnd[HectorKeyframe].make(
            self._builder.ground_filter, c.tracking, c.localizability, c.bootstrap,
            c.laser_clear_dist, c.laser_max_dist,
        )  # fmt: skip
        super().__init__(self.front.tracking)
        self.reckoning = DeadReckoning(c.motion, c.calibration)
        self._registration = Registration(c.registration)
        self._motion: list[OdometryStep | None] = []
        self._earlier: Pose2 | None = None

    @property
    def resolution(self) -> float:
        """Edge of a cell of the map, meters."""
        return self.config.map_resolution

    def process(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        """Level a scan, predict its pose, register it, monitor the match and insert it if due."""
        front, builder = self.front, self._builder
        level, before = front.leveler.level(scan, imu), front.pose
        prior = self._predict(level, odometry, imu)
        match = front.match(level, prior, self._register)
        registered = self._calibrate(level, match, before)
        builder.move_base(level, before.inverse() @ front.pose, registered=registered)
        if front.fits(match) and builder.motion_filter.due(level, front.pose):
            self._insert(level)
        return front.note(scan.stamp)

    def map(self) -> OccupancyGrid:
        """Return the finest level, without walls if dead reckoning placed most."""
        return self._builder.map(walls=self.front.draws_walls)

    def trajectory(self) -> Trajectory:
        """Return the pose of every scan, by stamp."""
        return self.front.scans.trajectory(self.front.path)

    def counts(self) -> MapperStats:
        """Return used and skipped scans, memory and other counts."""
        front = self.front
        return MapperStats(
            used=front.matched,
            skipped={"too few walls in view to match": front.unmatched} if front.unmatched else {},
            memory=self._builder.memory,
            counts={
                "map_updates": self._builder.updates,
                "searches": self._registration.searches,
                "second_looks": front.bootstrap.refinements,
            },
        )

    def _predict(self, scan: LeveledScan, odometry: Pose2 | None, imu: Imu | None) -> PoseEstimate:
        """Return the estimate by dead reckoning; keep its steps for the start-up refinement."""
        step = self.reckoning.step(odometry, imu, scan.stamp)
        if scan.leveled and not self.front.bootstrap.over:
            self._motion.append(self.reckoning.increment)
        return self.front.estimate if step is None else step.after(self.front.estimate)

    def _register(self, scan: LeveledScan, prior: PoseEstimate, seconds: float) -> Registered:
        """Match a scan to the map by Gauss-Newton from coarse to fine."""
        weights, before = self._builder.match_weights(scan, prior.pose), self.front.pose
        estimate, match = self._registration.register(
            self._builder.pyramid, scan.hits, weights, prior, before, self._earlier
        )
        self._earlier = before
        return estimate, match

    def _calibrate(self, scan: LeveledScan, match: Match | None, before: Pose2) -> bool:
        """Switch the odometry's calibration, let it learn from a good match."""
        c, reckoning, localizability = self.config, self.reckoning, self.front.localizability
        if scan.leveled and self.front.path:
            reckoning.calibrated = localizability.steady or reckoning.learned >= c.learning_steps
        needed = c.localizability.score if localizability.scans > 0 else c.registration.search_threshold
        good = match is not None and localizability.believed and match.score >= needed
        if good:
            reckoning.learn(before, self.front.pose)
        return good

    def _insert(self, scan: LeveledScan) -> None:
        """Update all levels of the map by a scan; refine the start when due."""
        pose = self.front.pose
        min_slopes, motion = self._builder.enter(scan, pose), tuple(self._motion)
        self._motion.clear()
        keyframe = Keyframe(scan, pose, self.front.ground_filter.height, min_slopes, motion)
        if self.front.enter(keyframe, self._refine):
            self._builder.motion_filter.correct_pose(self.front.pose)

    def _refine(self, keyframes: list[HectorKeyframe]) -> list[HectorKeyframe]:
        """Build the map again from keyframes; return them with their new poses.

        Forwards, since the odometry's calibration makes dead reckoning from the start as good as the walls.
        If too few keyframes fit, no walls are known yet: keyframes and map stay unchanged.
        """
        builder, before_refinement = self._builder, self._builder.restart()
        localizability = LocalizabilityMonitor(replace(self.config.localizability, share=REFINED_SHARE))
        found: list[HectorKeyframe] = []

        def register(now: HectorKeyframe, before: HectorKeyframe | None, last: PoseEstimate) -> PoseEstimate:
            estimate = last if before is None else self._reckon(last, before, now)
            slopes = builder.min_slopes(now.scan, estimate.pose, now.height, now.min_slopes)
            if before is not None:
                weights = builder.weights(slopes)
                estimate, match = self._registration.register(
                    builder.pyramid, now.scan.hits, weights, estimate, last.pose
                )
                score, seconds = None if match is None else match.score, now.scan.stamp - before.scan.stamp
                localizability.observe(score, 0.0, seconds)
            builder.enter_again(now.scan, estimate.pose, now.height, slopes)
            found.append(replace(now, pose=estimate.pose, min_slopes=slopes))
            return estimate

        register_forwards(keyframes, register)
        if builder.flat or localizability.localizable:
            return found
        builder.pyramid = before_refinement
        return keyframes

    def _reckon(self, last: PoseEstimate, before: HectorKeyframe, now: HectorKeyframe) -> PoseEstimate:
        """Predict the next keyframe by dead reckoning; without odometry, by their first poses."""
        motion, calibration = self.reckoning.config, self.reckoning.calibration
        seconds = now.scan.stamp - before.scan.stamp
        if not now.motion or None in now.motion:
            return motion.predict(last, before.pose.inverse() @ now.pose, seconds)
        steps = [(i.correct(calibration), i.tilt) for i in now.motion if i is not None]
        return motion.predict_all(last, steps, seconds / len(steps))
