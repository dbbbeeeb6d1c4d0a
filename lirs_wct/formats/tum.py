"""Trajectories: TUM as evo reads (`stamp x y z qx qy qz qw`), EuRoC and KITTI."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from lirs_wct.arrays import FloatArray
from lirs_wct.errors import SourceError
from lirs_wct.files import atomic_write, read_gzipped
from lirs_wct.geometry.pose import Trajectory

FARTHEST = 1e9
"""Largest coordinate, meters; squares of far larger ones overflow."""
NANOSECONDS, PERIOD = 1e15, 1e5
"""Smallest stamp of a wall clock, and period of poses, in nanoseconds."""
HEADER = "# stamp[s] x y z[m] qx qy qz qw"


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """Write a trajectory, rounded to the nanometer and the nanosecond.

    Raises:
        OutputError: the file cannot be written.
    """
    rows = np.column_stack(
        (trajectory.stamps, trajectory.positions, np.roll(trajectory.quaternions, -1, axis=1))
    )
    with atomic_write(path) as temporary:
        np.savetxt(temporary, rows, fmt="%.9f", header=HEADER, comments="")


def read_tum(path: Path, scans: FloatArray | None = None) -> Trajectory:
    """Read a trajectory: TUM, EuRoC (commas, nanoseconds) or KITTI (12 numbers a line).

    Stamps may be out of order or repeat; of equal stamps the last pose counts, and a warning says so.

    Args:
        path: Path of the file, gzipped or not.
        scans: (n,) Stamps of the scans, seconds, which a KITTI file lacks.

    Raises:
        SourceError: missing, damaged, or of another form.
    """
    text = read_gzipped(path).decode("utf-8-sig", errors="replace")
    lines = [re.split(r"[,\s]+", line.strip(", \t")) for line in text.splitlines() if line.strip(", \t")]
    lines = [words for words in lines if not words[0].startswith("#")]
    try:
        rows = np.array([[float(word) for word in words] for words in lines])
    except ValueError as error:  # a word, or lines of different lengths
        raise SourceError(f"{path}: not a trajectory: {' '.join(str(error).split())[:100]}") from error
    width = rows.shape[1] if rows.ndim == 2 else 0
    if width not in (8, 12) and not (width > 8 and "," in text):
        raise SourceError(f"{path}: a trajectory has 8 numbers a line (TUM), 12 (KITTI) or commas (EuRoC)")
    if width == 12 and "," not in text:
        return _kitti(path, rows, scans)
    nanoseconds = rows[:, 0].max() > NANOSECONDS or np.median(np.abs(np.diff(rows[:, 0], prepend=0))) > PERIOD
    if nanoseconds and "," in text:  # EuRoC has w first
        rows[:, 4:8] = np.roll(rows[:, 4:8], -1, axis=1)
    rows = rows[:, :8] * np.where(np.arange(8) == 0, 1e-9 if nanoseconds else 1.0, 1.0)
    stamps, last = np.unique(rows[::-1, 0], return_index=True)
    unordered, equal = int((np.diff(rows[:, 0]) < 0).sum()), len(rows) - len(stamps)
    if unordered or equal:
        said = f"stamps go back {unordered} times, {equal} poses of equal stamps are left out"
        warnings.warn(f"{path}: {said}", stacklevel=2)
    return _trajectory(path, rows[::-1][last])


def _kitti(path: Path, rows: FloatArray, scans: FloatArray | None) -> Trajectory:
    """Return poses given as the upper three rows of a matrix each, one per scan."""
    if scans is None or len(scans) != len(rows):
        wanted = "stamps, as a TUM file has them" if scans is None else f"one pose per scan, {len(scans)}"
        raise SourceError(f"{path}: a KITTI file has no stamps: needs {wanted}, got {len(rows)} poses")
    matrices = rows.reshape(-1, 3, 4)
    if not (np.isfinite(rows).all() and np.allclose(np.linalg.det(matrices[:, :, :3]), 1.0, atol=0.1)):
        raise SourceError(f"{path}: not a KITTI trajectory: its matrices are no rotations")
    quaternions = Rotation.from_matrix(matrices[:, :, :3]).as_quat()
    return _trajectory(path, np.column_stack((scans, matrices[:, :, 3], quaternions)))


def _trajectory(path: Path, rows: FloatArray) -> Trajectory:
    """Build a trajectory from rows (n, 8) of a TUM file, with rising stamps."""
    length = np.linalg.norm(rows[:, 4:], axis=1, keepdims=True)
    if not (np.isfinite(rows).all() and length.all()):
        raise SourceError(f"{path}: not a trajectory: its numbers must be finite, and no quaternion zero")
    if (farthest := float(np.abs(rows[:, 1:4]).max())) > FARTHEST:
        raise SourceError(f"{path}: a position must be within {FARTHEST:.0e} m, got {farthest:.3g} m")
    return Trajectory(rows[:, 0], rows[:, 1:4], np.roll(rows[:, 4:], 1, axis=1) / length)
