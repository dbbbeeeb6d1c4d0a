"""Elevation maps: mean height per cell, error against the true surface.

The points are those of the run's clouds, each placed by one pose: the mapper's for the built map, the true
one for the map at the true poses. So both hold the same points, and differ by the poses alone.
"""

from __future__ import annotations

import math
import zipfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lirs_validation.metrics.alignment import rms
from lirs_validation.metrics.near_obstacles import near_obstacle
from lirs_wct.arrays import BoolArray, FloatArray, IntArray
from lirs_wct.errors import SourceError, reason_of
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.geometry.walls import WallGrid
from lirs_wct.kernels import njit

CELL = 0.10
"""Edge of a cell, meters."""
MARGIN = 0.20
"""Cells so near a wall or a face steeper than 45 deg are not judged, meters: what lies in them is one side of
it, and no height of the ground."""


@dataclass(frozen=True)
class ElevationMap:
    """Mean heights on a grid in the world frame.

    Attributes:
        mean: (rows, cols) meters, row 0 = south; NaN = no point there.
        cell: edge of a cell, meters.
        origin: x, y of the south-west corner, meters.
    """

    mean: FloatArray
    cell: float
    origin: tuple[float, float]

    @property
    def seen(self) -> BoolArray:
        """(rows, cols) which cells hold a point."""
        return ~np.isnan(self.mean)

    @property
    def centers(self) -> FloatArray:
        """(rows * cols, 2) x, y of the cells' centers, row by row, meters."""
        rows, cols = self.mean.shape
        x = self.origin[0] + (np.arange(cols) + 0.5) * self.cell
        y = self.origin[1] + (np.arange(rows) + 0.5) * self.cell
        return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)

    def error(self, surface: HeightField, walls: WallGrid | None) -> FloatArray:
        """Return (rows, cols) mean height less the surface's at the cell's center, meters.

        NaN where no point lies, off the surface, and within MARGIN of a wall or a face steeper than 45 deg.
        """
        seen = self.seen.ravel()
        xy = self.centers[seen]
        found = self.mean.ravel()[seen] - surface.height_at(xy[:, 0], xy[:, 1])
        found[near_obstacle(xy, surface, walls, MARGIN)] = np.nan
        error = np.full(self.mean.size, np.nan)
        error[seen] = found
        return error.reshape(self.mean.shape)


@dataclass(frozen=True, kw_only=True)
class ElevationScores:
    """The metrics of one elevation map; None where no cell is left to judge.

    Attributes:
        elevation_rmse: root mean square difference between the built map and the true surface, meters.
        elevation_rmse_aligned: the same after the alignment of the trajectory in space; None without one.
        elevation_seen: share of the cells that could be seen (in the map of the true poses) that the built
            map holds.
        reference_elevation_rmse: elevation_rmse of the map of the true poses: what cells, noise and slopes
            make of it without any error of the poses.
    """

    elevation_rmse: float | None
    elevation_rmse_aligned: float | None
    elevation_seen: float | None
    reference_elevation_rmse: float | None


def elevation_map(points: Iterable[FloatArray], bounds: tuple[float, float, float, float]) -> ElevationMap:
    """Return the elevation map of points.

    Args:
        points: arrays (n, 3) in the world frame, meters.
        bounds: west, south, east, north of the map, meters; points beyond are left out.
    """
    west, south, east, north = bounds
    shape = max(1, math.ceil((north - south) / CELL - 1e-9)), max(1, math.ceil((east - west) / CELL - 1e-9))
    total, count = np.zeros(shape), np.zeros(shape, np.int64)
    for part in points:
        _add(np.ascontiguousarray(part, dtype=np.float64), (west, south), CELL, total, count)
    return ElevationMap(np.where(count > 0, total / np.maximum(count, 1), np.nan), CELL, (west, south))


def elevation_scores(
    built: ElevationMap,
    reference: ElevationMap,
    aligned: ElevationMap | None,
    *,
    surface: HeightField,
    walls: WallGrid | None = None,
) -> ElevationScores:
    """Score a built elevation map.

    Args:
        built: by the mapper's poses, moved by the true start pose.
        reference: of the same clouds by the true poses, on the same grid.
        aligned: by the mapper's poses after the alignment of the trajectory, where there is one.
        surface: the world's ground.
        walls: the world's walls.
    """
    could = reference.error(surface, walls)
    visible = ~np.isnan(could)
    return ElevationScores(
        elevation_rmse=_rms(built.error(surface, walls)),
        elevation_rmse_aligned=None if aligned is None else _rms(aligned.error(surface, walls)),
        elevation_seen=float(built.seen[visible].mean()) if visible.any() else None,
        reference_elevation_rmse=_rms(could),
    )


def _rms(error: FloatArray) -> float | None:
    known = error[~np.isnan(error)]
    return rms(known) if len(known) else None


@njit(cache=True)
def _add(
    points: FloatArray, corner: tuple[float, float], cell: float, total: FloatArray, count: IntArray
) -> None:
    """Add the heights of points (n, 3) to their cells, in place."""
    rows, cols = total.shape
    for k in range(len(points)):
        col = math.floor((points[k, 0] - corner[0]) / cell)
        row = math.floor((points[k, 1] - corner[1]) / cell)
        if 0 <= row < rows and 0 <= col < cols:
            total[row, col] += points[k, 2]
            count[row, col] += 1


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
