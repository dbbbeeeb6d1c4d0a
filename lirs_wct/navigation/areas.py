"""Which of the free areas of a world a robot is meant to drive in."""

from __future__ import annotations

import cv2
import numpy as np

from lirs_wct.arrays import BoolArray, Float32Array, IntArray
from lirs_wct.geometry.grid import OccupancyGrid

LEAST = 0.05
"""Share of the largest enclosed extent below which an area is a closet or a gap in the scans."""
NEAR = 1.0
"""Meters from the origin of a map's frame within which an area lies at it."""


def largest_area(mask: BoolArray) -> BoolArray:
    """Return the largest 4-connected area of a mask (all False where there is none)."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    sizes = stats[1:, cv2.CC_STAT_AREA]
    if len(sizes) == 0:
        return np.zeros_like(mask)
    area: BoolArray = labels == 1 + int(np.argmax(sizes))
    return area


def mapped_area(free: OccupancyGrid, border: float) -> BoolArray:
    """Return the area of a laser map that it was made in: (rows, cols), all False where none is free.

    It is the area at the origin of the map's frame, which is where the robot that made the map began. Where
    nothing is free there, it is the one that reaches around most, its islands included, of those that walls
    part from the border of the map: a race track, and neither its infield nor the paper around it.

    Args:
        free: where a small robot can be.
        border: meters from the border that such a robot keeps by itself.
    """
    mask = free.free
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    if len(stats) == 1:
        return np.zeros_like(mask)
    extent = _extents(labels, stats)
    large = extent >= LEAST * extent.max()
    begun = _label_at_origin(free, labels, mask)
    if begun and large[begun - 1]:
        return np.asarray(labels == begun)
    reach = round(border / free.resolution) + 1
    rows, cols = mask.shape
    left, top, width, height = stats[1:, :4].T
    outside = (
        (left <= reach) | (top <= reach) | (left + width >= cols - reach) | (top + height >= rows - reach)
    )
    inside = large & ~outside
    chosen = int(np.argmax(np.where(inside if inside.any() else large, extent, -1.0)))
    return np.asarray(labels == 1 + chosen)


def _extents(labels: IntArray, stats: IntArray) -> Float32Array:
    """Return the cells within the outer contour of each area; of small ones those of their bounding box."""
    extents = (stats[1:, cv2.CC_STAT_WIDTH] * stats[1:, cv2.CC_STAT_HEIGHT]).astype(np.float32)
    for k in np.flatnonzero(extents >= LEAST * extents.max()):
        left, top, width, height = stats[1 + k, :4].tolist()
        part = (labels[top : top + height, left : left + width] == 1 + k).astype(np.uint8)
        contours, _ = cv2.findContours(part, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        extents[k] = sum(cv2.contourArea(contour) for contour in contours)
    return extents


def _label_at_origin(free: OccupancyGrid, labels: IntArray, mask: BoolArray) -> int:
    """Return the label of the free cell nearest to the origin of the frame, 0 if there is none near it."""
    row, col = free.cells((0.0, 0.0)).tolist()
    reach = round(NEAR / free.resolution)
    r0, c0 = max(0, row - reach), max(0, col - reach)
    near = mask[r0 : max(0, row + reach + 1), c0 : max(0, col + reach + 1)]
    cells = np.argwhere(near) + np.array((r0, c0))
    if len(cells) == 0:
        return 0
    distance = np.hypot(cells[:, 0] - row, cells[:, 1] - col)
    if distance.min() > reach:
        return 0
    nearest = cells[int(np.argmin(distance))]
    return int(labels[nearest[0], nearest[1]])
