"""Coverage: the ground that a lidar has observed, the reward of mapping."""

from __future__ import annotations

import math

import numpy as np

from lirs_envs.lidar.presets import ring_directions
from lirs_wct.arrays import BoolArray, FloatArray
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.geometry.pose import Pose3
from lirs_wct.geometry.scan import LaserScan
from lirs_wct.kernels import njit


class CoverageGrid:
    """Grid of the world's cells that a beam has passed over or ended in, from true poses.

    Args:
        surface: its bounds are the grid's.
        resolution: metres a cell.
    """

    def __init__(self, surface: HeightField, resolution: float = 0.25) -> None:
        west, south, east, north = surface.bounds
        self.resolution = resolution
        self._corner = (west, south)
        shape = math.ceil((north - south) / resolution), math.ceil((east - west) / resolution)
        self.observed: BoolArray = np.zeros(shape, np.bool_)

    @property
    def area(self) -> float:
        """Observed area so far, square metres."""
        return float(self.observed.sum()) * self.resolution**2

    def add(self, scan: LaserScan, T_world_base: Pose3) -> float:
        """Mark the cells under a scan; return the newly observed area, square metres.

        A beam without return observes its whole range; one that is too near or invalid nothing.
        """
        ranges = np.where(np.isposinf(scan.ranges), np.float32(scan.range_max), scan.ranges)
        ranges = np.where(np.isfinite(ranges), ranges, np.float32(0)).astype(np.float64)
        T = T_world_base @ scan.T_base_laser
        beams = ring_directions(scan.angles) @ T.rotation.T
        start = (T.x - self._corner[0], T.y - self._corner[1])
        new = _mark(self.observed, beams, ranges, start, self.resolution)
        return float(new) * self.resolution**2


@njit(cache=True)
def _mark(
    observed: BoolArray,
    beams: FloatArray,
    ranges: FloatArray,
    start: tuple[float, float],
    resolution: float,
) -> int:
    """Mark cells along beams at steps of half a cell; return how many were new."""
    rows, cols = observed.shape
    new = 0
    for k in range(len(ranges)):
        steps = int(2 * ranges[k] / resolution) + 1 if ranges[k] > 0 else 0
        for i in range(steps):
            t = 0.5 * i * resolution
            c = math.floor((start[0] + t * beams[k, 0]) / resolution)
            r = math.floor((start[1] + t * beams[k, 1]) / resolution)
            if r < 0 or c < 0 or r >= rows or c >= cols:
                break
            if not observed[r, c]:
                observed[r, c] = True
                new += 1
    return new
