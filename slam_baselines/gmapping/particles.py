"""Particles: paths, each with its map and a weight, and systematic resampling."""

from __future__ import annotations

from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from lirs_wct.arrays import FloatArray, IntArray
from lirs_wct.geometry import Pose2
from slam_baselines.gmapping.patches import PatchTables
from slam_baselines.gmapping.trajectory_tree import TrajectoryTree

Maps = TypeVar("Maps", bound=PatchTables[Any])


class UniformSource(Protocol):
    """Source of uniformly distributed numbers, such as a NumPy generator."""

    def random(self) -> float:
        """Return the next number within [0, 1)."""
        ...


def normalize(log_weights: FloatArray) -> FloatArray:
    """Return (n,) weights of sum 1 from their logarithms up to a constant."""
    weights: FloatArray = np.exp(log_weights - log_weights.max())
    return weights / weights.sum()  # type: ignore[no-any-return]


def effective_number(weights: FloatArray) -> float:
    """Return N_eff = 1 / sum w^2 (Grisetti et al. 2007, eq. 20); `weights` (n,) sum to 1."""
    return float(1.0 / np.square(weights).sum())


def systematic_resample(weights: FloatArray, rng: UniformSource) -> IntArray:
    """Return (n,) indices of the surviving particles, each n w times up to rounding.

    One random number moves a comb of n teeth over the cumulative weights (n,).
    """
    n = len(weights)
    comb = (np.arange(n) + rng.random()) / n
    # Rounding may leave the sum a little under 1: the last tooth still belongs to the last particle.
    return np.minimum(np.searchsorted(np.cumsum(weights), comb, side="right"), n - 1).astype(np.int64)


class Particles(Generic[Maps]):
    """Poses, maps, weights and paths of all particles.

    Attributes:
        maps: of the particles.
        tree: their paths, a generation each processed scan.
        resamplings: number of resamplings.
    """

    def __init__(self, maps: Maps) -> None:
        n = len(maps.tables)
        self.maps = maps
        self.tree = TrajectoryTree()
        self.resamplings = 0
        self._poses = np.zeros((n, 3))
        self._parents = np.arange(n)
        self._log_weights, self._totals = np.zeros(n), np.zeros(n)

    @property
    def best(self) -> int:
        """Index of the particle with the largest total weight."""
        return int(np.argmax(self._totals))

    @property
    def pose(self) -> Pose2:
        """`T_map_base` of the best particle at the last processed scan."""
        return Pose2(*self._poses[self.best].tolist())

    @property
    def best_leaf(self) -> int:
        """Index of the best particle in the last generation of the tree."""
        return int(self._parents[self.best])

    def add_generation(self, step: Pose2) -> None:
        """Make the poses a generation of the tree, `step` by odometry after the one before."""
        self.tree.add_generation(self._poses, self._parents, step)
        self._parents = np.arange(len(self._poses))

    def resample(self, weights: FloatArray, threshold: float, rng: UniformSource) -> None:
        """Resample the particles if their effective number is below a share of all."""
        if effective_number(weights) >= threshold * len(weights):
            return
        self.resamplings += 1
        parents = systematic_resample(weights, rng)
        self.maps.descend(parents)
        self._poses, self._parents = self._poses[parents], self._parents[parents]
        self._totals = self._totals[parents]
        self._log_weights[:] = 0
