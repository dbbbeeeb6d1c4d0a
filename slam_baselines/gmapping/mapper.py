"""GMapping's way: a Rao-Blackwellized particle filter whose proposal has seen the newest scan.

Grisetti, Stachniss, Burgard 2007, "Improved Techniques for Grid Mapping with Rao-Blackwellized Particle
Filters", written from the paper: every particle is a path with the map that follows from it; algorithm 1
is GmappingMapper._process.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from lirs_wct.arrays import ByteArray, FloatArray, IntArray
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.scan import Imu, LaserScan
from lirs_wct.geometry.trajectory import Trajectory
from slam_baselines.gmapping.bootstrap import Frame, Retrace
from slam_baselines.gmapping.config import GmappingConfig
from slam_baselines.gmapping.copy_on_write_map import PatchMaps
from slam_baselines.gmapping.proposal import Proposal, Proposer, carried
from slam_baselines.gmapping.resampling import effective_number, normalised, systematic_resample
from slam_baselines.gmapping.trajectory_tree import Lineage
from slam_baselines.mapper import MapperStats, Stopwatch
from slam_baselines.mapping.ground_filter import Relief
from slam_baselines.matching.tracking import FitCounter
from slam_baselines.motion.increment import Step
from slam_baselines.scan.leveling import LevelledScan, ScanLeveller

__all__ = ["GmappingConfig", "GmappingMapper"]


class GmappingMapper:
    """A filter over whole paths; a loop closes when the particles that fit survive."""

    def __init__(self, config: GmappingConfig | None = None) -> None:
        self.config = c = config or GmappingConfig()
        self._rng = np.random.default_rng(c.seed)
        self._leveller = ScanLeveller(c.maxUrange if math.isfinite(c.maxUrange) else 0.0, c.maxUrange)
        self._proposer = Proposer(c)
        self._relief = Relief(c.relief)
        self._maps = PatchMaps(c.particles, c.delta)
        self._lineage = Lineage()
        self._retrace = Retrace()
        self._poses = np.zeros((c.particles, 3))
        self._parents = np.arange(c.particles)
        self._log_weights, self._totals = np.zeros(c.particles), np.zeros(c.particles)
        self._step = Step(c.motion)
        self._fit = FitCounter(c.lost_score, c.known_share, c.lost_after)
        self._best = self._received = self._resamplings = self._lost_scans = 0
        self._stopwatch = Stopwatch()

    def update(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        """Follow the odometry; where the robot has moved enough, process the scan. Return `T_map_base`.

        Raises:
            ConfigError: there is no odometry.
        """
        if odometry is None:
            raise ConfigError(
                f"gmapping needs odometry, the scan at {scan.stamp} s has none; hector maps without"
            )
        started = self._stopwatch.start()
        self._received += 1
        level = self._leveller.level(scan, imu)
        self._follow(level, odometry, imu)
        if self._lineage.generations:
            self._track(level)
        if self._due:
            self._process(level)
        self._lineage.add_scan(scan.stamp, self._step.pose)
        self._lost_scans += self.lost
        self._stopwatch.stop(started)
        return self._pose

    def map(self) -> OccupancyGrid:
        """Return the map of the best particle."""
        return self._maps.occupancy_grid(self._best, self._relief.bound)

    def trajectory(self) -> Trajectory:
        """Return the pose of every scan on the path of the best particle."""
        return self._lineage.trajectory(int(self._parents[self._best]))

    @property
    def lost(self) -> bool:
        """Whether so many scans in a row fit nowhere that the pose is not to be believed."""
        return self._fit.lost

    @property
    def stats(self) -> MapperStats:
        """What was done so far."""
        processed = self._lineage.generations
        return MapperStats(
            received=self._received,
            used=processed,
            skipped={"not moved": self._received - processed},
            lost=self._lost_scans,
            memory=self._maps.nbytes + self._relief.grid.nbytes,
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
        return Pose2(*self._poses[self._best].tolist()) @ self._step.pose

    @property
    def _due(self) -> bool:
        c, step = self.config, self._step
        return self._lineage.generations == 0 or step.way >= c.linearUpdate or step.turn >= c.angularUpdate

    def _follow(self, scan: LevelledScan, odometry: Pose2, imu: Imu | None) -> None:
        """Carry the step since the last processed scan on by odometry."""
        delta = self._step.follow(odometry, imu, scan.stamp)
        if scan.levelled:
            self._relief.move(delta, scan)

    def _track(self, scan: LevelledScan) -> None:
        """Correct the step by matching the scan to the best particle's map."""
        bound = self._relief.match_bound
        view, expected = self._maps.view(self._best, bound), self._pose.as_array()
        found = self._proposer.track(view, scan.hits, self._weights(scan, bound), expected, self._step.newest)
        if found is not None:
            best = Pose2(*self._poses[self._best].tolist())
            self._step.pose = best.inverse() @ Pose2(*found.tolist())

    def _process(self, scan: LevelledScan) -> None:
        """Algorithm 1 of the paper, from line 3 on, for all particles."""
        if self._lineage.generations:
            proposal = self._propose(scan)
            gain = 1 / (self.config.ogain * self.config.particles)
            self._poses = proposal.poses
            self._log_weights += gain * proposal.log_eta
            self._totals += gain * proposal.log_eta
            self._best = int(np.argmax(self._totals))
            self._fit.note(proposal.met[self._best], proposal.known[self._best])
        self._lineage.add_generation(self._poses, self._parents, self._step.pose)
        self._parents = np.arange(len(self._poses))
        frame = self._frame(scan)
        self._step.begin()
        # While the way may be gone over again, every scan is a link of it.
        if self._fit.good or (scan.levelled and self._retrace.open):
            self._enter(frame)
        weights = normalised(self._log_weights)
        if effective_number(weights) < self.config.resampleThreshold * len(weights):
            self._descend(systematic_resample(weights, self._rng))

    def _propose(self, scan: LevelledScan) -> Proposal:
        """Draw the particles' new poses."""
        expected, covariances = carried(self._poses, self._step.pose, self._step.reckoned.covariance)
        bound = self._relief.match_bound
        weights = self._weights(scan, bound)
        return self._proposer.propose(
            self._maps, scan.hits, weights, bound, expected, covariances, self._best, self._rng
        )

    def _weights(self, scan: LevelledScan, bound: int) -> FloatArray:
        """Return (n,) 1 for hits on what is known to be a wall, 0 for those that may be ground."""
        if bound == 0:
            return np.ones(len(scan.hits))
        origin, hits, _ = scan.placed(self._pose, self._relief.height)
        proven = self._relief.steepness(origin, hits, self._pose)
        proven = np.maximum(proven, self._maps.steepness(self._best, hits))
        return (proven >= bound).astype(np.float64)

    def _frame(self, scan: LevelledScan) -> Frame:
        """Return the scan with how it was come to from the one before."""
        step, unproven = self._step, self._relief.unproven(len(scan.hits))
        reckoned = step.reckoned
        return Frame(scan, reckoned.pose, reckoned.covariance, step.seconds, self._relief.height, unproven)

    def _enter(self, frame: Frame) -> None:
        """Draw the scan; on uneven ground, go over the first metres again when it is time."""
        frame = replace(frame, steep=self._draw(frame.scan))
        if not frame.scan.levelled:
            return
        if self._retrace.note(frame, self._relief.travelled) and self._relief.match_bound > 0:
            self._go_over()

    def _go_over(self) -> None:
        """Replace all paths and maps of the first metres by one that was traced with better knowledge."""
        maps = PatchMaps(1, self.config.delta)
        path = np.array([pose.as_array() for pose in self._retrace.trace(maps, self._proposer, self._relief)])
        self._step.bias = self._retrace.bias
        self._lineage.rewrite(path)
        n = self.config.particles
        self._parents, self._best = np.zeros(n, np.int64), 0
        maps.descend(self._parents)
        self._maps, self._poses = maps, np.tile(path[-1], (n, 1))
        self._log_weights, self._totals = np.zeros(n), np.zeros(n)

    def _draw(self, scan: LevelledScan) -> ByteArray:
        """Enter the scan into every particle's map, and into the relief from where the best one is.

        Return what is proven of its hits.
        """
        lift = np.array((0.0, 0.0, self._relief.height))
        if scan.levelled:
            steep = self._relief.observe(*scan.placed(self._pose, self._relief.height), self._pose)
        else:
            steep = self._relief.unproven(len(scan.hits))
        bound = self._relief.match_bound
        self._maps.enter(self._poses, scan.origin + lift, scan.hits + lift, scan.free + lift, steep, bound)
        return steep

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
