"""Contact grid: the coarsest height field for wheels whose deviation from the surface is bounded.

MuJoCo tests every prism of a height field under a geom's bounding box. Half the spacing therefore costs up to
four times as much. The laser still sees the surface itself. This file bounds the deviation between the two.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from lirs_wct.geometry import BoolArray, Float32Array, HeightField, njit

VERTICAL = 0.01
"""Largest vertical deviation at nodes that touch no steep triangle, meters."""
HORIZONTAL, MATCH = 0.5, 0.02
"""Distance, contact cells along each axis, within which the contact grid must reach the height of a steep
node, and tolerance of that height, meters; at the foot of a wall the ground itself rises by so much."""
STEEP = math.radians(45)
"""Slope from which a triangle counts as steep, radians."""
MAX_CELL = 0.5
"""Largest contact cell, meters; larger cells save no time."""


@dataclass(frozen=True, kw_only=True)
class ContactGrid:
    """Spacing, budget and measured deviation of a contact grid.

    The deviation is measured at every node of the surface.

    Attributes:
        stride: cells of the surface in a contact cell, along each axis; 1 = the surface itself.
        cell: spacing of the contact grid's nodes, meters.
        vertical_budget: meters (see `VERTICAL`).
        horizontal_budget: meters, half a contact cell.
        match_budget: meters, the height's tolerance at the horizontal deviation.
        vertical: largest vertical deviation where the slope is under 45 deg, meters.
        horizontal: largest horizontal deviation along an axis on steeper faces, meters.
        nodes: number of nodes compared.
    """

    stride: int
    cell: tuple[float, float]
    vertical_budget: float
    horizontal_budget: float
    match_budget: float
    vertical: float
    horizontal: float
    nodes: int

    def heights(self, surface: HeightField) -> HeightField:
        """Return the heights of the contact grid of its surface.

        The grid begins at the south-west node. If the stride does not divide the surface's cells, the last
        row and column lie beyond the border, on the straight line through the border's node.
        """
        return HeightField(
            np.ascontiguousarray(_coarse(surface.south_up, self.stride)[::-1]), self.cell, surface.origin
        )


def contact_grid(surface: HeightField) -> ContactGrid:
    """Return the coarsest grid within the limits of deviation, by whole cells of the surface."""
    z = surface.south_up
    steep = steep_nodes(z, surface.cell, STEEP)
    largest = min(int(MAX_CELL / max(surface.cell)), min(z.shape) - 1)
    for stride in range(max(largest, 1), 1, -1):
        found = _measure_deviation(z, steep, stride)
        if found is not None:
            return _figures(surface, stride, *found)
    return surface_itself(surface)


def surface_itself(surface: HeightField) -> ContactGrid:
    """Return the contact grid that equals the surface, node by node."""
    return _figures(surface, 1, 0.0, 0.0)


def steep_nodes(z: Float32Array, cell: tuple[float, float], steep: float) -> BoolArray:
    """Return (rows, cols) whether a node, row 0 = south, belongs to a steep triangle.

    A triangle is steep from the angle `steep`, radians.
    """
    sw, se, nw, ne = z[:-1, :-1], z[:-1, 1:], z[1:, :-1], z[1:, 1:]
    limit = math.tan(steep)
    below = np.hypot((se - sw) / cell[0], (ne - se) / cell[1]) >= limit
    above = np.hypot((ne - nw) / cell[0], (nw - sw) / cell[1]) >= limit
    mask = np.zeros(z.shape, np.bool_)
    mask[:-1, :-1] |= below | above
    mask[1:, 1:] |= below | above
    mask[:-1, 1:] |= below
    mask[1:, :-1] |= above
    return mask


def _figures(surface: HeightField, stride: int, vertical: float, cells: float) -> ContactGrid:
    cell = (stride * surface.cell[0], stride * surface.cell[1])
    return ContactGrid(
        stride=stride,
        cell=cell,
        vertical_budget=VERTICAL,
        horizontal_budget=HORIZONTAL * max(cell),
        match_budget=MATCH,
        vertical=vertical,
        horizontal=cells * max(surface.cell),
        nodes=surface.z.size,
    )


def _measure_deviation(z: Float32Array, steep: BoolArray, stride: int) -> tuple[float, float] | None:
    """Return the vertical (meters) and horizontal (cells) deviation; None if above the limits."""
    contact = np.empty_like(z)
    vertical = float(_resample(_coarse(z, stride), stride, z, steep, VERTICAL, contact))
    if vertical > VERTICAL:
        return None
    # On a path between two nodes a continuous surface has every height between theirs. Thus it reaches the
    # node's height in its window if that lies between the window's lowest and highest height.
    far = (np.abs(contact - z) > VERTICAL).astype(np.uint8)
    for cells in range(int(HORIZONTAL * stride) + 1):
        window = np.ones((2 * cells + 1, 2 * cells + 1), np.uint8)
        low, high = cv2.erode(contact, window), cv2.dilate(contact, window)
        far &= (z < low - MATCH) | (z > high + MATCH)
        if not far.any():
            return vertical, float(cells)
    return None


def _coarse(z: Float32Array, stride: int) -> Float32Array:
    """Return every stride-th node from the south-west.

    If the stride does not divide the cells, a last node lies beyond the border.
    """
    for axis in (0, 1):
        z = np.moveaxis(z, axis, 0)
        whole, rest = divmod(len(z) - 1, stride)
        nodes = z[: whole * stride + 1 : stride]
        if rest:
            beyond = nodes[-1] + (z[-1] - nodes[-1]) * np.float32(stride / rest)
            nodes = np.concatenate((nodes, beyond[None]))
        z = np.moveaxis(nodes, 0, axis)
    return np.ascontiguousarray(z)


@njit
def _resample(
    coarse: Float32Array, stride: int, z: Float32Array, steep: BoolArray, limit: float, contact: Float32Array
) -> float:
    """Fill `contact` with the coarse grid at every node; return the largest deviation.

    The deviation counts at nodes that are not steep. The kernel stops at the first one above `limit`.
    """
    worst = 0.0
    for r in range(z.shape[0]):
        j = min(r // stride, coarse.shape[0] - 2)
        v = (r - j * stride) / stride
        for c in range(z.shape[1]):
            i = min(c // stride, coarse.shape[1] - 2)
            u = (c - i * stride) / stride
            sw, ne = coarse[j, i], coarse[j + 1, i + 1]
            if u >= v:
                se = coarse[j, i + 1]
                height = sw + u * (se - sw) + v * (ne - se)
            else:
                nw = coarse[j + 1, i]
                height = sw + u * (ne - nw) + v * (nw - sw)
            contact[r, c] = height
            if not steep[r, c]:
                deviation = abs(height - z[r, c])
                worst = max(worst, deviation)
                if deviation > limit:
                    return float(worst)
    return float(worst)
