"""Stamped poses of base_link."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from operator import attrgetter

import numpy as np
from numpy.typing import ArrayLike

from lirs_wct.arrays import FloatArray
from lirs_wct.display import ShownAsPicture
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.pose import Pose2, Pose3

_ROW = attrgetter("x", "y", "z", "qw", "qx", "qy", "qz")


@dataclass(frozen=True, slots=True)
class Trajectory(ShownAsPicture):
    """Poses over time in one frame.

    Attributes:
        stamps: (n,) seconds, strictly increasing.
        positions: (n, 3) meters.
        quaternions: (n, 4) unit, wxyz.

    Raises:
        ConfigError: lengths differ or stamps do not increase.
    """

    stamps: FloatArray
    positions: FloatArray
    quaternions: FloatArray

    def __post_init__(self) -> None:
        n = len(self.stamps)
        if self.positions.shape != (n, 3) or self.quaternions.shape != (n, 4):
            raise ConfigError(
                f"a trajectory of {n} stamps needs positions ({n}, 3) and quaternions ({n}, 4), "
                f"got {self.positions.shape} and {self.quaternions.shape}"
            )
        if np.any(np.diff(self.stamps) <= 0):
            raise ConfigError("stamps of a trajectory must increase strictly")

    def __repr__(self) -> str:
        seconds = float(self.stamps[-1] - self.stamps[0]) if len(self.stamps) else 0.0
        return f"Trajectory({len(self.stamps)} poses, {seconds:.4g} s, {self.length:.4g} m)"

    @staticmethod
    def from_poses(stamps: ArrayLike, poses: Iterable[Pose2 | Pose3]) -> Trajectory:
        """Build from stamps (n,) and n poses; planar ones lie upright at z = 0."""
        lifted = (Pose3.from_pose2(p) if isinstance(p, Pose2) else p for p in poses)
        rows: FloatArray = np.fromiter(map(_ROW, lifted), np.dtype((np.float64, 7)))
        return Trajectory(np.asarray(stamps, dtype=np.float64), rows[:, :3].copy(), rows[:, 3:].copy())

    def __len__(self) -> int:
        return len(self.stamps)

    @property
    def xy(self) -> FloatArray:
        """(n, 2) meters."""
        return self.positions[:, :2]

    @property
    def yaw(self) -> FloatArray:
        """(n,) radians."""
        return _yaw(self.quaternions)

    @property
    def length(self) -> float:
        """Planar path length, meters."""
        return float(np.linalg.norm(np.diff(self.xy, axis=0), axis=1).sum())

    def pose2(self, i: int) -> Pose2:
        """Return pose i projected on the plane."""
        x, y, _ = self.positions[i].tolist()
        return Pose2(x, y, _yaw(self.quaternions[i][None]).item())

    def planar_at(self, stamps: FloatArray) -> FloatArray:
        """Interpolate (m, 3) x, y, yaw at stamps (m,), clamped at the ends.

        Meters and radians; the yaw turns the short way round and may leave (-pi, pi].
        """
        yaw = np.unwrap(self.yaw)
        columns = (self.positions[:, 0], self.positions[:, 1], yaw)
        return np.column_stack([np.interp(stamps, self.stamps, column) for column in columns])

    def moved(self, T_new_frame: Pose2 | Pose3) -> Trajectory:
        """Return the same motion expressed in another frame."""
        T = Pose3.from_pose2(T_new_frame) if isinstance(T_new_frame, Pose2) else T_new_frame
        w, x, y, z = T.qw, T.qx, T.qy, T.qz
        a, b, c, d = self.quaternions.T
        columns = (
            w * a - x * b - y * c - z * d,
            w * b + x * a + y * d - z * c,
            w * c - x * d + y * a + z * b,
            w * d + x * c - y * b + z * a,
        )
        # One product per pose, like `Pose3.apply`: a single product for all poses rounds differently.
        positions = np.matmul(self.positions[:, None], T.rotation.T)[:, 0] + T.position
        return Trajectory(self.stamps.copy(), positions, np.column_stack(columns))


def _yaw(quaternions: FloatArray) -> FloatArray:
    """Return (n,) the yaw of unit quaternions (n, 4), wxyz, radians."""
    w, x, y, z = quaternions.T
    yaw: FloatArray = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return yaw
