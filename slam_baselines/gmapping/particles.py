"""Particles: paths, each with its map and a weight, and systematic resampling."""

from __future__ import annotations

from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from lirs_wct.geometry import FloatArray, Int32Array, IntArray, Pose2, Trajectory
from slam_baselines.front_end import KeyframeTrajectory
from slam_baselines.gmapping.patches import PatchTables


class TrajectoryTree:
    """Poses of all particles and their ancestors at each processed scan."""

    def __init__(self) -> None:
        self._poses: list[FloatArray] = []
        self._parents: list[Int32Array] = []
        self._measured: list[Pose2] = []
        self._scans = KeyframeTrajectory()

    @property
    def generations(self) -> int:
        """Processed scans so far."""
        return len(self._poses)

    def add_generation(self, poses: FloatArray, parents: IntArray, step: Pose2) -> None:
        """Add the particles' poses (n, 3) at a processed scan, a `step` after the last.

        Their (n,) parents are indices in the generation before.
        """
        self._poses.append(poses.copy())
        self._parents.append(parents.astype(np.int32))
        self._measured.append(self._measured[-1] @ step if self._measured else Pose2())
        self._prune()

    def add_scan(self, stamp: float, since: Pose2) -> None:
        """Add a scan, odometry's `T_processed_now` after the last generation.

        A later scan of the same stamp replaces the earlier one.
        """
        self._scans.add(stamp, self.generations - 1, since)

    def rewrite(self, path: FloatArray) -> None:
        """Replace all paths by one, (generations, 3); all particles descend from its end."""
        self._poses = list(path[:, None].copy())
        self._parents = [np.zeros(1, np.int32) for _ in path]

    def path(self, particle: int) -> FloatArray:
        """Return (generations, 3) poses of a particle and its ancestors."""
        path = np.empty((self.generations, 3))
        for i in range(self.generations - 1, -1, -1):
            path[i] = self._poses[i][particle]
            particle = int(self._parents[i][particle])
        return path

    def trajectory(self, particle: int) -> Trajectory:
        """Return every scan's pose on the path of a particle.

        The odometry's error between two processed scans is spread over the scans between them.
        """
        path = [Pose2(*pose) for pose in self.path(particle).tolist()]
        return self._scans.trajectory(path, self._measured)

    def _prune(self) -> None:
        """Remove particles without living descendants."""
        for i in range(self.generations - 2, -1, -1):
            alive, renamed = np.unique(self._parents[i + 1], return_inverse=True)
            if len(alive) == len(self._poses[i]):
                return
            self._parents[i + 1] = renamed.astype(np.int32)
            self._poses[i] = self._poses[i][alive]
            self._parents[i] = self._parents[i][alive]


Maps = TypeVar("Maps", bound=PatchTables[Any])


class UniformSource(Protocol):
    """Source of uniformly distributed numbers, such as a NumPy generator."""

    def random(self) -> float:
        """Return the next number within [0, 1)."""
        ...


def normalize(log_weights: FloatArray) -> FloatArray:
    """Return (n,) weights of sum 1 from their logarithms up to a constant."""
    weights: FloatArray = np.exp(log_weights - log_weights.max())
    weights /= weights.sum()
    return weights


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
    """Poses, maps, weights and paths of all particles, a generation each processed scan."""

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
