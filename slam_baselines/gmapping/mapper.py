"""GMapping: a Rao-Blackwellized particle filter whose proposal has seen the newest scan.

Grisetti, Stachniss, Burgard 2007, "Improved Techniques for Grid Mapping with Rao-Blackwellized Particle
Filters", written from the paper: every particle is a path with the map that follows from it; algorithm 1
is GmappingMapper._process.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np

from lirs_wct.arrays import ByteArray, IntArray
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.scan import Imu, LaserScan
from lirs_wct.geometry.trajectory import Trajectory
from slam_baselines.common.stopwatch import Stopwatch
from slam_baselines.gmapping.bootstrap import Bootstrap, Frame
from slam_baselines.gmapping.config import GmappingConfig
from slam_baselines.gmapping.copy_on_write_map import PatchMaps
from slam_baselines.gmapping.likelihood_field import Beams
from slam_baselines.gmapping.proposal import Proposal, Proposer, propagated
from slam_baselines.gmapping.resampling import effective_number, normalized, systematic_resample
from slam_baselines.gmapping.trajectory_tree import TrajectoryTree
from slam_baselines.mapper import MapperStats, required_odometry
from slam_baselines.mapping.ground_filter import GroundFilter
from slam_baselines.matching.tracking import TrackingMonitor
from slam_baselines.motion.increment import MotionIncrement
from slam_baselines.scan.leveling import LeveledScan, ScanLeveler

__all__ = ["GmappingConfig", "GmappingMapper"]


class GmappingMapper:
    """A filter over whole paths; a loop closes when the particles that fit survive."""

    requires_odometry = True

    def __init__(self, config: GmappingConfig | None = None) -> None:
        self.config = c = config or GmappingConfig()
        self._rng = np.random.default_rng(c.seed)
        self._leveler = ScanLeveler(c.maxUrange if math.isfinite(c.maxUrange) else 0.0, c.maxUrange)
        self._proposer = Proposer(c)
        self._ground_filter = GroundFilter(c.ground_filter)
        self._maps = PatchMaps(c.particles, c.delta)
        self._tree = TrajectoryTree()
        self._bootstrap = Bootstrap()
        self._poses = np.zeros((c.particles, 3))
        self._parents = np.arange(c.particles)
        self._log_weights, self._totals = np.zeros(c.particles), np.zeros(c.particles)
        self._increment = MotionIncrement(c.motion)
        self._tracking = TrackingMonitor(c.tracking)
        self._best = self._received = self._resamplings = self._lost_scans = 0
        self._stopwatch = Stopwatch()

    @property
    def resolution(self) -> float:
        """Edge of a cell of the map, metres."""
        return self.config.delta

    def update(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        """Follow the odometry; where the robot has moved enough, process the scan. Return `T_map_base`.

        Raises:
            ConfigError: there is no odometry.
        """
        odometry = required_odometry("gmapping", odometry, scan.stamp)
        started = self._stopwatch.start()
        self._received += 1
        level = self._leveler.level(scan, imu)
        self._follow(level, odometry, imu)
        if self._tree.generations:
            self._track(level)
        if self._due:
            self._process(level)
        self._tree.add_scan(scan.stamp, self._increment.pose)
        self._lost_scans += self.lost
        self._stopwatch.stop(started)
        return self._pose

    def map(self) -> OccupancyGrid:
        """Return the map of the best particle."""
        return self._maps.occupancy_grid(self._best, self._ground_filter.wall_slope)

    def trajectory(self) -> Trajectory:
        """Return the pose of every scan on the path of the best particle."""
        return self._tree.trajectory(int(self._parents[self._best]))

    @property
    def lost(self) -> bool:
        """Whether so many scans in a row fit nowhere that the pose is not to be believed."""
        return self._tracking.lost

    @property
    def stats(self) -> MapperStats:
        """What was done so far."""
        processed = self._tree.generations
        return MapperStats(
            received=self._received,
            used=processed,
            skipped={"not moved": self._received - processed},
            lost=self._lost_scans,
            memory=self._maps.nbytes + self._ground_filter.grid.nbytes,
            counts={
                "particles": self.config.particles,
                "resamplings": self._resamplings,
                "searches": self._proposer.searches,
                "patches": self._maps.in_use,
            },
            **self._stopwatch.summary(),
        )

    @property
    def _pose(self) -> Pose2:
        return Pose2(*self._poses[self._best].tolist()) @ self._increment.pose

    @property
    def _due(self) -> bool:
        c, step = self.config, self._increment
        return self._tree.generations == 0 or step.distance >= c.linearUpdate or step.turn >= c.angularUpdate

    def _follow(self, scan: LeveledScan, odometry: Pose2, imu: Imu | None) -> None:
        """Carry the step since the last processed scan on by odometry."""
        delta = self._increment.follow(odometry, imu, scan.stamp)
        if scan.leveled:
            self._ground_filter.move(delta, scan)

    def _track(self, scan: LeveledScan) -> None:
        """Correct the step by matching the scan to the best particle's map."""
        wall_slope = self._ground_filter.match_wall_slope
        view, expected = self._maps.view(self._best, wall_slope), self._pose.as_array()
        found = self._proposer.track(view, self._beams(scan), expected, self._increment.newest)
        if found is not None:
            best = Pose2(*self._poses[self._best].tolist())
            self._increment.pose = best.inverse() @ Pose2(*found.tolist())

    def _process(self, scan: LeveledScan) -> None:
        """Algorithm 1 of the paper, from line 3 on, for all particles."""
        if self._tree.generations:
            proposal = self._propose(scan)
            gain = 1 / (self.config.ogain * self.config.particles)
            self._poses = proposal.poses
            self._log_weights += gain * proposal.log_eta
            self._totals += gain * proposal.log_eta
            self._best = int(np.argmax(self._totals))
            self._tracking.observe(proposal.hit_ratio[self._best], proposal.known_ratio[self._best])
        self._tree.add_generation(self._poses, self._parents, self._increment.pose)
        self._parents = np.arange(len(self._poses))
        frame = self._frame(scan)
        self._increment.begin()
        # Until the start-up refinement is over, every scan is a link of the trajectory.
        if self._tracking.fits or (scan.leveled and self._bootstrap.open):
            self._enter(frame)
        weights = normalized(self._log_weights)
        if effective_number(weights) < self.config.resampleThreshold * len(weights):
            self._descend(systematic_resample(weights, self._rng))

    def _propose(self, scan: LeveledScan) -> Proposal:
        """Draw the particles' new poses."""
        reckoned = self._increment.reckoned.covariance
        odometry = propagated(self._poses, self._increment.pose, reckoned)
        wall_slope = self._ground_filter.match_wall_slope
        return self._proposer.propose(
            self._maps, self._beams(scan), wall_slope, odometry, self._best, self._rng
        )

    def _beams(self, scan: LeveledScan) -> Beams:
        """Return the scan's hits, weighted by whether the best particle knows them for walls."""
        ground, drawn = self._ground_filter, partial(self._maps.min_slope, self._best)
        return Beams(scan.hits, ground.wall_weights(ground.min_slopes(scan, self._pose, drawn=drawn)))

    def _frame(self, scan: LeveledScan) -> Frame:
        """Return the scan with how it was come to from the one before."""
        step, no_min_slope = self._increment, self._ground_filter.no_min_slope(len(scan.hits))
        reckoned = step.reckoned
        return Frame(
            scan, reckoned.pose, reckoned.covariance, step.seconds, self._ground_filter.height, no_min_slope
        )

    def _enter(self, frame: Frame) -> None:
        """Draw the scan; on uneven ground, refine the start of the trajectory when it is due."""
        frame = replace(frame, min_slopes=self._draw(frame.scan))
        if not frame.scan.leveled:
            return
        if (
            self._bootstrap.note(frame, self._ground_filter.distance_traveled)
            and self._ground_filter.match_wall_slope > 0
        ):
            self._refine_start()

    def _refine_start(self) -> None:
        """Replace all paths and maps by the refined one."""
        maps = PatchMaps(1, self.config.delta)
        path = np.array(
            [pose.as_array() for pose in self._bootstrap.refine(maps, self._proposer, self._ground_filter)]
        )
        self._increment.bias = self._bootstrap.bias
        self._tree.rewrite(path)
        n = self.config.particles
        self._parents, self._best = np.zeros(n, np.int64), 0
        maps.descend(self._parents)
        self._maps, self._poses = maps, np.tile(path[-1], (n, 1))
        self._log_weights, self._totals = np.zeros(n), np.zeros(n)

    def _draw(self, scan: LeveledScan) -> ByteArray:
        """Enter the scan into every particle's map, and into the ground filter from where the best one is.

        Return the minimum slopes of its hits.
        """
        _, min_slopes = self._ground_filter.insert(scan, self._pose)
        wall_slope = self._ground_filter.match_wall_slope
        points = scan.transformed(Pose2(), self._ground_filter.height)
        self._maps.enter(self._poses, points, min_slopes, wall_slope)
        return min_slopes

    def _descend(self, parents: IntArray) -> None:
        """Replace the particles by copies of those that live on."""
        self._resamplings += 1
        self._maps.descend(parents)
        self._poses, self._parents, self._totals = (
            self._poses[parents],
            self._parents[parents],
            self._totals[parents],
        )
        self._log_weights[:] = 0
        self._best = int(np.argmax(self._totals))
