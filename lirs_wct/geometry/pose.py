"""Rigid poses in the plane and in space, their trajectories, and views of a scene.

`T_ab` maps coordinates in frame b to frame a, so `T_ac = T_ab @ T_bc`. Meters and radians;
quaternions are wxyz (MuJoCo's order); files of ROS and TUM hold xyzw.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import product
from operator import attrgetter

import numpy as np
from numpy.typing import ArrayLike

from lirs_wct.arrays import FloatArray
from lirs_wct.display import ShownAsPicture
from lirs_wct.errors import ConfigError


def wrap_angle(angle: float) -> float:
    """Return the angle in (-pi, pi]."""
    wrapped = math.remainder(angle, math.tau)
    return math.pi if wrapped == -math.pi else wrapped


@dataclass(frozen=True, slots=True)
class Pose2:
    """A rigid pose `T_ab` in the plane: origin of b in a, and yaw."""

    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0

    def __matmul__(self, other: Pose2) -> Pose2:
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return Pose2(
            self.x + c * other.x - s * other.y,
            self.y + s * other.x + c * other.y,
            wrap_angle(self.yaw + other.yaw),
        )

    def inverse(self) -> Pose2:
        """Return `T_ba`."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return Pose2(-c * self.x - s * self.y, s * self.x - c * self.y, wrap_angle(-self.yaw))

    def apply(self, points: ArrayLike) -> FloatArray:
        """Map points (..., 2) from frame b to frame a."""
        p = np.asarray(points, dtype=np.float64)
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return np.stack(
            (self.x + c * p[..., 0] - s * p[..., 1], self.y + s * p[..., 0] + c * p[..., 1]), axis=-1
        )

    def distance(self, other: Pose2) -> float:
        """Return the Euclidean distance between the two origins, in meters."""
        return math.hypot(self.x - other.x, self.y - other.y)

    def as_array(self) -> FloatArray:
        """Return (3,): x, y, yaw."""
        return np.array((self.x, self.y, self.yaw))


def wrap_angles(angle: FloatArray) -> FloatArray:
    """Return angles in [-pi, pi)."""
    wrapped: FloatArray = np.mod(angle + math.pi, math.tau) - math.pi
    return wrapped


def compose_poses(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return `T_a @ T_b` for each pair of planar poses (n, 3): x, y, yaw."""
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    x = a[..., 0] + c * b[..., 0] - s * b[..., 1]
    y = a[..., 1] + s * b[..., 0] + c * b[..., 1]
    return np.stack((x, y, wrap_angles(a[..., 2] + b[..., 2])), axis=-1)


def relative_poses(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return `T_a^-1 @ T_b` for each pair of planar poses (n, 3): x, y, yaw."""
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    dx, dy = b[..., 0] - a[..., 0], b[..., 1] - a[..., 1]
    return np.stack((c * dx + s * dy, -s * dx + c * dy, wrap_angles(b[..., 2] - a[..., 2])), axis=-1)


@dataclass(frozen=True, slots=True)
class Pose3:
    """A rigid pose in space: translation in meters and a unit quaternion (wxyz)."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    qw: float = 1.0
    qx: float = 0.0
    qy: float = 0.0
    qz: float = 0.0

    @staticmethod
    def from_rpy(x: float, y: float, z: float, roll: float, pitch: float, yaw: float) -> Pose3:
        """Build from translation and fixed-axis roll, pitch, yaw (R = Rz Ry Rx)."""
        cr, sr = math.cos(roll / 2), math.sin(roll / 2)
        cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
        cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
        return Pose3(
            x,
            y,
            z,
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        )

    @staticmethod
    def from_arrays(position: ArrayLike, quaternion: ArrayLike) -> Pose3:
        """Build from position (3,) and quaternion (4,) wxyz, which is normalized."""
        p = np.asarray(position, dtype=np.float64)
        q = np.asarray(quaternion, dtype=np.float64)
        q = q / np.linalg.norm(q)
        return Pose3(*(float(v) for v in p), *(float(v) for v in q))

    @staticmethod
    def from_pose2(pose: Pose2, z: float = 0.0) -> Pose3:
        """Lift a planar pose to height z, upright."""
        return Pose3(pose.x, pose.y, z, math.cos(pose.yaw / 2), 0.0, 0.0, math.sin(pose.yaw / 2))

    def __matmul__(self, other: Pose3) -> Pose3:
        w, x, y, z = self.qw, self.qx, self.qy, self.qz
        a, b, c, d = other.qw, other.qx, other.qy, other.qz
        px, py, pz = self.apply((other.x, other.y, other.z)).tolist()
        return Pose3(
            px,
            py,
            pz,
            w * a - x * b - y * c - z * d,
            w * b + x * a + y * d - z * c,
            w * c - x * d + y * a + z * b,
            w * d + x * c - y * b + z * a,
        )

    def inverse(self) -> Pose3:
        """Return `T_ba`."""
        px, py, pz = (-np.array((self.x, self.y, self.z)) @ self.rotation).tolist()
        return Pose3(px, py, pz, self.qw, -self.qx, -self.qy, -self.qz)

    def apply(self, points: ArrayLike) -> FloatArray:
        """Map points (..., 3) from frame b to frame a."""
        p = np.asarray(points, dtype=np.float64)
        mapped: FloatArray = p @ self.rotation.T + np.array((self.x, self.y, self.z))
        return mapped

    @property
    def position(self) -> FloatArray:
        """(3,) translation in meters."""
        return np.array((self.x, self.y, self.z))

    @property
    def quaternion(self) -> FloatArray:
        """(4,) unit quaternion, wxyz."""
        return np.array((self.qw, self.qx, self.qy, self.qz))

    @property
    def rotation(self) -> FloatArray:
        """(3, 3) rotation matrix."""
        w, x, y, z = self.qw, self.qx, self.qy, self.qz
        return np.array(
            (
                (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
                (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
                (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
            )
        )

    @property
    def roll(self) -> float:
        """Rotation about x, fixed axes, in radians."""
        w, x, y, z = self.qw, self.qx, self.qy, self.qz
        return math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))

    @property
    def pitch(self) -> float:
        """Rotation about y, fixed axes, in radians; positive = nose down (REP 103)."""
        w, x, y, z = self.qw, self.qx, self.qy, self.qz
        return math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))

    @property
    def yaw(self) -> float:
        """Rotation about z, fixed axes, in radians."""
        w, x, y, z = self.qw, self.qx, self.qy, self.qz
        return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))

    def to_pose2(self) -> Pose2:
        """Project on the plane: x, y, yaw."""
        return Pose2(self.x, self.y, self.yaw)


_ROW = attrgetter("x", "y", "z", "qw", "qx", "qy", "qz")


@dataclass(frozen=True, slots=True)
class Trajectory(ShownAsPicture):
    """Poses over time in one frame.

    Attributes:
        stamps: (n,) seconds, strictly increasing.
        positions: (n, 3) meters.
        quaternions: (n, 4) unit, wxyz.
        covariances: (n, 3, 3) claimed for x, y, yaw in the frame's axes, NaN for a pose without one; None =
            for no pose.

    Raises:
        ConfigError: lengths differ or stamps do not increase.
    """

    stamps: FloatArray
    positions: FloatArray
    quaternions: FloatArray
    covariances: FloatArray | None = None

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
        covariances = self.covariances
        if covariances is not None:
            covariances = in_axes_of(T.to_pose2().inverse(), covariances)
        return Trajectory(self.stamps.copy(), positions, np.column_stack(columns), covariances)


def covariance_fault(matrix: FloatArray) -> str | None:
    """Return why a matrix is no covariance of x, y, yaw; None if it is one."""
    if matrix.shape == (3, 3) and np.isfinite(matrix).all():
        tolerance = 1e-9 * max(1.0, float(abs(matrix).max()))
        if abs(matrix - matrix.T).max() <= tolerance and np.linalg.eigvalsh(matrix)[0] >= -tolerance:
            return None
    text = " ".join(np.array2string(matrix, threshold=9, precision=3).split())
    return f"covariance must be 3 x 3, finite, symmetric and positive semidefinite, got {text}"


def in_axes_of(frame: Pose2, matrix: FloatArray) -> FloatArray:
    """Rotate covariances or informations (..., 3, 3) of planar poses into a frame's axes."""
    c, s = math.cos(frame.yaw), math.sin(frame.yaw)
    R = np.array(((c, s, 0.0), (-s, c, 0.0), (0.0, 0.0, 1.0)))
    return np.asarray(R @ matrix @ R.T, dtype=np.float64)


def _yaw(quaternions: FloatArray) -> FloatArray:
    """Return (n,) the yaw of unit quaternions (n, 4), wxyz, radians."""
    w, x, y, z = quaternions.T
    yaw: FloatArray = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return yaw


AZIMUTH, ELEVATION = math.radians(62), math.radians(-35)
"""Viewing direction of an overview: towards the north-north-east, and down."""
DISTANCE_FACTOR = 1.05
"""Camera distance, as a multiple of the least one that shows the whole box."""


@dataclass(frozen=True, slots=True)
class Viewpoint:
    """Position and viewing direction of a camera.

    Attributes:
        position: x, y, z, meters.
        yaw: angle of the viewing direction from the x axis, radians.
        pitch: angle of the viewing direction below the horizon, radians.
    """

    position: tuple[float, float, float]
    yaw: float
    pitch: float

    @property
    def axes(self) -> FloatArray:
        """(3, 3) rows: forward, right, up in the world."""
        return camera_axes(self.yaw, self.pitch)


def camera_axes(yaw: float, pitch: float) -> FloatArray:
    """Return (3, 3) rows forward, right, up of a camera; pitch is downward."""
    cy, sy, cp, sp = math.cos(yaw), math.sin(yaw), math.cos(pitch), math.sin(pitch)
    return np.array(((cp * cy, cp * sy, -sp), (sy, -cy, 0.0), (sp * cy, sp * sy, cp)))


def overview(low: ArrayLike, high: ArrayLike, fovy: float, aspect: float = 4 / 3) -> Viewpoint:
    """Return a viewpoint outside a box, from its lowest to its highest corner.

    The picture's angle from its lower to its upper edge is `fovy`, radians, its width over its height
    `aspect`.
    """
    ends = np.array((low, high), np.float64)
    corners = np.array([ends[list(which), range(3)] for which in product((0, 1), repeat=3)])
    middle = corners.mean(axis=0)
    ahead, right, up = ((corners - middle) @ axis for axis in camera_axes(AZIMUTH, -ELEVATION))
    half = math.tan(fovy / 2)
    least = np.maximum(np.abs(right) / (half * aspect), np.abs(up) / half) - ahead
    eye = middle - camera_axes(AZIMUTH, -ELEVATION)[0] * float(least.max()) * DISTANCE_FACTOR
    return Viewpoint((float(eye[0]), float(eye[1]), float(eye[2])), AZIMUTH, -ELEVATION)
