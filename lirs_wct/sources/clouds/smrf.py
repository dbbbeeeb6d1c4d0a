"""The ground of a point cloud: the simple morphological filter (SMRF).

T. J. Pingel, K. C. Clarke, W. A. McBride: An improved simple morphological filter for the terrain
classification of airborne LIDAR data. ISPRS Journal of Photogrammetry and Remote Sensing 77 (2013), 21-30.
Gaps are filled linearly here, by springs there.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from lirs_wct.arrays import BoolArray, FloatArray
from lirs_wct.field_validators import require_above
from lirs_wct.sources.clouds.grid import NodeGrid, filled

STEEPEST = 5.0
"""Rise over run of what is lower than the ground: wrong points (section 2.2)."""


@dataclass(frozen=True, kw_only=True)
class Smrf:
    """Parameters, at the paper's values for all of its test sites (section 4.2).

    Attributes:
        slope: steepest ground, rise over run.
        window: radius of the largest object, metres.
        threshold: height of a point over the provisional ground at which it is still ground, metres ...
        scaling: ... and what the ground's slope adds to it, metres.
        cell: of the grid on which objects are found, metres, at least.

    Raises:
        ConfigError: a value is not above 0.
    """

    slope: float = 0.15
    window: float = 18.0
    threshold: float = 0.5
    scaling: float = 1.25
    cell: float = 1.0

    def __post_init__(self) -> None:
        require_above(self, 0, "slope", "window", "threshold", "scaling", "cell")


def ground_points(xyz: FloatArray, options: Smrf) -> BoolArray:
    """Return (n,) which points are on the ground.

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
    outlier = _objects(-surface, STEEPEST, grid.spacing, grid.spacing)
    surface = filled(np.where(outlier | empty, np.nan, surface))
    above = _objects(surface, options.slope, window, grid.spacing)
    provisional = filled(np.where(above | empty | outlier, np.nan, surface))
    north, east = np.gradient(provisional, grid.spacing)
    limit = options.threshold + options.scaling * np.hypot(north, east)
    off = np.abs(xyz[:, 2] - grid.sampled(provisional, xyz[:, :2]))
    found: BoolArray = off <= grid.sampled(limit, xyz[:, :2])
    return found


def _objects(surface: FloatArray, slope: float, window: float, cell: float) -> BoolArray:
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
