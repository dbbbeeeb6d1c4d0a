"""How well a built map agrees with a reference map, and with the world's geometry.

All grids are given in the world frame: the built map moved by the true start pose and by nothing else.
Cells count where they are known in both maps; occupied is p > 0.65.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from lirs_validation.geometry import near_obstacle
from lirs_wct.grid import OccupancyGrid
from lirs_wct.heightfield import HeightField
from lirs_wct.walls import WallGrid

TOLERANCE = 0.10
"""Two occupied cells agree where their centres are at most this far apart, metres."""
ROUNDING = 1e-9
"""Cell centres that are 0.10 m apart but for rounding agree, metres."""

Points = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Agreement:
    """How the occupied cells of two maps agree; None where there is no occupied cell to ask.

    Attributes:
        precision: share of the built map's occupied cells with one of the reference within 0.10 m.
        recall: share of the reference's occupied cells with one of the built map within 0.10 m.
        f1: harmonic mean of both.
    """

    precision: float | None
    recall: float | None
    f1: float | None


@dataclass(frozen=True, kw_only=True)
class MapScores:
    """The figures of one built map; None where there is no occupied cell to ask, or no such reference.

    Attributes:
        f1: agreement with the true-pose map, harmonic mean of precision and recall.
        precision: share of the built occupied cells that the true-pose map confirms within 0.10 m.
        recall: share of the true-pose map's occupied cells that the built map holds within 0.10 m.
        iou: occupied in both over occupied in either, cell by cell.
        f1_input: agreement with the input laser map.
        precision_input: share of the built occupied cells that the input laser map confirms.
        recall_input: share of the input laser map's occupied cells, where the built map knows, that it holds.
        false_occupied: share of the built occupied cells farther than 0.10 m from any steep face or wall.
        unknown: share of the true-pose map's known cells that the built map does not know.
        occupied_cells: how many occupied cells the built map has.
    """

    f1: float | None
    precision: float | None
    recall: float | None
    iou: float | None
    f1_input: float | None
    precision_input: float | None
    recall_input: float | None
    false_occupied: float | None
    unknown: float | None
    occupied_cells: int


def map_scores(
    built: OccupancyGrid,
    true_pose: OccupancyGrid,
    *,
    surface: HeightField,
    walls: WallGrid | None = None,
    truth: OccupancyGrid | None = None,
) -> MapScores:
    """Score a built map.

    Args:
        built: the mapper's map, in the world frame.
        true_pose: the map that our update makes of the same scans at the true poses, in the world frame.
        surface: the world's ground.
        walls: the world's walls.
        truth: the input laser map, where there is one, in the world frame.
    """
    own = agreement(built, true_pose)
    other = Agreement(precision=None, recall=None, f1=None) if truth is None else agreement(built, truth)
    return MapScores(
        f1=own.f1,
        precision=own.precision,
        recall=own.recall,
        iou=iou(built, true_pose),
        f1_input=other.f1,
        precision_input=other.precision,
        recall_input=other.recall,
        false_occupied=false_occupied(built, surface, walls),
        unknown=unknown_share(built, true_pose),
        occupied_cells=int(built.occupied.sum()),
    )


def agreement(built: OccupancyGrid, reference: OccupancyGrid, tolerance: float = TOLERANCE) -> Agreement:
    """Compare occupied cells by the distance of their centres, in metres, where both maps know.

    A cell is asked where the other map knows the cell under its centre; it agrees with any occupied
    cell of the other map within the tolerance. Works for any two resolutions and rotations.
    """
    precision = _confirmed(built, reference, tolerance)
    recall = _confirmed(reference, built, tolerance)
    if precision is None or recall is None:
        return Agreement(precision=precision, recall=recall, f1=None)
    both = precision + recall
    return Agreement(precision=precision, recall=recall, f1=2 * precision * recall / both if both else 0.0)


def iou(built: OccupancyGrid, reference: OccupancyGrid) -> float | None:
    """Return intersection over union of the occupied cells known in both maps; None where there is none.

    The built map is read at the centres of the reference's cells: exact where the two lattices coincide,
    the nearest cell where the maps are turned or shifted against each other.
    """
    log_odds = sampled(built, reference)
    known = ~np.isnan(log_odds) & reference.known
    a = OccupancyGrid(log_odds, reference.resolution).occupied & known
    b = reference.occupied & known
    union = int((a | b).sum())
    return int((a & b).sum()) / union if union else None


def false_occupied(
    built: OccupancyGrid, surface: HeightField, walls: WallGrid | None, tolerance: float = TOLERANCE
) -> float | None:
    """Return the share of occupied cells farther than the tolerance from any obstacle of the geometry.

    Obstacles are faces of the surface steeper than 45 deg and wall cells, not what scans saw of them.
    """
    points = built.occupied_points()
    if len(points) == 0:
        return None
    return float(1 - near_obstacle(points, surface, walls, tolerance + ROUNDING).mean())


def unknown_share(built: OccupancyGrid, reference: OccupancyGrid) -> float | None:
    """Return the share of the reference's known cells that the built map does not know."""
    if not reference.known.any():
        return None
    return float(np.isnan(sampled(built, reference))[reference.known].mean())


def sampled(grid: OccupancyGrid, like: OccupancyGrid) -> NDArray[np.float32]:
    """Return the log-odds of `grid` at the cell centres of another grid; NaN where unknown or outside."""
    rows, cols = like.shape
    cells = np.stack(np.meshgrid(np.arange(rows), np.arange(cols), indexing="ij"), axis=-1)
    return _at(grid, like.centres(cells))


def contradicted(
    asked: OccupancyGrid, other: OccupancyGrid, tolerance: float = TOLERANCE
) -> NDArray[np.bool_]:
    """Return (rows, cols) the occupied cells of a map, where the other knows, that it does not confirm."""
    cells, confirmed = _asked(asked, other, tolerance)
    wrong = np.zeros(asked.shape, np.bool_)
    wrong[tuple(cells[~confirmed].T)] = True
    return wrong


def _confirmed(asked: OccupancyGrid, other: OccupancyGrid, tolerance: float) -> float | None:
    """Return the share of occupied cells, where the other map knows, that it confirms."""
    _, confirmed = _asked(asked, other, tolerance)
    return float(confirmed.mean()) if len(confirmed) else None


def _asked(
    asked: OccupancyGrid, other: OccupancyGrid, tolerance: float
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return (n, 2) occupied cells where the other map knows, and whether it has one of its own near by."""
    cells, targets = np.argwhere(asked.occupied).astype(np.int64), other.occupied_points()
    points = asked.centres(cells)
    known = ~np.isnan(_at(other, points))
    if len(targets) == 0:
        return cells[known], np.zeros(int(known.sum()), np.bool_)
    limit = tolerance + ROUNDING
    distance, _ = cKDTree(targets).query(points[known], distance_upper_bound=2 * limit)
    return cells[known], np.asarray(distance <= limit, dtype=np.bool_)


def _at(grid: OccupancyGrid, points: Points) -> NDArray[np.float32]:
    """Return the log-odds of the cells that hold points (..., 2); NaN outside."""
    cells = grid.cells(points)
    inside = np.all((cells >= 0) & (cells < np.array(grid.shape)), axis=-1)
    held = np.where(inside[..., None], cells, 0)
    values: NDArray[np.float32] = np.where(
        inside, grid.log_odds[held[..., 0], held[..., 1]], np.float32(np.nan)
    )
    return values
