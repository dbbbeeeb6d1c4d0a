"""Occupancy map of the original, drawn along the path of the best particle."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from lirs_wct.arrays import BoolArray, FloatArray
from lirs_wct.geometry import OccupancyGrid, Pose2
from lirs_wct.kernels import njit
from slam_baselines.mapping.growing_grid import GrowingGrid
from slam_baselines.mapping.ray_tracing import line_cells


class ProcessedScan(NamedTuple):
    """Processed scan, kept for the map.

    Attributes:
        laser: (2,) in the base frame, meters.
        ends: (n, 2) of beams in the base frame, meters.
        hits: (n,) whether an end is a hit; else a long beam leaves the usable range there.
    """

    laser: FloatArray
    ends: FloatArray
    hits: BoolArray


def path_map(
    path: FloatArray, scans: Sequence[ProcessedScan], delta: float, occ_thresh: float
) -> OccupancyGrid:
    """Draw scans at their poses; cells are occupied, free or unknown as in slam_gmapping.

    Args:
        path: (n, 3) x, y, yaw of `T_map_base`, of each scan.
        scans: n of them.
        delta: edge of a cell, meters.
        occ_thresh: share of hits among the beams through a cell above which it is occupied.
    """
    grid = GrowingGrid(delta, {"hits": (np.int32, 0), "visits": (np.int32, 0)})
    for pose, scan in zip(path.tolist(), scans, strict=True):
        T_map_base = Pose2(*pose)
        points = np.vstack((T_map_base.apply(scan.laser[None]), T_map_base.apply(scan.ends)))
        grid.ensure(*points.min(axis=0), *points.max(axis=0))
        # Cell (0, 0) has its center in the origin, as in the maps that are matched against.
        cells = np.floor(points / delta + 0.5).astype(np.int64) - (grid.col0, grid.row0)
        _draw(grid.layers["hits"], grid.layers["visits"], cells, scan.hits)
    return _occupancy(grid, occ_thresh)


def _occupancy(grid: GrowingGrid, occ_thresh: float) -> OccupancyGrid:
    hits, visits, delta = grid.layers["hits"], grid.layers["visits"], grid.resolution
    if not visits.any():
        return OccupancyGrid(np.full((1, 1), np.nan, np.float32), delta)
    rows, cols = (np.flatnonzero(visits.any(axis=axis)) for axis in (1, 0))
    box = slice(rows[0], rows[-1] + 1), slice(cols[0], cols[-1] + 1)
    occupied = hits[box] > occ_thresh * visits[box]
    p = np.where(visits[box] > 0, occupied, np.nan)
    corner = Pose2((grid.col0 + cols[0] - 0.5) * delta, (grid.row0 + rows[0] - 0.5) * delta)
    return OccupancyGrid.from_probability(p, delta, corner)


@njit(cache=True, nogil=True)
def _draw(hits: Any, visits: Any, cells: Any, is_hit: Any) -> None:
    """Count the beams from cells[0] to all others, each (col, row)."""
    for k in range(1, len(cells)):
        for row, col in line_cells(cells[0, 1], cells[0, 0], cells[k, 1], cells[k, 0]):
            visits[row, col] += 1
        if is_hit[k - 1]:
            row, col = cells[k, 1], cells[k, 0]
            visits[row, col] += 1
            hits[row, col] += 1
