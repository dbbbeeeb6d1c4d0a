"""HectorSLAM: match each scan to the map by Gauss-Newton, then enter it.

Kohlbrecher et al. 2011, "A flexible and scalable SLAM system with full 3D motion estimation", written
from the paper. Beyond it: the odometry is a prior and not only a start, a poor match leads to a search
in a wider window, a scan that fits nowhere does not enter the map, and a filter separates ground from walls.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from lirs_wct.errors import ConfigError, limited, within
from lirs_wct.geometry import Imu, LaserScan, OccupancyGrid, Pose2, Trajectory
from slam_baselines.dead_reckoning import (
    CalibrationConfig,
    DeadReckoning,
    MotionConfig,
    OdometryStep,
    PoseEstimate,
)
from slam_baselines.front_end import (
    REFINED_SHARE,
    BuilderConfig,
    FrontEnd,
    FrontEndConfig,
    Keyframe,
    MapBuilder,
    StartUp,
)
from slam_baselines.leveling import LeveledScan
from slam_baselines.mapper import MapperStats, PlanarMapper
from slam_baselines.registration import Match, Registration, RegistrationConfig, ScanMatcher

WARM_UP = {"sparse_distance": 0.1}
"""Configuration with which a short drive reaches every kernel: the scans are sparse."""


@dataclass(frozen=True, kw_only=True)
class HectorConfig(
    FrontEndConfig, BuilderConfig, RegistrationConfig, MotionConfig, CalibrationConfig, of="hector"
):
    """Parameters, under hector_mapping's names where they exist.

    Attributes:
        match_iterations: Largest numbers of Gauss-Newton steps on each level, finest first.
        learning_steps: Number of steps after which the calibration is used where there are no walls.
        laser_max_dist: Range from which on hits are not used, meters.
        laser_clear_dist: Range up to which a beam without return is free, meters.

    Raises:
        ConfigError: a value is not legal, or match_iterations are not given for each level.
    """

    # The calibration learns slides. Standing wheels have no error; the stamps of logs are not reliable.
    translation_per_second: float = limited(1e-5, "(0, inf]")
    rotation_per_second: float = limited(1e-5, "(0, inf]")
    match_iterations: tuple[int, ...] = (5, 3, 3)
    learning_steps: int = 300
    laser_max_dist: float = math.inf
    laser_clear_dist: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        within("[1, inf]")(min(self.match_iterations), "match_iterations on each level")
        if len(self.match_iterations) < self.map_multi_res_levels:
            raise ConfigError(
                f"match_iterations are needed for {self.map_multi_res_levels} levels, "
                f"got {self.match_iterations}"
            )


@dataclass(frozen=True, slots=True)
class HectorKeyframe(Keyframe):
    """Keyframe with the steps since the one before, scan by scan; None without odometry."""

    motion: tuple[OdometryStep | None, ...]


class HectorMapper(PlanarMapper):
    """Scan-to-map matching in one map, without loop closure."""

    name = "hector"

    def __init__(self, config: HectorConfig | None = None) -> None:
        super().__init__()
        self.config = c = config or HectorConfig()
        self.front = FrontEnd(c, c.laser_clear_dist, c.laser_max_dist, c.map_resolution)
        self.reckoning = DeadReckoning(c, c)
        self._builder = MapBuilder(c)
        self._registration = Registration(c, ScanMatcher(c.match_iterations))
        self._start = StartUp[HectorKeyframe](c)
        self._motion: list[OdometryStep | None] = []
        self._earlier: Pose2 | None = None

    def process(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        """Level a scan, predict, register and monitor it; insert it if due."""
        front, builder, last, match = self.front, self._builder, self.front.estimate, None
        before = last.pose
        level = front.leveler.level(scan, imu)
        estimate = prior = self.reckoning.predict(front.estimate, odometry, imu, scan.stamp)
        if level.leveled and not self._start.over:
            self._motion.append(self.reckoning.increment)
        if front.path:  # the first scan has no map
            weights = builder.match_weights(level, prior.pose)
            trusted = front.monitors.localizability.trusted_score
            estimate, match = self._registration.register(
                builder.pyramid, level.hits, weights, prior, last, self._earlier, trusted_score=trusted
            )
            self._earlier = before
        fits = front.monitor(level, prior, estimate, match, floor=builder.flat)
        self.lost, self.covariance = front.monitors.tracking.lost, front.drift.covariance
        pose = front.estimate.pose
        registered = self._calibrate(level, match, before)
        builder.move_base(level, before.inverse() @ pose, registered=registered)
        if fits and builder.motion_filter.due(level, pose):
            self._insert(level, pose)
        return front.note(scan.stamp)

    def map(self) -> OccupancyGrid:
        """Return the finest level, without walls if dead reckoning placed most."""
        driven = self._builder.ground_filter.distance_traveled
        return self._builder.map(walls=self.front.monitors.localizability.draws(driven))

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
                "second_looks": self._start.refinements,
            },
        )

    def _calibrate(self, scan: LeveledScan, match: Match | None, before: Pose2) -> bool:
        """Calibrate the odometry by a good match; return whether it is good."""
        c, reckoning, localizability = self.config, self.reckoning, self.front.monitors.localizability
        if scan.leveled and self.front.path:
            reckoning.calibrated = localizability.steady or reckoning.learned >= c.learning_steps
        needed = c.localizable_score if localizability.scans > 0 else c.search_threshold
        good = match is not None and localizability.believed and match.score >= needed
        if good:
            reckoning.learn(before, self.front.estimate.pose)
        return good

    def _insert(self, scan: LeveledScan, pose: Pose2) -> None:
        """Update all levels of the map by a scan; refine the start when due."""
        front, builder = self.front, self._builder
        min_slopes, height = builder.enter(scan, pose), builder.ground_filter.height
        front.add_keyframe(scan, pose)
        keyframe = HectorKeyframe(scan, pose, height, min_slopes, tuple(self._motion))
        self._motion.clear()
        if self._start.add(keyframe, builder.ground_filter.distance_traveled):
            self._start.replace(self._refine(self._start.keyframes))
            front.replace_start(self._start.keyframes)
            builder.motion_filter.correct_pose(front.estimate.pose)

    def _refine(self, keyframes: list[HectorKeyframe]) -> list[HectorKeyframe]:
        """Build the map again from keyframes; return them with their new poses.

        Forwards, since the odometry's calibration makes dead reckoning from the start as good as the walls.
        If too few fit, more on a floor where every hit is a wall, keyframes and map stay unchanged.
        """
        builder, before_refinement = self._builder, self._builder.restart()
        estimate, refined = PoseEstimate(keyframes[0].pose, np.zeros((3, 3))), list[HectorKeyframe]()
        registration, fits = self._registration.again(), 0
        for k, now in enumerate(keyframes):
            last = estimate
            if k > 0:
                estimate = self._reckon(last, keyframes[k - 1], now)
            slopes = builder.min_slopes(now.scan, estimate.pose, now.height, now.min_slopes)
            if k > 0:
                weights = builder.weights(slopes)
                estimate, match = registration.register(
                    builder.pyramid, now.scan.hits, weights, estimate, last, trusted_score=math.inf
                )
                fits += match is not None and match.score >= self.config.localizable_score
            builder.enter_again(now.scan, estimate.pose, now.height, slopes)
            refined.append(replace(now, pose=estimate.pose, min_slopes=slopes))
        if fits >= (self.config.localizable_share if builder.flat else REFINED_SHARE) * (len(keyframes) - 1):
            return refined
        builder.pyramid = before_refinement
        return keyframes

    def _reckon(self, last: PoseEstimate, before: HectorKeyframe, now: HectorKeyframe) -> PoseEstimate:
        """Predict the next keyframe by dead reckoning; without odometry, by their first poses."""
        calibration, seconds = self.reckoning.calibration, now.scan.stamp - before.scan.stamp
        if not now.motion or None in now.motion:
            return self.config.step(before.pose.inverse() @ now.pose, seconds).after(last)
        steps = [(calibration.correct(i.step, i.down), i.tilt) for i in now.motion if i is not None]
        return self.config.predict_all(last, steps, seconds / len(steps))
