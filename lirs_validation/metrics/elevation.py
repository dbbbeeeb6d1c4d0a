"""Elevation maps: mean height per cell, error against the true surface.

The points are those of the run's clouds, each placed by one pose: the mapper's for the built map, the true
one for the map at the true poses. So both hold the same points, and differ by the poses alone.
"""

from __future__ import annotations

import math
import zipfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from lirs_validation.metrics.map import near_obstacle
from lirs_validation.metrics.trajectory import associated, rms, spatial_alignment
from lirs_wct import HeightField, PointCloud, Pose3, Trajectory, WallGrid, World
from lirs_wct.arrays import BoolArray, FloatArray, IntArray, njit
from lirs_wct.errors import SourceError, reason_of

ELEVATION = "elevation.npz"
"""File of a run's elevation maps."""
CELL = 0.10
"""Edge of a cell, meters."""
MIN_WIDTH = 0.1
"""A path whose width is a smaller share of its length does not say how it is turned about itself."""
MAX_CLOUDS = 240
"""Clouds that are kept at a time, some 100 MB of them; beyond, every second one is dropped."""
OBSTACLE_DISTANCE = 0.20
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

        NaN where no point lies, off the surface, and near a wall or a face steeper than 45 deg.
        """
        seen = self.seen.ravel()
        xy = self.centers[seen]
        found = self.mean.ravel()[seen] - surface.height_at(xy[:, 0], xy[:, 1])
        found[near_obstacle(xy, surface, walls, OBSTACLE_DISTANCE)] = np.nan
        error = np.full(self.mean.size, np.nan)
        error[seen] = found
        return error.reshape(self.mean.shape)


@dataclass(frozen=True, kw_only=True)
class ElevationScores:
    """The metrics of one elevation map; None where no cell is left to judge.

    Attributes:
        elevation_rmse: Root mean square difference between the built map and the true surface, meters.
        elevation_rmse_aligned: Difference after the alignment of the trajectory in space; None without one.
        elevation_seen: Share of the cells that could be seen (in the map of the true poses) that the built
            map holds.
        reference_elevation_rmse: Difference of the map of the true poses, by cells, noise and slopes alone.
    """

    elevation_rmse: float | None = None
    elevation_rmse_aligned: float | None = None
    elevation_seen: float | None = None
    reference_elevation_rmse: float | None = None


def elevation_map(points: Iterable[FloatArray], bounds: tuple[float, float, float, float]) -> ElevationMap:
    """Return the elevation map of points (n, 3) in the world frame, meters.

    Those beyond the bounds, west, south, east and north of the map, are left out.
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
    """Score an elevation map by the mapper's poses, moved by the true start pose.

    The reference holds the same clouds by the true poses, `aligned` by the poses after alignment, on one
    grid.
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


@njit
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


def write_elevation(path: Path, built: ElevationMap, true_pose: ElevationMap) -> None:
    """Write two elevation maps on one grid: `built` and `true_pose` (rows, cols), `cell` and `origin`."""
    arrays = {
        name: grid.mean.astype(np.float32) for name, grid in (("built", built), ("true_pose", true_pose))
    }
    np.savez_compressed(path, cell=built.cell, origin=np.array(built.origin), **arrays)  # type: ignore[arg-type]


def read_elevation(path: Path) -> tuple[ElevationMap, ElevationMap]:
    """Read the map by the mapper's poses and that by the true ones."""
    try:
        with np.load(path, allow_pickle=False) as file:
            cell, (x, y) = float(file["cell"]), file["origin"].tolist()
            grids = [file[name].astype(np.float64) for name in ("built", "true_pose")]
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise SourceError(f"{path}: no elevation maps, or damaged: {reason_of(error)}") from error
    built, true_pose = (ElevationMap(grid, cell, (x, y)) for grid in grids)
    return built, true_pose


@dataclass(frozen=True)
class Elevations:
    """Elevation maps of a run in the world frame, on one grid."""

    built: ElevationMap
    true_pose: ElevationMap


def evaluate_elevation(
    world: World, sample: CloudSample, truth: Trajectory, estimate: Trajectory
) -> tuple[Elevations | None, ElevationScores]:
    """Return elevation maps and metrics of a run; a world with overhangs has none.

    True poses of all scans and final poses of the mapper (moved by the true start pose) are in the world
    frame.
    """
    if world.overhangs:
        return None, ElevationScores()
    reach = max((float(np.linalg.norm(c.xyz, axis=1).max()) for c in sample.clouds if len(c)), default=0.0)
    low, high = truth.xy.min(axis=0) - reach, truth.xy.max(axis=0) + reach
    west, south, east, north = world.surface.bounds
    bounds = max(west, low[0]), max(south, low[1]), min(east, high[0]), min(north, high[1])
    built = elevation_map(_place_clouds(sample, truth, estimate), bounds)
    true_pose = elevation_map(_place_clouds(sample, truth, truth), bounds)
    T = _alignment(truth, estimate)
    aligned = None if T is None else elevation_map(_place_clouds(sample, truth, estimate.moved(T)), bounds)
    scores = elevation_scores(built, true_pose, aligned, surface=world.surface, walls=world.walls)
    return Elevations(built, true_pose), scores


def _place_clouds(sample: CloudSample, truth: Trajectory, poses: Trajectory) -> Iterator[FloatArray]:
    """Yield the points (n, 3) of each cloud that has a pose, placed by it."""
    i, j = associated(truth.stamps[sample.scans], poses.stamps)
    for k, pose in zip(i.tolist(), j.tolist(), strict=True):
        cloud = sample.clouds[k]
        T_world_base = Pose3.from_arrays(poses.positions[pose], poses.quaternions[pose])
        yield (T_world_base @ cloud.T_base_laser).apply(cloud.xyz)


def _alignment(truth: Trajectory, estimate: Trajectory) -> Pose3 | None:
    """Return the spatial alignment; None if the path leaves a rotation undetermined."""
    i, j = associated(truth.stamps, estimate.stamps)
    if len(i) < 3:
        return None
    true = truth.positions[i]
    spread = np.linalg.svd(true - true.mean(axis=0), compute_uv=False)
    if spread[1] < MIN_WIDTH * spread[0]:
        return None
    return spatial_alignment(estimate.positions[j], true)


@dataclass
class CloudSample:
    """Sample of clouds spread evenly over a drive: one per second, fewer on longer drives.

    Attributes:
        clouds: Kept clouds, without the points on walkers.
        scans: Number of each cloud's scan.
        period: Seconds from one cloud to the next.
    """

    clouds: list[PointCloud] = field(default_factory=list)
    scans: list[int] = field(default_factory=list)
    period: float = 1.0

    def offer(self, scan: int, cloud: PointCloud, walkers: BoolArray | None = None) -> None:
        """Keep a scan's cloud without its points on walkers (n,), if it is due."""
        if self.clouds and cloud.stamp < self.clouds[-1].stamp + self.period - 1e-9:
            return
        self.clouds.append(cloud if walkers is None else cloud.select(~walkers))
        self.scans.append(scan)
        if len(self.clouds) > MAX_CLOUDS:
            self.clouds, self.scans, self.period = self.clouds[::2], self.scans[::2], 2 * self.period
