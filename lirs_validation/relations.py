"""How right a trajectory is where only relations between some of its poses are known.

Kuemmerle et al. 2009, "On measuring the accuracy of SLAM algorithms", eqs. 2-3: the mean over the
relations of the translational and of the rotational part of the difference between estimated and
true relative pose. No alignment is needed, and one early mistake does not spoil the whole figure.
"""

from __future__ import annotations

import gzip
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lirs_wct.errors import SourceError
from lirs_wct.pose import Pose2, wrap_angle
from lirs_wct.trajectory import Trajectory

CARRIED = 0.1
"""A pose farther than this from a relation's stamp is carried there by odometry, seconds."""


@dataclass(frozen=True)
class Relation:
    """The true pose of the robot at `stamp_b` in its frame at `stamp_a`."""

    stamp_a: float
    stamp_b: float
    T_ab: Pose2


@dataclass(frozen=True)
class RelationErrors:
    """Errors of the relations inside the trajectory's time, and how many lay outside.

    Attributes:
        translation: (n,) metres.
        rotation: (n,) radians, not negative.
        outside: relations that were left out.
    """

    translation: NDArray[np.float64]
    rotation: NDArray[np.float64]
    outside: int


def read_relations(path: Path) -> tuple[Relation, ...]:
    """Read `stamp1 stamp2 x y z roll pitch yaw` lines, gzipped or not.

    Raises:
        SourceError: the file cannot be read or a line has not eight numbers.
    """
    try:
        raw = path.read_bytes()
        text = (gzip.decompress(raw) if raw[:2] == b"\x1f\x8b" else raw).decode()
        rows = [[float(w) for w in line.split()] for line in text.splitlines() if line[:1] not in ("", "#")]
    except (OSError, EOFError, ValueError) as error:
        raise SourceError(f"{path}: not readable as relations: {error}") from error
    if any(len(row) != 8 for row in rows):
        raise SourceError(f"{path}: a relation needs 8 numbers (stamp1 stamp2 x y z roll pitch yaw)")
    return tuple(Relation(r[0], r[1], Pose2(r[2], r[3], r[7])) for r in rows)


def relation_errors(
    estimate: Trajectory, relations: tuple[Relation, ...], odometry: Trajectory, margin: float = 2.0
) -> RelationErrors:
    """Compare the estimate with the relations.

    Args:
        estimate: poses in any frame.
        relations: the truth.
        odometry: raw odometry over the same time, any frame, that carries poses to the stamps.
        margin: relations with a stamp farther than this outside the estimate's time are left out, s.
    """
    low, high = estimate.stamps[0] - margin, estimate.stamps[-1] + margin
    inside = [r for r in relations if low <= min(r.stamp_a, r.stamp_b) and max(r.stamp_a, r.stamp_b) <= high]
    errors = [
        r.T_ab.inverse()
        @ pose_at(estimate, r.stamp_a, odometry).inverse()
        @ pose_at(estimate, r.stamp_b, odometry)
        for r in inside
    ]
    return RelationErrors(
        np.array([math.hypot(e.x, e.y) for e in errors]),
        np.array([abs(e.yaw) for e in errors]),
        len(relations) - len(inside),
    )


def pose_at(estimate: Trajectory, stamp: float, odometry: Trajectory) -> Pose2:
    """Return the estimated pose nearest in time, carried to the stamp by odometry where it is far."""
    i = _nearest(estimate.stamps, stamp)
    pose, there = estimate.pose2(i), float(estimate.stamps[i])
    if abs(there - stamp) <= CARRIED:
        return pose
    return pose @ interpolated(odometry, there).inverse() @ interpolated(odometry, stamp)


def interpolated(track: Trajectory, stamp: float) -> Pose2:
    """Return the pose at a stamp, linear between the neighbours, the first or last beyond the ends."""
    j = int(np.clip(np.searchsorted(track.stamps, stamp), 1, len(track) - 1)) if len(track) > 1 else 0
    if j == 0:
        return track.pose2(0)
    a, b = track.pose2(j - 1), track.pose2(j)
    t = float((stamp - track.stamps[j - 1]) / (track.stamps[j] - track.stamps[j - 1]))
    t = min(max(t, 0.0), 1.0)
    return Pose2(
        a.x + t * (b.x - a.x), a.y + t * (b.y - a.y), wrap_angle(a.yaw + t * wrap_angle(b.yaw - a.yaw))
    )


def _nearest(stamps: NDArray[np.float64], stamp: float) -> int:
    j = int(np.clip(np.searchsorted(stamps, stamp), 1, len(stamps) - 1)) if len(stamps) > 1 else 0
    return j - 1 if j and stamp - stamps[j - 1] <= stamps[j] - stamp else j
