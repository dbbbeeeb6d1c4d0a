"""GMapping: a Rao-Blackwellized particle filter with a scan-matched proposal.

Grisetti, Stachniss, Burgard 2007, "Improved Techniques for Grid Mapping with Rao-Blackwellized Particle
Filters", written from the paper: every particle is a path with the map that follows from it; algorithm 1
is GmappingMapper.process.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lirs_wct.geometry import (
    ByteArray,
    FloatArray,
    Imu,
    LaserScan,
    OccupancyGrid,
    Pose2,
    Trajectory,
    in_axes_of,
    wrap_angle,
    wrap_angles,
)
from slam_baselines.dead_reckoning import DriftCovariance, PoseEstimate
from slam_baselines.front_end import LEVER, REFINED_SHARE, Keyframe, StartUp
from slam_baselines.gmapping.config import GmappingConfig
from slam_baselines.gmapping.copy_on_write_map import PatchMaps
from slam_baselines.gmapping.motion import GyroBias, GyroBiasConfig, MotionIncrement, propagate, remove_bias
from slam_baselines.gmapping.particles import Particles, normalize
from slam_baselines.gmapping.proposal import Proposal, Proposer
from slam_baselines.gmapping.scan_matching import ScanBeams
from slam_baselines.ground_filter import IN_FULL, GroundFilter, Limits
from slam_baselines.leveling import LeveledScan, ScanLeveler, ScanPoints, interpolate_hits
from slam_baselines.mapper import MapperStats, PlanarMapper
from slam_baselines.monitors import Monitors
from slam_baselines.occupancy_map import NO_WALL
from slam_baselines.registration import ReckoningWindow

__all__ = ["GmappingConfig", "GmappingMapper"]


class ParticleFilter(Particles[PatchMaps]):
    """All particles, and the turn of the best one to the last processed scan, radians."""

    def __init__(self, config: GmappingConfig) -> None:
        super().__init__(PatchMaps(config.particles, config.delta))
        self._config = config
        self._rng = np.random.default_rng(config.seed)
        self.proposer = Proposer(config)
        self.turned = 0.0

    def match_best(
        self, beams: ScanBeams, increment: MotionIncrement, wall_slope: int, *, wide: bool = False
    ) -> Pose2 | None:
        """Return `T_processed_now` by a match to the best map; None without a fit nearby."""
        view, expected = self.maps.view(self.best, wall_slope), self.pose @ increment.pose
        found = self.proposer.match_scan(view, beams, expected.as_array(), increment.newest, wide=wide)
        return None if found is None else self.pose.inverse() @ Pose2(*found.tolist())

    @property
    def poses(self) -> FloatArray:
        """Poses (particles, 3) at the last processed scan."""
        return self._poses

    def propose(
        self, beams: ScanBeams, increment: MotionIncrement, wall_slope: int, *, wide: bool = False
    ) -> Proposal:
        """Draw new poses by odometry and scan, for `adopt`."""
        odometry = propagate(self._poses, increment.pose, increment.reckoned.covariance)
        return self.proposer.propose(self.maps, beams, wall_slope, odometry, self.best, self._rng, wide=wide)

    def adopt(self, proposal: Proposal) -> None:
        """Take over proposed poses, and weigh them."""
        gain = 1 / (self._config.ogain * self._config.particles)
        before, self._poses = self._poses, proposal.poses
        self._log_weights += gain * proposal.log_eta
        self._totals += gain * proposal.log_eta
        self.turned = float(self._poses[self.best, 2] - before[self.best, 2])

    def follow(self, increment: MotionIncrement) -> None:
        """Move all particles by dead reckoning, without draws that no match could weigh."""
        self._poses = propagate(self._poses, increment.pose, increment.reckoned.covariance).poses

    def insert_scan(self, points: ScanPoints, min_slopes: ByteArray, wall_slope: int) -> None:
        """Draw a scan into every map; arguments as of PatchMaps.draw_scan."""
        self.maps.draw_scan(self._poses, points, min_slopes, wall_slope)

    def resample_if_due(self) -> None:
        """Resample the particles if their effective number is low."""
        self.resample(normalize(self._log_weights), self._config.resampleThreshold, self._rng)

    def restart(self, path: Sequence[Pose2], maps: PatchMaps) -> None:
        """Replace all paths by one and all maps by the one of `maps`."""
        n, poses = self._config.particles, np.array([pose.as_array() for pose in path])
        self.tree.rewrite(poses)
        self._parents = np.zeros(n, np.int64)
        maps.descend(self._parents)
        self.maps, self._poses = maps, np.tile(poses[-1], (n, 1))
        self._log_weights, self._totals = np.zeros(n), np.zeros(n)


ROUNDS = 2
"""Rounds of each refinement: one alone sees only a part of the bias, because of the prior."""


@dataclass(frozen=True, slots=True)
class GmappingKeyframe(Keyframe):
    """Keyframe with the motion since the one before by odometry and gyro as they are.

    The seconds are those spent moving.
    """

    reckoned: PoseEstimate
    seconds: float


class BiasedRegistration:
    """Backward registration of the first keyframes, with the gyro's bias.

    The bias follows from the long-run disagreement between walls and gyro; the next round removes it.
    """

    def __init__(self, proposer: Proposer, ground_filter: GroundFilter, gyro: GyroBiasConfig) -> None:
        self.bias = GyroBias.unknown(gyro)
        self._proposer = proposer
        self._ground_filter = ground_filter

    def refine(self, keyframes: Sequence[GmappingKeyframe], maps: PatchMaps) -> list[GmappingKeyframe]:
        """Register keyframes in an empty map and draw them; return them with new poses.

        Backwards, since the first scans know the fewest walls. None are returned if too few fit.
        """
        for _ in range(ROUNDS):
            self._fitted = 0
            poses = self._register_backwards(self.reckon(keyframes), maps.resolution)
            self.learn(keyframes, poses)
        if self._fitted < REFINED_SHARE * (len(keyframes) - 1):
            return []
        refined = [replace(k, pose=pose) for k, pose in zip(keyframes, poses, strict=True)]
        return [replace(k, min_slopes=self._draw(maps, k, k.pose, IN_FULL)) for k in refined]

    def reckon(self, keyframes: Sequence[GmappingKeyframe]) -> list[GmappingKeyframe]:
        """Return keyframes with their poses by odometry and gyro, less the bias."""
        path = [Pose2()]
        for keyframe in keyframes[1:]:
            path.append(path[-1] @ remove_bias(keyframe.reckoned.pose, self.bias.value, keyframe.seconds))
        return [replace(k, pose=pose) for k, pose in zip(keyframes, path, strict=True)]

    def learn(self, keyframes: Sequence[GmappingKeyframe], poses: Sequence[Pose2]) -> None:
        """Estimate the bias from the disagreement between registered headings and the raw gyro."""
        self.bias = GyroBias.unknown(self.bias.config)
        for before, now, keyframe in zip(poses, poses[1:], keyframes[1:], strict=False):
            turned = wrap_angle(now.yaw - before.yaw - keyframe.reckoned.pose.yaw)
            self.bias = self.bias.learned(turned, keyframe.seconds)

    def _register_backwards(self, keyframes: list[GmappingKeyframe], resolution: float) -> list[Pose2]:
        """Return the keyframes' poses in a new map; the first keeps its pose."""
        maps, ground = PatchMaps(1, resolution), self._ground_filter
        pose, poses = keyframes[-1].pose, list[Pose2]()
        # Matching only distinguishes walls from the rest.
        wall = float(ground.match_wall_slope)
        for k in range(len(keyframes) - 1, -1, -1):
            if k < len(keyframes) - 1:
                pose = self._register(maps, keyframes[k], keyframes[k + 1], pose)
            if k > 0:
                self._draw(maps, keyframes[k], pose, (wall, wall))
            poses.append(pose)
        T_new_old = keyframes[0].pose @ poses[-1].inverse()
        return [T_new_old @ pose for pose in poses[::-1]]

    def _register(
        self, maps: PatchMaps, now: GmappingKeyframe, later: GmappingKeyframe, last: Pose2
    ) -> Pose2:
        """Return the pose of a keyframe in a map, given that of the later one."""
        ground, pose = self._ground_filter, last @ (later.pose.inverse() @ now.pose)
        covariance = in_axes_of(pose.inverse(), later.reckoned.covariance)
        drawn = maps.min_slope(0, now.scan.transformed(pose, now.height).hits)
        walls = ground.match_walls(now.scan, pose, now.height, known=np.maximum(now.min_slopes, drawn))
        view, beams = maps.view(0, ground.match_wall_slope), ScanBeams(now.scan.hits, walls)
        matched = self._proposer.match_scan(view, beams, pose.as_array(), covariance)
        self._fitted += matched is not None
        return pose if matched is None else Pose2(*matched.tolist())

    def _draw(self, maps: PatchMaps, keyframe: GmappingKeyframe, pose: Pose2, limits: Limits) -> ByteArray:
        """Draw a keyframe at a pose; return its hits' minimum slopes, exact between limits."""
        k, ground = keyframe, self._ground_filter
        slopes = ground.min_slopes(k.scan, pose, k.height, known=k.min_slopes, limits=limits)
        points = k.scan.transformed(Pose2(), k.height)
        maps.draw_scan(pose.as_array()[None], points, slopes, ground.match_wall_slope)
        return slopes


WARM_UP = {"sparse_distance": 0.1}
"""Configuration with which a short drive reaches every kernel: the scans are sparse."""


class GmappingMapper(PlanarMapper):
    """Particle filter over paths; a loop closes when the fitting particles survive."""

    name = "gmapping"
    requires_odometry = True

    def __init__(self, config: GmappingConfig | None = None) -> None:
        super().__init__()
        self.config = c = config or GmappingConfig()
        self.ground_filter = GroundFilter(c)
        self._leveler = ScanLeveler(c.maxUrange if math.isfinite(c.maxUrange) else 0.0, c.maxUrange)
        self._monitors = Monitors(c)
        self._filter = ParticleFilter(c)
        self._increment = MotionIncrement(c.motion)
        self._start = StartUp[GmappingKeyframe](c)
        self._window = ReckoningWindow(c)
        self._registration = BiasedRegistration(self._filter.proposer, self.ground_filter, c)
        self._bias = GyroBias.unknown(c)
        self._drift = DriftCovariance(c.delta / math.sqrt(12))
        self._fit: tuple[FloatArray, FloatArray] | None = None
        self._spacing, self._stamp = 0.0, math.inf

    def process(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        """Follow the odometry; after enough motion, make the scan a generation of the filter."""
        particles, motion = self._filter, self._increment
        level = self._leveler.level(scan, imu)
        self._follow(level, odometry, imu)
        if particles.tree.generations:
            self._track(level)
        if self._due:
            if particles.tree.generations:
                self._sample(level)
            particles.add_generation(motion.pose)
            reckoned, seconds = motion.reckoned, motion.seconds
            motion.begin()
            # Until the start-up refinement is over, every scan is a link of the trajectory.
            if self._monitors.tracking.fits or (level.leveled and not self._start.over):
                self._insert(level, reckoned, seconds)
            particles.resample_if_due()
        particles.tree.add_scan(scan.stamp, motion.pose)
        self.lost, self.covariance = self._monitors.tracking.lost, self._drift.covariance
        return self._pose

    def map(self) -> OccupancyGrid:
        """Return the best particle's map; without walls if dead reckoning placed most of them."""
        ground = self.ground_filter
        drawn = self._monitors.localizability.draws(ground.distance_traveled)
        wall_slope = ground.wall_slope if drawn else NO_WALL
        return self._filter.maps.occupancy_grid(self._filter.best, wall_slope)

    def trajectory(self) -> Trajectory:
        """Return the pose of every scan on the path of the best particle."""
        return self._filter.tree.trajectory(self._filter.best_leaf)

    def counts(self) -> MapperStats:
        """Return used and skipped scans, memory and other counts."""
        particles, processed = self._filter, self._filter.tree.generations
        return MapperStats(
            used=processed,
            skipped={"not moved": self.received - processed},
            memory=particles.maps.nbytes + self.ground_filter.grid.nbytes,
            counts={
                "particles": self.config.particles,
                "resamplings": particles.resamplings,
                "searches": particles.proposer.searches,
                "patches": particles.maps.in_use,
            },
        )

    @property
    def _pose(self) -> Pose2:
        return self._filter.pose @ self._increment.pose

    @property
    def _due(self) -> bool:
        c, motion = self.config, self._increment
        return (
            self._filter.tree.generations == 0
            or motion.distance >= c.linearUpdate
            or motion.turn >= c.angularUpdate
        )

    @property
    def _sparse(self) -> bool:
        return self._spacing >= self.config.sparse_distance

    def _follow(self, scan: LeveledScan, odometry: Pose2 | None, imu: Imu | None) -> None:
        """Add the odometry to the motion since the last processed scan."""
        before, seconds = self._pose, max(scan.stamp - self._stamp, 0.0)
        delta, self._stamp = self._increment.add_odometry(odometry, imu, scan.stamp), scan.stamp
        noise = in_axes_of(self._filter.pose.inverse(), self._increment.newest)
        self._drift.move(before, self._pose, noise, seconds, scan.ground_slope)
        self._spacing += (math.hypot(delta.x, delta.y) + abs(delta.yaw) - self._spacing) / min(
            self.received, self.config.sparse_memory
        )
        if scan.leveled:
            self.ground_filter.move(delta, scan)

    def _track(self, scan: LeveledScan) -> None:
        """Correct the motion by a match to the best particle's map, if localizable.

        A sparse scan that is processed at once is matched there, with dead reckoning as its prior.
        """
        if (self._sparse and self._due) or (scan.leveled and not self._monitors.localizability.localizable):
            return
        beams, wall_slope = self._beams(scan), self.ground_filter.match_wall_slope
        found = self._filter.match_best(beams, self._increment, wall_slope, wide=self._sparse)
        if found is not None and self._increment.distance_from(found) <= self.config.mahalanobis_gate:
            self._increment.pose = found
            if self._fit is not None:  # the scan tells as much as the last one that was weighed
                self._drift.match(self._pose, *self._fit, scan.hits)

    def _sample(self, scan: LeveledScan) -> None:
        """Draw new poses and weigh them; follow dead reckoning where it is not localizable."""
        particles, motion, monitors = self._filter, self._increment, self._monitors
        best = particles.best
        localizability, c = monitors.localizability, self.config
        beams = self._beams(scan)
        proposal = particles.propose(beams, motion, self.ground_filter.match_wall_slope, wide=self._sparse)
        hit, known = (float(ratio[particles.best]) for ratio in (proposal.hit_ratio, proposal.known_ratio))
        informative = known >= c.known_ratio and beams.weights.sum() >= c.min_beams
        if scan.leveled:
            moved = motion.distance + LEVER * motion.turn
            localizability.observe(hit if informative else None, moved, floor=self.ground_filter.flat)
        if not scan.leveled or (localizability.localizable and (informative or localizability.steady)):
            if not self.ground_filter.flat:
                proposal = self._limited(proposal, best)
            prior = in_axes_of(particles.pose.inverse(), motion.reckoned.covariance)
            self._fit = prior, proposal.covariances[particles.best]
            particles.adopt(proposal)
            self._drift.match(particles.pose, *self._fit, scan.hits)
        else:
            particles.follow(motion)
        fits = monitors.observe_fit(hit, known) and localizability.believed
        # Before the start is refined, too few walls are known for the gyro's bias.
        if self._start.refinements and fits and motion.seconds > 0:
            turned = particles.turned - motion.reckoned.pose.yaw
            self._bias = self._bias.learned(wrap_angle(turned), motion.seconds)
            motion.bias = self._bias.value

    def _limited(self, proposal: Proposal, best: int) -> Proposal:
        """Return the proposal with the corrections of dead reckoning that its window allows."""
        particles, motion = self._filter, self._increment
        step = remove_bias(motion.reckoned.pose, motion.bias, motion.seconds)
        before = particles.poses
        reckoned = propagate(before, step, motion.reckoned.covariance)
        expected = PoseEstimate(Pose2(*reckoned.poses[best].tolist()), reckoned.covariances[best])
        self._window.move(PoseEstimate(Pose2(*before[best].tolist()), np.zeros((3, 3))), expected)
        information = np.linalg.inv(proposal.covariances[best]) - np.linalg.inv(expected.covariance)
        P = self._window.allowed(expected, proposal.means[best], information)
        covariances = proposal.covariances.copy()
        covariances[best] = np.linalg.inv(np.linalg.inv(expected.covariance) + P.T @ information @ P)
        off = proposal.poses - reckoned.poses
        off[:, 2] = wrap_angles(off[:, 2])
        return proposal._replace(poses=reckoned.poses + off @ P.T, covariances=covariances)

    def _beams(self, scan: LeveledScan) -> ScanBeams:
        """Return the scan's hits, with weight 1 for known walls and 0 for possible ground."""
        ground, pose = self.ground_filter, self._pose
        placed = None if ground.flat else scan.transformed(pose, ground.height).hits
        known = None if placed is None else self._filter.maps.min_slope(self._filter.best, placed)
        return ScanBeams(scan.hits, ground.match_walls(scan, pose, known=known))

    def _insert(self, scan: LeveledScan, reckoned: PoseEstimate, seconds: float) -> None:
        """Draw the scan into all maps; refine the start of the trajectory when due."""
        ground, pose = self.ground_filter, self._pose
        self._drift.add_keyframe(pose, scan.hits)
        _, min_slopes = ground.insert(scan, pose)
        drawn = scan.transformed(Pose2(), ground.height), min_slopes
        if self._sparse:
            drawn = interpolate_hits(*drawn, self.config.delta)
        self._filter.insert_scan(*drawn, ground.match_wall_slope)
        keyframe = GmappingKeyframe(scan, pose, ground.height, min_slopes, reckoned, seconds)
        if self._start.add(keyframe, ground.distance_traveled) and not ground.flat:
            # The start is registered again with the gyro's bias; one particle replaces all.
            maps = PatchMaps(1, self.config.delta)
            refined = self._registration.refine(self._start.keyframes, maps)
            if refined:
                self._bias = self._registration.bias
                self._increment.bias = self._bias.value
                self._filter.restart([keyframe.pose for keyframe in refined], maps)
            self._start.replace(refined or self._start.keyframes)
