"""Trajectories in the TUM format: `stamp x y z qx qy qz qw` a line, as evo reads them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lirs_wct.errors import ConfigError, SourceError
from lirs_wct.files import atomic_write
from lirs_wct.trajectory import Trajectory

HEADER = "# stamp[s] x y z[m] qx qy qz qw"


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """Write a trajectory; every number reads back to the nanometre and the nanosecond.

    Raises:
        OutputError: the file cannot be written.
    """
    rows = np.column_stack(
        (trajectory.stamps, trajectory.positions, np.roll(trajectory.quaternions, -1, axis=1))
    )
    with atomic_write(path) as temporary:
        np.savetxt(temporary, rows, fmt="%.9f", header=HEADER, comments="")


def read_tum(path: Path) -> Trajectory:
    """Read a trajectory.

    Raises:
        SourceError: missing, or not eight numbers a line with stamps that increase.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
        rows = np.array([line.split() for line in lines if line and line[0] != "#"], dtype=np.float64)
        if rows.shape[1:] != (8,) or not np.isfinite(rows).all():
            raise SourceError(f"{path}: a TUM trajectory has eight finite numbers a line")
        quaternions = np.roll(rows[:, 4:], 1, axis=1)
        quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
        return Trajectory(rows[:, 0], rows[:, 1:4], quaternions)
    except OSError as error:
        raise SourceError(f"{path}: {error.strerror or 'no such file'}") from error
    except (ValueError, ConfigError) as error:
        raise SourceError(f"{path}: not a TUM trajectory: {error}") from error
