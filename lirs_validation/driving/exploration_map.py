"""Exploration map: places where the robot fits, and frontiers of the known area."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import cv2
import numpy as np

from lirs_validation.driving.paths import path_weight, room_in
from lirs_wct.arrays import BoolArray, FloatArray, IntArray
from lirs_wct.geometry import OccupancyGrid, Pose2
from lirs_wct.geometry.grid import OCCUPIED
from lirs_wct.kernels import njit

RESOLUTION = 0.1
"""Meters a cell, at least: finer maps are thinned out."""
UNSURE = 20.0
"""Cost factor of a meter where part of the robot would be over unknown ground."""
MOST_CELLS = 1_000_000
"""Cells, at most: the time for a plan is bounded, however large the map grows."""


@dataclass(frozen=True)
class ExplorationMap:
    """A mapper's map as an explorer plans on it, map frame.

    Attributes:
        grid: resolution and origin; free = where the robot's center may be with all of it on known ground.
        known: (rows, cols) seen and not occupied.
        frontier: (rows, cols) known cells beside unknown ones, in groups that the robot fits through.
        room: (rows, cols) meters from free cells to the nearest other; 0 in these.
        weight: (rows, cols) cost of a meter; inf where the center may not be at all.
    """

    grid: OccupancyGrid
    known: BoolArray
    frontier: BoolArray
    room: FloatArray
    weight: FloatArray

    @property
    def passable(self) -> BoolArray:
        """(rows, cols) where the robot's center may be, if need be partly over unknown ground."""
        return np.isfinite(self.weight)

    def goals(self, frontier: BoolArray, reach: float) -> BoolArray:
        """Mark the free cells within a distance of some frontier cells, meters."""
        near = _distance_to(frontier, self.grid.resolution) <= reach
        mask: BoolArray = near & (self.room > 0)
        return mask

    def distance_to(self, cell: IntArray) -> FloatArray:
        """Return (rows, cols) meters from each cell to one cell (2,), as the crow flies."""
        rows, cols = np.ogrid[: self.known.shape[0], : self.known.shape[1]]
        distance: FloatArray = np.hypot(rows - cell[0], cols - cell[1]) * self.grid.resolution
        return distance

    def last_visits(self, stood: FloatArray, distance: float) -> IntArray:
        """Return (rows, cols) the index of the last visit within a distance.

        The visits are places (n, 2); -1 = none.
        """
        visits = np.full(self.known.shape, -1, np.int32)
        for k, (row, col) in enumerate(self.grid.cells(stood).tolist()):
            cv2.circle(visits, (col, row), round(distance / self.grid.resolution), k, -1)
        return visits.astype(np.int64)


def exploration_map(
    mapped: OccupancyGrid, stood: FloatArray, blocked: FloatArray, *, footprint: float, clearance: float
) -> ExplorationMap:
    """Prepare a mapper's map for planning.

    Args:
        mapped: the mapper's map.
        stood: (n, 2) places where the robot was: its footprint there is free, whatever its lidar missed.
        blocked: (m, 3) x, y and radius of places where it did not get on.
        footprint: radius of the robot, which never leaves the known ground, meters.
        clearance: distance that its center keeps from occupied cells, meters.
    """
    occupied, known, origin, resolution = _thin_out(mapped, margin=clearance + RESOLUTION)
    frame = OccupancyGrid(np.zeros(known.shape, np.float32), resolution, origin)
    known |= _discs(frame, np.column_stack((stood, np.full(len(stood), footprint))))
    known &= ~occupied
    unknown = _without_holes(~known & ~occupied, math.pi * footprint**2 / resolution**2)
    known = ~unknown & ~occupied
    to_occupied, to_unknown = _distance_to(occupied, resolution), _distance_to(unknown, resolution)
    possible = known & (to_occupied > clearance) & ~_discs(frame, blocked)
    free = possible & (to_unknown > footprint)
    edge = known & (to_unknown <= 1.5 * resolution) & (to_occupied > 2 * resolution)
    room = room_in(free, resolution)
    # At the start, and between rays, the robot stands partly on unknown ground: it must get out of there.
    weight = np.where(possible & ~free, UNSURE, path_weight(free, room))
    grid = OccupancyGrid.from_mask(~free, resolution, origin)
    return ExplorationMap(grid, known, _without_small(edge, 2 * footprint / resolution), room, weight)


def distance_in_sight(chart: ExplorationMap, pose: Pose2, cells: IntArray) -> FloatArray:
    """Return (n,) distances to visible cells (n, 2) ahead of a pose, meters.

    A cell is visible if only known cells lie between; inf for others.
    """
    offset = chart.grid.centers(cells) - (pose.x, pose.y)
    ahead = offset @ np.array((math.cos(pose.yaw), math.sin(pose.yaw))) >= 0
    ahead[ahead] = _in_sight(chart.known, chart.grid.cells((pose.x, pose.y)), cells[ahead])
    return np.where(ahead, np.hypot(offset[:, 0], offset[:, 1]), np.inf)


def _thin_out(mapped: OccupancyGrid, margin: float) -> tuple[BoolArray, BoolArray, Pose2, float]:
    """Return occupied and known cells with unknown ones all round, their origin and resolution.

    A cell is occupied where any part of it is, else known where any part is.
    """
    factor = max(1, round(RESOLUTION / mapped.resolution))
    while mapped.log_odds.size > factor**2 * MOST_CELLS:
        factor *= 2
    rows, cols = (factor * math.ceil(n / factor) for n in mapped.shape)
    padded = np.full((rows, cols), np.nan, np.float32)
    padded[: mapped.shape[0], : mapped.shape[1]] = mapped.log_odds
    largest = padded[::factor, ::factor]
    for row, col in itertools.product(range(factor), repeat=2):
        largest = np.fmax(largest, padded[row::factor, col::factor])
    resolution = factor * mapped.resolution
    edge = math.ceil(margin / resolution) + 1
    occupied = np.pad(largest > math.log(OCCUPIED / (1 - OCCUPIED)), edge)
    known = np.pad(~np.isnan(largest), edge)
    return occupied, known, mapped.origin @ Pose2(-edge * resolution, -edge * resolution), resolution


def _distance_to(mask: BoolArray, resolution: float) -> FloatArray:
    """Return (rows, cols) meters to the nearest marked cell; inf where none is."""
    if not mask.any():
        return np.full(mask.shape, np.inf)
    cells = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5)
    distance: FloatArray = cells.astype(np.float64) * resolution
    return distance


def _discs(grid: OccupancyGrid, discs: FloatArray) -> BoolArray:
    """Mark the cells inside discs (n, 3): x, y, radius in meters."""
    mask = np.zeros(grid.shape, np.uint8)
    for (row, col), radius in zip(grid.cells(discs[:, :2]).tolist(), discs[:, 2].tolist(), strict=True):
        cv2.circle(mask, (col, row), round(radius / grid.resolution), 1, -1)
    return mask.astype(np.bool_)


def _without_holes(unknown: BoolArray, cells: float) -> BoolArray:
    """Return unknown cells without groups so small that no robot is lost in them."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(unknown.astype(np.uint8), connectivity=4)
    large = stats[:, cv2.CC_STAT_AREA] > cells
    large[0] = False
    kept: BoolArray = large[labels]
    return kept


def _without_small(frontier: BoolArray, cells: float) -> BoolArray:
    """Return frontier cells in groups at least so many cells across."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(frontier.astype(np.uint8), connectivity=8)
    across = np.maximum(stats[:, cv2.CC_STAT_WIDTH], stats[:, cv2.CC_STAT_HEIGHT])
    long = across >= cells
    long[0] = False
    kept: BoolArray = long[labels]
    return kept


@njit(cache=True)
def _in_sight(known: BoolArray, eye: IntArray, cells: IntArray) -> BoolArray:
    """Whether the straight line to each cell passes known cells alone."""
    seen = np.ones(len(cells), np.bool_)
    for k in range(len(cells)):
        dr, dc = cells[k, 0] - eye[0], cells[k, 1] - eye[1]
        steps = max(abs(dr), abs(dc))
        for s in range(1, steps):
            if not known[eye[0] + round(s * dr / steps), eye[1] + round(s * dc / steps)]:
                seen[k] = False
                break
    return seen
