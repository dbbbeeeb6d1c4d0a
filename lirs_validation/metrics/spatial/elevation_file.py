"""Elevation maps of a run as a file: `elevation.npz`, NumPy's own."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from lirs_validation.metrics.spatial.elevation import ElevationMap
from lirs_wct.errors import SourceError, reason_of

ELEVATION = "elevation.npz"


def write_elevation(path: Path, built: ElevationMap, true_pose: ElevationMap) -> None:
    """Write two elevation maps on one grid: `built` and `true_pose` (rows, cols), `cell` and `origin`."""
    arrays = {
        name: grid.mean.astype(np.float32) for name, grid in (("built", built), ("true_pose", true_pose))
    }
    np.savez_compressed(path, cell=built.cell, origin=np.array(built.origin), **arrays)  # type: ignore[arg-type]


def read_elevation(path: Path) -> tuple[ElevationMap, ElevationMap]:
    """Read the map by the mapper's poses and that by the true ones.

    Raises:
        SourceError: missing or damaged.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            cell, (x, y) = float(file["cell"]), file["origin"].tolist()
            grids = [file[name].astype(np.float64) for name in ("built", "true_pose")]
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise SourceError(f"{path}: no elevation maps, or damaged: {reason_of(error)}") from error
    built, true_pose = (ElevationMap(grid, cell, (x, y)) for grid in grids)
    return built, true_pose
