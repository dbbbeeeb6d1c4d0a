"""Particles of the original: noisy motion, scan matching, weights, resampling."""

from __future__ import annotations

import numpy as np

from lirs_wct.arrays import FloatArray
from lirs_wct.geometry.pose import Pose2
from slam_baselines.gmapping.original.config import GmappingOriginalConfig
from slam_baselines.gmapping.original.drand48 import Drand48
from slam_baselines.gmapping.original.hit_maps import HitMaps
from slam_baselines.gmapping.original.scan_matcher import match_scan
from slam_baselines.gmapping.resampling import effective_number, normalize, systematic_resample
from slam_baselines.gmapping.trajectory_tree import TrajectoryTree
from slam_baselines.linalg import compose_poses


class OriginalParticles:
    """Poses, maps, weights and paths of all particles.

    Attributes:
        maps: that the particles match scans against.
        tree: the paths, a generation each processed scan.
        resamplings: number of resamplings.
    """

    def __init__(self, config: GmappingOriginalConfig) -> None:
        n = config.particles
        self._config = config
        self._rng = Drand48(config.seed)
        self.maps = HitMaps(n, config.delta)
        self.tree = TrajectoryTree()
        self.resamplings = 0
        self._poses = np.zeros((n, 3))
        self._log_weights, self._totals = np.zeros(n), np.zeros(n)

    @property
    def best(self) -> int:
        """Index of the particle with the largest sum of log-likelihoods."""
        return int(np.argmax(self._totals))

    @property
    def pose(self) -> Pose2:
        """`T_map_base` of the best particle."""
        return Pose2(*self._poses[self.best].tolist())

    @property
    def path(self) -> FloatArray:
        """(generations, 3) poses of the best particle at the processed scans."""
        return self.tree.path(self.best)

    def move(self, delta: Pose2) -> None:
        """Move every particle by the odometry since the last scan, with independent noise."""
        c, x, y, turn = self._config, abs(delta.x), abs(delta.y), abs(delta.yaw)
        across = 0.3 * c.srr
        sigma = np.array(
            (
                c.srr * x + c.str * turn + across * y,
                c.srr * y + c.str * turn + across * x,
                c.stt * turn + c.srt * float(np.hypot(x, y)),
            )
        )
        noise = np.zeros((len(self._poses), 3))
        # The original draws no number where there is nothing to scatter.
        scattered = sigma > 0
        noise[:, scattered] = self._rng.standard_normal((len(noise), int(scattered.sum()))) * sigma[scattered]
        self._poses = compose_poses(self._poses, delta.as_array() + noise)

    def process_scan(self, ends: FloatArray, increment: Pose2) -> None:
        """Match and weigh, resample where due, and register the scan.

        Args:
            ends: (n, 2) of beams in the base frame, meters.
            increment: `T_processed_now` by odometry since the scan processed before.
        """
        parents = np.arange(len(self._poses))
        if self.tree.generations:
            self._match(ends)
            gain = 1 / (self._config.ogain * len(self._poses))
            weights = normalize(gain * self._log_weights)
            if effective_number(weights) < self._config.resampleThreshold * len(weights):
                parents = systematic_resample(weights, self._rng)
                self.maps.descend(parents)
                self._poses, self._totals = self._poses[parents], self._totals[parents]
                self._log_weights[:] = 0
                self.resamplings += 1
        self.maps.register_scan(self._poses, ends)
        self.tree.add_generation(self._poses, parents, increment)

    def _match(self, ends: FloatArray) -> None:
        parameters = self._config.matching
        for k, expected in enumerate(self._poses):
            self._poses[k], log_likelihood = match_scan(self.maps[k], expected, ends, parameters)
            self._log_weights[k] += log_likelihood
            self._totals[k] += log_likelihood
