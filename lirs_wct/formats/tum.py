"""Trajectories in the TUM format, as evo reads: `stamp x y z qx qy qz qw`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lirs_wct.arrays import FloatArray
from lirs_wct.errors import ConfigError, SourceError
from lirs_wct.files import atomic_write, read_gzipped
from lirs_wct.geometry.pose import Trajectory

FARTHEST = 1e9
"""Largest coordinate, meters; squares of far larger ones overflow."""
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


def read_tum(path: Path) -> Trajectory:
    """Read a trajectory, gzipped or not.

    Raises:
        SourceError: missing or damaged, or not eight finite numbers a line with stamps that increase.
    """
    data = read_gzipped(path)
    try:
        lines = [line.split() for line in data.decode().splitlines()]
        rows = [[float(word) for word in words] for words in lines if words and words[0][0] != "#"]
    except ValueError as error:
        raise SourceError(f"{path}: not a TUM trajectory: {error}") from error
    if not rows or any(len(row) != 8 for row in rows) or not np.isfinite(rows).all():
        raise SourceError(f"{path}: a TUM trajectory has eight finite numbers a line")
    table = np.array(rows)
    if (farthest := float(np.abs(table[:, 1:4]).max())) > FARTHEST:
        raise SourceError(f"{path}: a position must be within {FARTHEST:.0e} m, got {farthest:.3g} m")
    return _trajectory(path, table)


def _trajectory(path: Path, rows: FloatArray) -> Trajectory:
    """Build a trajectory from rows (n, 8) in the column order of the file."""
    quaternions = np.roll(rows[:, 4:], 1, axis=1)
    length = np.linalg.norm(quaternions, axis=1, keepdims=True)
    if not length.all():
        raise SourceError(f"{path}: not a TUM trajectory: a quaternion is zero")
    try:
        return Trajectory(rows[:, 0], rows[:, 1:4], quaternions / length)
    except ConfigError as error:
        raise SourceError(f"{path}: not a TUM trajectory: {error}") from error
