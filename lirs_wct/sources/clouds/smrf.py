"""The ground of a point cloud: the simple morphological filter (SMRF).

T. J. Pingel, K. C. Clarke, W. A. McBride: An improved simple morphological filter for the terrain
classification of airborne LIDAR data. ISPRS Journal of Photogrammetry and Remote Sensing 77 (2013), 21-30.
Gaps are filled linearly here, by springs there.

The paper's best slope grows with the terrain's own (section 4.3); with one slope for all sites, summits and
ridges of mountains are objects. Here the slope follows the terrain where that is steep.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from scipy import ndimage

from lirs_wct.arrays import BoolArray, FloatArray
from lirs_wct.errors import ConfigError
from lirs_wct.field_validators import require_above
from lirs_wct.sources.clouds.grid import SMOOTH, NodeGrid, filled

STEEPEST = 5.0
"""Rise over run of what is lower than the ground: wrong points (section 2.2)."""


@dataclass(frozen=True, kw_only=True)
class Smrf:
    """Parameters, at the paper's values for all of its test sites (section 4.2).

    Attributes:
        slope: steepest ground, rise over run ...
        mountain: ... but where the mean slope around is above this one, it is that mean; inf = nowhere.
        window: radius of the largest object, meters.
        threshold: height of a point over the provisional ground at which it is still ground, meters ...
        scaling: ... and what the ground's slope adds to it, meters.
        cell: of the grid on which objects are found, meters, at least.

    Raises:
        ConfigError: a value is not above 0.
    """

    slope: float = 0.15
    mountain: float = 0.4
    window: float = 18.0
    threshold: float = 0.5
    scaling: float = 1.25
    cell: float = 1.0

    def __post_init__(self) -> None:
        require_above(self, 0, "slope", "window", "threshold", "scaling", "cell")
        if not self.mountain > 0:
            raise ConfigError(f"mountain must be above 0, got {self.mountain}")


class GroundPoints(NamedTuple):
    """What is ground in a cloud.

    Attributes:
        found: (n,) which points are on the ground.
        mountains: share of the area where the ground's own slope was its limit.
    """

    found: BoolArray
    mountains: float


def ground_points(xyz: FloatArray, options: Smrf) -> GroundPoints:
    """Return which of the points (n, 3) are on the ground.

    The lowest points a cell are opened by growing disks; a cell that an opening lowers by more than the
    slope allows is an object. What is left, its gaps filled, is the provisional ground, and the points
    near it are the ground (the paper's steps 1 to 4).
    """
    extent = float(np.ptp(xyz[:, :2], axis=0).min())
    window = min(options.window, extent / 3)
    grid = NodeGrid.over(xyz[:, :2], max(min(options.cell, extent / 30), window / 36))
    lowest = grid.lowest(xyz)
    empty = np.isnan(lowest)
    surface = filled(lowest)
    wrong = empty | _objects(-surface, STEEPEST, grid.spacing, grid.spacing)
    surface = filled(np.where(wrong, np.nan, surface))
    provisional = _provisional(surface, wrong, options.slope, window, grid.spacing)
    around = _mean_slope(provisional, window, grid.spacing)
    mountains = around > options.mountain
    if mountains.any():
        limits = np.where(mountains, around, options.slope)
        provisional = _provisional(surface, wrong, limits, window, grid.spacing)
    north, east = np.gradient(provisional, grid.spacing)
    limit = options.threshold + options.scaling * np.hypot(north, east)
    off = np.abs(xyz[:, 2] - grid.sampled(provisional, xyz[:, :2]))
    return GroundPoints(off <= grid.sampled(limit, xyz[:, :2]), float(mountains.mean()))


def _provisional(
    surface: FloatArray, wrong: BoolArray, slope: float | FloatArray, window: float, cell: float
) -> FloatArray:
    """Return the surface without objects, its gaps filled."""
    return filled(np.where(wrong | _objects(surface, slope, window, cell), np.nan, surface))


def _mean_slope(surface: FloatArray, window: float, cell: float) -> FloatArray:
    """Return (rows, cols) the mean slope around, by a Gaussian of half a window: a crest's is its flanks'."""
    north, east = np.gradient(ndimage.gaussian_filter(surface, SMOOTH, mode="nearest"), cell)
    mean: FloatArray = ndimage.gaussian_filter(np.hypot(north, east), window / 2 / cell, mode="nearest")
    return mean


def _objects(surface: FloatArray, slope: float | FloatArray, window: float, cell: float) -> BoolArray:
    """Return (rows, cols) which cells an opening by a disk of up to `window` lowers by too much."""
    last = surface.astype(np.float32)
    found = np.zeros(surface.shape, np.bool_)
    for radius in range(1, max(1, round(window / cell)) + 1):
        disk = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1,) * 2)
        # Continued by its border values: an opening at the border sees no lower ground outside.
        wide = cv2.copyMakeBorder(last, *(2 * radius,) * 4, cv2.BORDER_REPLICATE)
        opened = cv2.morphologyEx(wide, cv2.MORPH_OPEN, disk)
        inner = (slice(2 * radius, -2 * radius),) * 2
        following = np.asarray(opened[inner], np.float32)
        found |= last - following > slope * cell * radius
        last = following
    return found
