"""Particle filter: paths, each with its map and a weight.

Algorithm 1 of Grisetti, Stachniss, Burgard 2007, from line 3 on: draw poses from the improved proposal,
weigh them, resample where the effective number of particles is low, and draw the scan into every map.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lirs_wct.arrays import ByteArray, FloatArray
from lirs_wct.geometry import Pose2, Trajectory
from slam_baselines.gmapping.config import GmappingConfig
from slam_baselines.gmapping.copy_on_write_map import PatchMaps
from slam_baselines.gmapping.particles import Particles, normalize
from slam_baselines.gmapping.proposal import First, Proposal, Proposer, propagate
from slam_baselines.gmapping.scan_matching import ScanBeams
from slam_baselines.motion.increment import MotionIncrement
from slam_baselines.scan.leveling import ScanPoints


class ParticleFilter(Particles[PatchMaps]):
    """All particles.

    Attributes:
        proposer: of new poses.
        turned: by the best particle from the last processed scan but one to the last, radians.
    """

    def __init__(self, config: GmappingConfig) -> None:
        super().__init__(PatchMaps(config.particles, config.delta))
        self._config = config
        self._rng = np.random.default_rng(config.seed)
        self.proposer = Proposer(config)
        self.turned = 0.0

    @property
    def trajectory(self) -> Trajectory:
        """Pose of every scan on the path of the best particle."""
        return self.tree.trajectory(self.best_leaf)

    def known_slopes(self, points: FloatArray) -> ByteArray:
        """Return (n,) minimum slopes of the best map's cells at points (n, 2 or more)."""
        return self.maps.min_slope(self.best, points)

    def match_best(
        self, beams: ScanBeams, increment: MotionIncrement, wall_slope: int, *, wide: bool = False
    ) -> Pose2 | None:
        """Return `T_processed_now` by a match to the best map; None without a fit nearby."""
        view, expected = self.maps.view(self.best, wall_slope), self.pose @ increment.pose
        found = self.proposer.match_scan(view, beams, expected.as_array(), increment.newest, wide=wide)
        return None if found is None else self.pose.inverse() @ Pose2(*found.tolist())

    def propose(
        self, beams: ScanBeams, increment: MotionIncrement, wall_slope: int, *, wide: bool = False
    ) -> Proposal:
        """Draw new poses by odometry and scan, for `adopt`."""
        odometry = propagate(self._poses, increment.pose, increment.reckoned.covariance)
        first = First(self.best, wide)
        return self.proposer.propose(self.maps, beams, wall_slope, odometry, first, self._rng)

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
