"""Comparison of a built map with a reference map and the world's geometry.

All grids are given in the world frame: the built map moved by the true start pose and by nothing else. So an
error of the first meters shifts or turns the whole map; the `_aligned` metrics are of the map moved by the
alignment of the trajectory (that of the ATE) as well.
Cells count where they are known in both maps; occupied is p > 0.65. What is evaluated is what a map file
says: a cell that is neither occupied nor free (p < 0.25) is unknown.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lirs_validation.metrics.agreement import (
    NO_AGREEMENT,
    ROUNDING,
    TOLERANCE,
    CellDistance,
    agreement,
    as_stored,
    cell_distance,
    map_ssim,
    sample_like,
)
from lirs_validation.metrics.alignment import StartAlignment
from lirs_validation.metrics.near_obstacles import near_obstacle
from lirs_wct import HeightField, OccupancyGrid, WallGrid


@dataclass(frozen=True, kw_only=True)
class MapScores:
    """Metrics of one built map.

    None if neither map has an occupied cell, or there is no reference.

    Attributes:
        f1: agreement with the true-pose map, harmonic mean of precision and recall.
        f1_aligned: the same after the alignment of the trajectory; None without one.
        start_shift: how far that alignment moves the start pose, meters.
        start_turn: by how much it turns the map, radians, not negative.
        precision: share of the built occupied cells that the true-pose map confirms within 0.10 m.
        recall: share of the true-pose map's occupied cells that the built map holds within 0.10 m.
        iou: occupied in both over occupied in either, cell by cell.
        f1_input: agreement with the input laser map.
        precision_input: share of the built occupied cells that the input laser map confirms.
        recall_input: share of the input laser map's occupied cells, where the built map knows, that it holds.
        false_occupied: share of the built occupied cells farther than 0.10 m from any steep face or wall.
        false_occupied_aligned: the same after the alignment of the trajectory; None without one.
        reference_false_occupied: false_occupied of the true-pose map itself: walls that no pose error made.
        unknown: share of the true-pose map's known cells that the built map does not know.
        to_reference: how far the built occupied cells lie from the true-pose map's nearest.
        from_reference: how far the true-pose map's occupied cells lie from the built map's nearest.
        ssim: structural similarity with the true-pose map.
        occupied_cells: how many occupied cells the built map has.
    """

    f1: float | None
    f1_aligned: float | None
    start_shift: float | None
    start_turn: float | None
    precision: float | None
    recall: float | None
    iou: float | None
    f1_input: float | None
    precision_input: float | None
    recall_input: float | None
    false_occupied: float | None
    false_occupied_aligned: float | None
    reference_false_occupied: float | None
    unknown: float | None
    to_reference: CellDistance | None
    from_reference: CellDistance | None
    ssim: float | None
    occupied_cells: int


def map_scores(
    built: OccupancyGrid,
    true_pose: OccupancyGrid,
    *,
    surface: HeightField,
    walls: WallGrid | None = None,
    truth: OccupancyGrid | None = None,
    alignment: StartAlignment | None = None,
) -> MapScores:
    """Score a built map.

    Args:
        built: the mapper's map, in the world frame.
        true_pose: the map that our update makes of the same scans at the true poses, in the world frame.
        surface: the world's ground.
        walls: the world's walls.
        truth: the input laser map, where there is one, in the world frame.
        alignment: of the trajectory that belongs to the built map, where there is one.
    """
    built, true_pose = as_stored(built), as_stored(true_pose)
    seen = OccupancyGrid(sample_like(built, true_pose), true_pose.resolution, true_pose.origin)
    own = agreement(built, true_pose)
    other = NO_AGREEMENT if truth is None else agreement(built, as_stored(truth))
    aligned = None if alignment is None else built.moved(alignment.T_world_aligned)

    def false_share(grid: OccupancyGrid, beside: OccupancyGrid) -> float | None:
        share = false_occupied(grid, surface, walls)
        return 0.0 if share is None and beside.occupied.any() else share

    return MapScores(
        f1=own.f1,
        f1_aligned=None if aligned is None else agreement(aligned, true_pose).f1,
        start_shift=None if alignment is None else alignment.shift,
        start_turn=None if alignment is None else alignment.turn,
        precision=own.precision,
        recall=own.recall,
        iou=iou(built, true_pose),
        f1_input=other.f1,
        precision_input=other.precision,
        recall_input=other.recall,
        false_occupied=false_share(built, true_pose),
        false_occupied_aligned=None if aligned is None else false_share(aligned, true_pose),
        reference_false_occupied=false_share(true_pose, built),
        unknown=unknown_share(seen, true_pose),
        to_reference=cell_distance(built, true_pose),
        from_reference=cell_distance(true_pose, built),
        ssim=map_ssim(seen, true_pose),
        occupied_cells=int(built.occupied.sum()),
    )


def iou(built: OccupancyGrid, reference: OccupancyGrid) -> float | None:
    """Return intersection over union of the occupied cells known in both maps.

    None where neither map has an occupied cell, 0 where none is known in both. The built map is read at the
    centers of the reference's cells: exact where the two lattices coincide, the nearest cell where the maps
    are turned or shifted against each other.
    """
    log_odds = sample_like(built, reference)
    known = ~np.isnan(log_odds) & reference.known
    a = OccupancyGrid(log_odds, reference.resolution).occupied & known
    b = reference.occupied & known
    union = int((a | b).sum())
    if union == 0:
        return 0.0 if built.occupied.any() or reference.occupied.any() else None
    return int((a & b).sum()) / union


def false_occupied(built: OccupancyGrid, surface: HeightField, walls: WallGrid | None) -> float | None:
    """Return the share of occupied cells farther from obstacles than the tolerance.

    Obstacles are faces of the surface steeper than 45 deg and wall cells, independent of the scans.
    """
    points = built.occupied_points()
    if len(points) == 0:
        return None
    return float(1 - near_obstacle(points, surface, walls, TOLERANCE + ROUNDING).mean())


def unknown_share(built: OccupancyGrid, reference: OccupancyGrid) -> float | None:
    """Return the share of the reference's known cells that are unknown in the built map."""
    if not reference.known.any():
        return None
    return float(np.isnan(sample_like(built, reference))[reference.known].mean())
