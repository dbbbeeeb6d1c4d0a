"""Causes why a robot cannot stand at a place, with their amounts, and the nearest place where it can."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from lirs_wct.arrays import BoolArray
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.navigation.traversability import STEEP, WALLS, steepness

EDGE = "the border of the world"


def cause_of_refusal(
    surface: HeightField,
    blocked: Mapping[str, BoolArray],
    grid: OccupancyGrid,
    place: tuple[float, float],
    *,
    clearance: float,
    max_slope: float,
) -> str:
    """Return the cause why a robot cannot stand at a place, with the amount and the limit.

    Args:
        surface: the ground.
        blocked: cells of the grid that are blocked, by cause (see `blocked_ground`).
        grid: geometry of the cells.
        place: x and y in the world frame, meters.
        clearance: meters that the robot's center keeps from what is blocked.
        max_slope: steepest ground that the robot drives, radians.
    """
    x, y = place
    west, south, east, north = surface.bounds
    distances = {EDGE: max(0.0, min(x - west, east - x, y - south, north - y))}
    nearest = {}
    for cause, mask in blocked.items():
        cells = np.argwhere(mask)
        if len(cells):
            gap = np.maximum(np.abs(grid.centers(cells) - place) - grid.resolution / 2, 0.0)
            away = np.hypot(*gap.T)
            k = int(np.argmin(away))
            distances[cause], nearest[cause] = float(away[k]), grid.centers(cells[k])
    cause = min(distances, key=distances.__getitem__)
    away, what = distances[cause], cause
    if cause == STEEP:
        slope = math.degrees(steepness(surface, nearest[cause], grid.resolution))
        what = f"ground of {slope:.3g} deg (limit {math.degrees(max_slope):.3g})"
    if away > 0:
        return f"it is {away:.2f} m from {what}, its center needs {clearance:.2f} m"
    return f"it is {'in' if cause == WALLS else 'on'} {what}"


def nearest_place(free: OccupancyGrid, place: tuple[float, float]) -> str | None:
    """Return the free cell nearest to a place as `x,y`; None where no cell is free."""
    cells = np.argwhere(free.free)
    if len(cells) == 0:
        return None
    centers = free.centers(cells)
    x, y = centers[int(np.argmin(np.hypot(*(centers - place).T)))].tolist()
    return f"{x:.2f},{y:.2f}"
