"""How right a trajectory is where only relations between some of its poses are known.

Kuemmerle et al. 2009, "On measuring the accuracy of SLAM algorithms", eqs. 2-3: the mean over the
relations of the translational and of the rotational part of the difference between estimated and
true relative pose. No alignment is needed, and one early mistake does not spoil the whole figure.
"""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lirs_validation.metrics.planar import motion, planar, wrapped
from lirs_wct.arrays import FloatArray
from lirs_wct.errors import SourceError
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.trajectory import Trajectory

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
        stamps: (n,) seconds, the earlier stamp of each relation.
    """

    translation: FloatArray
    rotation: FloatArray
    outside: int
    stamps: FloatArray


def read_relations(path: Path) -> tuple[Relation, ...]:
    """Read `stamp1 stamp2 x y z roll pitch yaw` lines, gzipped or not.

    Raises:
        SourceError: the file cannot be read, holds none, or a line has not eight finite numbers.
    """
    try:
        raw = path.read_bytes()
        text = (gzip.decompress(raw) if raw[:2] == b"\x1f\x8b" else raw).decode()
        lines = [line.split() for line in text.splitlines()]
        rows = [[float(word) for word in words] for words in lines if words and words[0][0] != "#"]
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise SourceError(f"{path}: the gzip stream is damaged or cut off ({error})") from error
    except (OSError, ValueError) as error:
        told = getattr(error, "strerror", None) or error
        raise SourceError(f"{path}: not readable as relations: {told}") from error
    if not rows:
        raise SourceError(f"{path}: holds no relation (stamp1 stamp2 x y z roll pitch yaw)")
    if any(len(row) != 8 or not np.isfinite(row).all() for row in rows):
        raise SourceError(f"{path}: a relation needs 8 numbers (stamp1 stamp2 x y z roll pitch yaw)")
    return tuple(Relation(r[0], r[1], Pose2(r[2], r[3], r[7])) for r in rows)


def relation_errors(
    estimate: Trajectory, relations: Sequence[Relation], odometry: Trajectory, margin: float = 2.0
) -> RelationErrors:
    """Compare the estimate with the relations.

    Args:
        estimate: poses in any frame.
        relations: the truth.
        odometry: raw odometry over the same time, any frame, that carries poses to the stamps; where it is
            empty, the estimate itself does.
        margin: relations with a stamp farther than this outside the estimate's time are left out, s.
    """
    low, high = estimate.stamps[0] - margin, estimate.stamps[-1] + margin
    stamps = np.array([(r.stamp_a, r.stamp_b) for r in relations]).reshape(-1, 2)
    inside = (stamps.min(axis=1) >= low) & (stamps.max(axis=1) <= high)
    stamps = stamps[inside]
    true = np.array([r.T_ab.as_array() for r in relations]).reshape(-1, 3)[inside]
    carrier = odometry if len(odometry) else estimate
    a, b = (poses_at(estimate, stamps[:, k], carrier) for k in (0, 1))
    error = motion(true, motion(a, b))
    return RelationErrors(
        np.linalg.norm(error[:, :2], axis=1),
        np.abs(wrapped(error[:, 2])),
        int((~inside).sum()),
        stamps.min(axis=1),
    )


def poses_at(estimate: Trajectory, stamps: FloatArray, odometry: Trajectory) -> FloatArray:
    """Return (n, 3) the estimated poses nearest in time, carried to the stamps by odometry where far.

    Args:
        estimate: not empty.
        stamps: (n,) seconds.
        odometry: not empty, in any frame.
    """
    near = _nearest(estimate.stamps, stamps)
    poses, there = planar(estimate)[near], estimate.stamps[near]
    step = motion(odometry.planar_at(there), odometry.planar_at(stamps))
    step[np.abs(there - stamps) <= CARRIED] = 0.0
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    return poses + np.column_stack(
        (c * step[:, 0] - s * step[:, 1], s * step[:, 0] + c * step[:, 1], step[:, 2])
    )


def _nearest(stamps: FloatArray, wanted: FloatArray) -> NDArray[np.intp]:
    """Return (n,) which of the stamps, increasing, is nearest; of two that are, the earlier."""
    after = np.clip(np.searchsorted(stamps, wanted), 0, len(stamps) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(wanted - stamps[before] <= stamps[after] - wanted, before, after)
