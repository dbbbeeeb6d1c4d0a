"""Ground of a point cloud by the simple morphological filter (SMRF).

T. J. Pingel, K. C. Clarke, W. A. McBride: An improved simple morphological filter for the terrain
classification of airborne LIDAR data. ISPRS Journal of Photogrammetry and Remote Sensing 77 (2013), 21-30.
Here gaps are filled linearly, in the paper by springs.

The paper's best slope grows with the terrain's own slope (section 4.3). With one slope for all sites, summits
and ridges of mountains count as objects. Here the slope limit follows the terrain where that is steep.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import scipy  # its modules load on first use
from numpy.typing import NDArray

from lirs_wct.arrays import BoolArray, FloatArray
from lirs_wct.errors import Checked, limited
from lirs_wct.geometry.grid import nearest_values

SMOOTH = 2.0
"""Standard deviation of the Gaussian that smooths slopes, nodes."""


@dataclass(frozen=True, slots=True)
class NodeGrid:
    """Nodes over an extent in the plane; row 0 = south.

    Attributes:
        west: x of the first column, meters.
        south: y of the first row, meters.
        spacing: distance of adjacent nodes, meters.
        shape: rows and columns.
    """

    west: float
    south: float
    spacing: float
    shape: tuple[int, int]

    @staticmethod
    def over(xy: FloatArray, spacing: float) -> NodeGrid:
        """Return the grid over all points (n, 2), from their smallest coordinates."""
        (west, south), (east, north) = xy.min(axis=0).tolist(), xy.max(axis=0).tolist()
        rows, cols = (
            max(2, int(np.ceil(side / spacing - 1e-9)) + 1) for side in (north - south, east - west)
        )
        return NodeGrid(west, south, spacing, (rows, cols))

    def node_of(self, xy: FloatArray) -> NDArray[np.int64]:
        """Return (n,) the nearest node of each point, as an index into the flat grid."""
        col = np.rint((xy[:, 0] - self.west) / self.spacing).astype(np.int64)
        row = np.rint((xy[:, 1] - self.south) / self.spacing).astype(np.int64)
        rows, cols = self.shape
        return np.clip(row, 0, rows - 1) * cols + np.clip(col, 0, cols - 1)

    def lowest(self, xyz: FloatArray) -> FloatArray:
        """Return (rows, cols) heights of the lowest point at each node; NaN without a point."""
        z = np.full(self.shape, np.inf)
        np.minimum.at(z.ravel(), self.node_of(xyz), xyz[:, 2])
        return np.where(np.isfinite(z), z, np.nan)

    def mean(self, xyz: FloatArray) -> FloatArray:
        """Return (rows, cols) mean heights of the points at each node; NaN without a point.

        The points' centroid differs from the node: the local slope moves their mean height to the node.
        """
        node, size = self.node_of(xyz), self.shape[0] * self.shape[1]
        row, col = np.divmod(node, self.shape[1])
        count = np.bincount(node, minlength=size)
        z, east, north = (
            np.divide(np.bincount(node, v, size), count, out=np.full(size, np.nan), where=count > 0).reshape(
                self.shape
            )
            for v in (
                xyz[:, 2],
                (xyz[:, 0] - self.west) / self.spacing - col,
                (xyz[:, 1] - self.south) / self.spacing - row,
            )
        )
        level: FloatArray = z
        for _ in range(2):
            gradient = np.gradient(nearest_values(level, np.isnan(level)))
            slope_y, slope_x = (scipy.ndimage.gaussian_filter(g, SMOOTH, mode="nearest") for g in gradient)
            level = z - slope_x * east - slope_y * north
        return level

    def sample(self, values: FloatArray, xy: FloatArray) -> FloatArray:
        """Return (n,) values of the grid at points, linearly interpolated."""
        at = ((xy[:, 1] - self.south) / self.spacing, (xy[:, 0] - self.west) / self.spacing)
        sampled: FloatArray = scipy.ndimage.map_coordinates(values, at, order=1, mode="nearest")
        return sampled


def fill_gaps(values: FloatArray) -> FloatArray:
    """Return the grid with its gaps (NaN) interpolated linearly over triangles between their rims.

    A plane stays a plane. Outside the rims' hull a node takes its nearest value.
    """
    missing = np.isnan(values)
    if not missing.any():
        return values
    rim = scipy.ndimage.binary_dilation(missing, np.ones((3, 3), np.bool_)) & ~missing
    known, wanted = np.argwhere(rim), np.argwhere(missing)
    out = nearest_values(values, missing)
    if np.linalg.matrix_rank(known - known[:1]) == 2:  # not all on a line
        linear = scipy.interpolate.LinearNDInterpolator(known, values[rim])(wanted)
        there = np.isfinite(linear)
        out[tuple(wanted[there].T)] = linear[there]
    return out


MAX_CELLS, CELLS_PER_POINT = 1e7, 1000.0
"""Cells of the grid, and cells per point, one of which may be exceeded."""
MAX_SLOPE = 5.0
"""Slope limit for low outliers, rise over run (section 2.2)."""


@dataclass(frozen=True, kw_only=True)
class Smrf(Checked):
    """Parameters of SMRF, by default the paper's values for all sites (section 4.2).

    Attributes:
        slope: steepest ground, rise over run.
        mountain: mean slope around a cell above which this mean replaces `slope`; inf = nowhere.
        window: radius of the largest object, meters.
        threshold: largest height of a ground point over the provisional ground, meters, on level ground.
        scaling: increase of `threshold` per unit of slope, meters.
        cell: smallest cell of the grid on which objects are found, meters.
    """

    slope: float = limited(0.15, "(0, inf]")
    mountain: float = limited(0.4, "(0, inf]")
    window: float = limited(18.0, "(0, inf]")
    threshold: float = limited(0.5, "(0, inf]")
    scaling: float = limited(1.25, "(0, inf]")
    cell: float = limited(1.0, "(0, inf]")


def ground_points(xyz: FloatArray, options: Smrf) -> tuple[BoolArray, float]:
    """Return the mask (n,) of ground points, and the share of mountains.

    The grid of lowest points is opened by growing disks. A cell that an opening lowers by more than the slope
    allows is an object. The other cells, with filled gaps, are the provisional ground; the points near it are
    the ground (the paper's steps 1 to 4).
    """
    grid, window = node_grid(xyz, options)
    lowest = grid.lowest(xyz)
    empty = np.isnan(lowest)
    surface = fill_gaps(lowest)
    wrong = empty | _objects(-surface, MAX_SLOPE, grid.spacing, grid.spacing)
    surface = fill_gaps(np.where(wrong, np.nan, surface))
    objects = _objects(surface, options.slope, window, grid.spacing)
    provisional = fill_gaps(np.where(wrong | objects, np.nan, surface))
    around = _mean_slope(provisional, window, grid.spacing)
    mountains = around > options.mountain
    if mountains.any():
        limits = np.where(mountains, around, options.slope)
        objects = _objects(surface, limits, window, grid.spacing)
        provisional = fill_gaps(np.where(wrong | objects, np.nan, surface))
    north, east = np.gradient(provisional, grid.spacing)
    limit = options.threshold + options.scaling * np.hypot(north, east)
    off = np.abs(xyz[:, 2] - grid.sample(provisional, xyz[:, :2]))
    return off <= grid.sample(limit, xyz[:, :2]), float(mountains.mean())


def node_grid(xyz: FloatArray, options: Smrf) -> tuple[NodeGrid, float]:
    """Return the grid on which objects are found, and the radius of the largest, meters."""
    sides = np.ptp(xyz[:, :2], axis=0)
    extent = float(sides.min())
    window = min(options.window, extent / 3)
    coarsest = math.sqrt(float(sides.prod()) / max(MAX_CELLS, CELLS_PER_POINT * len(xyz)))
    return NodeGrid.over(xyz[:, :2], max(min(options.cell, extent / 30), window / 36, coarsest)), window


def _mean_slope(surface: FloatArray, window: float, cell: float) -> FloatArray:
    """Return (rows, cols) mean slopes by a Gaussian of half a window.

    A crest thus has the slope of its flanks.
    """
    north, east = np.gradient(scipy.ndimage.gaussian_filter(surface, SMOOTH, mode="nearest"), cell)
    mean: FloatArray = scipy.ndimage.gaussian_filter(np.hypot(north, east), window / 2 / cell, mode="nearest")
    return mean


def _objects(surface: FloatArray, slope: float | FloatArray, window: float, cell: float) -> BoolArray:
    """Return (rows, cols) whether openings by disks up to `window` lower cells too much."""
    last = surface.astype(np.float32)
    found = np.zeros(surface.shape, np.bool_)
    for radius in range(1, max(1, round(window / cell)) + 1):
        disk = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1,) * 2)
        # Padded with its border values: an opening at the border sees no lower ground outside.
        wide = cv2.copyMakeBorder(last, *(2 * radius,) * 4, cv2.BORDER_REPLICATE)
        opened = cv2.morphologyEx(wide, cv2.MORPH_OPEN, disk)
        inner = (slice(2 * radius, -2 * radius),) * 2
        following = np.asarray(opened[inner], np.float32)
        found |= last - following > slope * cell * radius
        last = following
    return found
