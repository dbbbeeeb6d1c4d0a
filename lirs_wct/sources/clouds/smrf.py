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
from typing import NamedTuple

import cv2
import numpy as np
import scipy  # its modules load on first use

from lirs_wct.arrays import BoolArray, FloatArray
from lirs_wct.checks import Checked, limited
from lirs_wct.sources.clouds.grid import SMOOTH, NodeGrid, fill_gaps

MOST_CELLS, SPARSEST = 1e7, 1000.0
"""Cells of the grid, and cells per point, one of which may be exceeded."""
STEEPEST = 5.0
"""Slope limit for low outliers, rise over run (section 2.2)."""


@dataclass(frozen=True, kw_only=True)
class Smrf(Checked):
    """Parameters of SMRF, by default the paper's values for all of its test sites (section 4.2).

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


class GroundPoints(NamedTuple):
    """Ground points of a cloud.

    Attributes:
        found: (n,) whether a point is on the ground.
        mountains: share of the area where the terrain's own slope was the limit.
    """

    found: BoolArray
    mountains: float


def ground_points(xyz: FloatArray, options: Smrf) -> GroundPoints:
    """Return which of the points (n, 3) are on the ground.

    The grid of lowest points is opened by growing disks. A cell that an opening lowers by more than the slope
    allows is an object. The other cells, with filled gaps, are the provisional ground; the points near it are
    the ground (the paper's steps 1 to 4).
    """
    grid, window = node_grid(xyz, options)
    lowest = grid.lowest(xyz)
    empty = np.isnan(lowest)
    surface = fill_gaps(lowest)
    wrong = empty | _objects(-surface, STEEPEST, grid.spacing, grid.spacing)
    surface = fill_gaps(np.where(wrong, np.nan, surface))
    provisional = _provisional(surface, wrong, options.slope, window, grid.spacing)
    around = _mean_slope(provisional, window, grid.spacing)
    mountains = around > options.mountain
    if mountains.any():
        limits = np.where(mountains, around, options.slope)
        provisional = _provisional(surface, wrong, limits, window, grid.spacing)
    north, east = np.gradient(provisional, grid.spacing)
    limit = options.threshold + options.scaling * np.hypot(north, east)
    off = np.abs(xyz[:, 2] - grid.sample(provisional, xyz[:, :2]))
    return GroundPoints(off <= grid.sample(limit, xyz[:, :2]), float(mountains.mean()))


def node_grid(xyz: FloatArray, options: Smrf) -> tuple[NodeGrid, float]:
    """Return the grid on which objects are found, and the radius of the largest, meters."""
    sides = np.ptp(xyz[:, :2], axis=0)
    extent = float(sides.min())
    window = min(options.window, extent / 3)
    coarsest = math.sqrt(float(sides.prod()) / max(MOST_CELLS, SPARSEST * len(xyz)))
    return NodeGrid.over(xyz[:, :2], max(min(options.cell, extent / 30), window / 36, coarsest)), window


def _provisional(
    surface: FloatArray, wrong: BoolArray, slope: float | FloatArray, window: float, cell: float
) -> FloatArray:
    """Return the surface without objects and with filled gaps."""
    return fill_gaps(np.where(wrong | _objects(surface, slope, window, cell), np.nan, surface))


def _mean_slope(surface: FloatArray, window: float, cell: float) -> FloatArray:
    """Return (rows, cols) mean slopes by a Gaussian of half a window.

    A crest thus has the slope of its flanks.
    """
    north, east = np.gradient(scipy.ndimage.gaussian_filter(surface, SMOOTH, mode="nearest"), cell)
    mean: FloatArray = scipy.ndimage.gaussian_filter(np.hypot(north, east), window / 2 / cell, mode="nearest")
    return mean


def _objects(surface: FloatArray, slope: float | FloatArray, window: float, cell: float) -> BoolArray:
    """Return (rows, cols) whether an opening by a disk of up to `window` lowers a cell too much."""
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
