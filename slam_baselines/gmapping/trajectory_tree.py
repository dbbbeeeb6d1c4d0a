"""Tree of the particles' paths, pruned of extinct ones, and the scans along them."""

from __future__ import annotations

import numpy as np

from lirs_wct.arrays import FloatArray, Int32Array, IntArray
from lirs_wct.geometry import Pose2, Trajectory
from slam_baselines.mapping.keyframe import KeyframeTrajectory


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
        """Add the (n, 3) poses of the particles at a processed scan.

        Args:
            poses: x, y, yaw.
            parents: (n,) indices of their parents in the generation before.
            step: `T_before_now` by odometry.
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
