"""Agreement of a built map, or of hits, with a reference map and the world.

All grids are given in the world frame: the built map moved by the true start pose and by nothing else. So an
error of the first meters shifts or turns the whole map; the `_aligned` metrics are of the map moved by the
alignment of the trajectory (that of the ATE) as well.
Cells count where they are known in both maps; occupied is p > 0.65. What is evaluated is what a map file
says: a cell that is neither occupied nor free (p < 0.25) is unknown.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from scipy.spatial import cKDTree

from lirs_validation.metrics.trajectory import StartAlignment
from lirs_wct import (
    BoolArray,
    Float32Array,
    FloatArray,
    HeightField,
    IntArray,
    LaserScan,
    OccupancyGrid,
    Pose3,
    WallGrid,
    World,
    wrap_angle,
)
from lirs_wct.arrays import njit

TOLERANCE = 0.10
"""Two occupied cells agree where their centers are at most this far apart, meters."""
ROUNDING = 1e-9
"""Cell centers that are 0.10 m apart but for rounding agree, meters."""
COINCIDING = 1e-3
"""Largest distance of cells of two maps on one lattice, cells; more than rounding."""
WINDOW, SIGMA = 11, 1.5
"""Side and standard deviation of the Gaussian window, cells (Wang et al., Sec. III-C)."""
K1, K2 = 0.01, 0.03
"""Constants that keep the quotients finite, as in the paper, for pictures in [0, 1]."""
STEEP = math.radians(45)
"""Faces steeper than this are obstacles, radians."""
WALL_DISTANCE = 0.10
"""Meters from a steep face or wall cell within which a hit is one of a wall, as in `map.false_occupied`."""
BAND = 64
"""Rows of a map per block: intermediate arrays are ten times the size of the block."""


@dataclass(frozen=True, kw_only=True)
class Agreement:
    """Agreement of occupied cells of two maps; None if neither map has one.

    All three are 0 where only one of the two maps has occupied cells, or where the maps know nothing in
    common: a map without walls is wrong where there are walls, and earns no gap in a mean.

    Attributes:
        precision: Share of the built map's occupied cells with one of the reference within 0.10 m.
        recall: Share of the reference's occupied cells with one of the built map within 0.10 m.
        f1: Harmonic mean of both.
    """

    precision: float | None
    recall: float | None
    f1: float | None


NO_AGREEMENT = Agreement(precision=None, recall=None, f1=None)
"""Agreement of two maps without an occupied cell, or without another map."""


@dataclass(frozen=True, kw_only=True)
class CellDistance:
    """Mean and 95th percentile of distances from occupied cells of a map to another's, meters."""

    mean: float
    p95: float


def agreement(built: OccupancyGrid, reference: OccupancyGrid, tolerance: float = TOLERANCE) -> Agreement:
    """Compare occupied cells by the distance of their centers, in meters, where both maps know.

    A cell is asked where the other map knows the cell under its center; it agrees with any occupied
    cell of the other map within the tolerance. Works for any two resolutions and rotations.
    """
    if not built.occupied.any() and not reference.occupied.any():
        return NO_AGREEMENT
    precision = _confirmed_share(built, reference, tolerance)
    recall = _confirmed_share(reference, built, tolerance)
    both = precision + recall
    return Agreement(precision=precision, recall=recall, f1=2 * precision * recall / both if both else 0.0)


def cell_distance(asked: OccupancyGrid, other: OccupancyGrid) -> CellDistance | None:
    """Return distances of a map's occupied cells to those of another map.

    None where there is no cell to ask, or the other map has no occupied cell.
    """
    _, distance = nearest_occupied(asked, other)
    if len(distance) == 0 or not np.isfinite(distance).all():
        return None
    return CellDistance(mean=float(distance.mean()), p95=float(np.percentile(distance, 95)))


def contradicted(asked: OccupancyGrid, other: OccupancyGrid, tolerance: float = TOLERANCE) -> BoolArray:
    """Return (rows, cols) occupied cells that the other map contradicts where it knows."""
    cells, distance = nearest_occupied(asked, other)
    wrong = np.zeros(asked.shape, np.bool_)
    wrong[tuple(cells[distance > tolerance + ROUNDING].T)] = True
    return wrong


def nearest_occupied(asked: OccupancyGrid, other: OccupancyGrid) -> tuple[IntArray, FloatArray]:
    """Return (n, 2) occupied cells known to the other map, and (n,) distances in meters.

    They lead to the other map's nearest occupied cell, and are infinite where it has none.
    """
    cells, targets = np.argwhere(asked.occupied).astype(np.int64), other.occupied_points()
    points = asked.centers(cells)
    known = ~np.isnan(log_odds_at(other, points))
    if len(targets) == 0:
        return cells[known], np.full(int(known.sum()), np.inf)
    distance, _ = cKDTree(targets).query(points[known])
    return cells[known], np.asarray(distance, dtype=np.float64)


def as_stored(grid: OccupancyGrid) -> OccupancyGrid:
    """Return the cells as a map file stores them: occupied, free or unknown.

    A map is evaluated by this, so that one read from a file, of whatever program, is evaluated like one in
    memory: a cell that a mapper saw and did not decide is unknown in both.
    """
    log_odds = np.where(grid.occupied | grid.free, grid.log_odds, np.float32(np.nan))
    return replace(grid, log_odds=log_odds)


def sample_like(grid: OccupancyGrid, like: OccupancyGrid) -> Float32Array:
    """Return a grid's log-odds at another grid's cell centers; NaN where unknown or outside."""
    T = grid.origin.inverse() @ like.origin
    row, col = round(T.y / grid.resolution), round(T.x / grid.resolution)
    rows, cols = like.shape
    off = math.hypot(T.x - col * grid.resolution, T.y - row * grid.resolution)
    off += abs(wrap_angle(T.yaw)) * math.hypot(rows, cols) * like.resolution
    if grid.resolution == like.resolution and off < COINCIDING * grid.resolution:
        return _shifted(grid.log_odds, row, col, like.shape)
    found = np.empty(like.shape, np.float32)
    for first in range(0, rows, BAND):
        band = np.arange(first, min(first + BAND, rows)), np.arange(cols)
        cells = np.stack(np.meshgrid(*band, indexing="ij"), axis=-1)
        found[first : first + BAND] = log_odds_at(grid, like.centers(cells))
    return found


def _shifted(values: Float32Array, row: int, col: int, shape: tuple[int, int]) -> Float32Array:
    """Return the values of a shape from a row and column on; NaN beyond."""
    found = np.full(shape, np.nan, np.float32)
    north, east = max(row + shape[0], 0), max(col + shape[1], 0)
    held = values[max(row, 0) : north, max(col, 0) : east]
    south, west = max(-row, 0), max(-col, 0)
    found[south : south + held.shape[0], west : west + held.shape[1]] = held
    return found


def log_odds_at(grid: OccupancyGrid, points: FloatArray) -> Float32Array:
    """Return a grid's log-odds at points (..., 2), meters; NaN where unknown or outside."""
    cells = grid.cells(points)
    inside = np.all((cells >= 0) & (cells < np.array(grid.shape)), axis=-1)
    held = np.where(inside[..., None], cells, 0)
    values: Float32Array = np.where(inside, grid.log_odds[held[..., 0], held[..., 1]], np.float32(np.nan))
    return values


def _confirmed_share(asked: OccupancyGrid, other: OccupancyGrid, tolerance: float) -> float:
    """Return the share of occupied cells that the other map confirms; 0 without cells."""
    _, distance = nearest_occupied(asked, other)
    return float((distance <= tolerance + ROUNDING).mean()) if len(distance) else 0.0


def map_ssim(built: OccupancyGrid, reference: OccupancyGrid) -> float | None:
    """Return the mean structural similarity over cells known in both maps, if any.

    The built map is read at the centers of the reference's cells. Pictures hold 0 for occupied, 1 for
    free and 0.5 for unknown or undecided cells.
    """
    moved = OccupancyGrid(sample_like(built, reference), reference.resolution)
    both = moved.known & reference.known
    if not both.any():
        return None
    return float(similarity(as_picture(moved), as_picture(reference))[both].mean())


def as_picture(grid: OccupancyGrid) -> Float32Array:
    """Return (rows, cols), south first: 0 for occupied, 1 for free, 0.5 otherwise."""
    picture = np.full(grid.shape, 0.5, np.float32)
    picture[grid.free] = 1.0
    picture[grid.occupied] = 0.0
    return picture


def similarity(x: FloatArray | Float32Array, y: FloatArray | Float32Array) -> FloatArray:
    """Return the structural similarity about each pixel of two pictures (rows, cols) in [0, 1].

    Wang et al., "Image Quality Assessment: From Error Visibility to Structural Similarity" (IEEE TIP
    2004), Eq. 13 with the moments of Eqs. 14-16; pictures are mirrored at their borders.
    """
    x, y = (np.asarray(picture, dtype=np.float64) for picture in (x, y))
    c1, c2 = K1**2, K2**2
    mx, my = _mean(x), _mean(y)
    vx, vy, cov = _mean(x * x) - mx * mx, _mean(y * y) - my * my, _mean(x * y) - mx * my
    above: FloatArray = (2 * mx * my + c1) * (2 * cov + c2)
    return above / ((mx * mx + my * my + c1) * (vx + vy + c2))


def _mean(picture: FloatArray) -> FloatArray:
    """Return the mean under the Gaussian window about each pixel."""
    blurred = cv2.GaussianBlur(picture, (WINDOW, WINDOW), SIGMA, borderType=cv2.BORDER_REFLECT)
    return np.asarray(blurred, dtype=np.float64)


@dataclass(frozen=True, kw_only=True)
class MapScores:
    """Metrics of one built map; None without occupied cells in either, or without a reference.

    Attributes:
        f1: Agreement with the true-pose map, harmonic mean of precision and recall.
        f1_aligned: Agreement after the alignment of the trajectory; None without one.
        start_shift: Distance by which the alignment moves the start pose, meters.
        start_turn: Angle by which the alignment turns the map, radians, not negative.
        precision: Share of the built occupied cells that the true-pose map confirms within 0.10 m.
        recall: Share of the true-pose map's occupied cells that the built map holds within 0.10 m.
        iou: Cells occupied in both over cells occupied in either.
        f1_input: Agreement with the input laser map.
        precision_input: Share of the built occupied cells that the input laser map confirms.
        recall_input: Share of the input laser map's occupied cells, where the built map knows, that it holds.
        false_occupied: Share of the built occupied cells farther than 0.10 m from any steep face or wall.
        false_occupied_aligned: Share after the alignment of the trajectory; None without one.
        reference_false_occupied: Share of the true-pose map itself: walls that no pose error made.
        unknown: Share of the true-pose map's known cells that the built map does not know.
        to_reference: Distances of the built occupied cells from the true-pose map's nearest.
        from_reference: Distances of the true-pose map's occupied cells from the built map's nearest.
        ssim: Structural similarity with the true-pose map.
        occupied_cells: Number of occupied cells of the built map.
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
    """Score a map in the world frame, before and after the alignment.

    It is compared with the map of the true poses, the world's obstacles, and the input laser map `truth`.
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


def near_obstacle(
    points: FloatArray, surface: HeightField, walls: WallGrid | None, distance: float, steep: float = STEEP
) -> BoolArray:
    """Return (n,) whether points (n, 2) are near a steep face or a wall.

    `distance` is in the plane, meters, 0 = inside the footprint; a face counts above the angle `steep`,
    radians. Each cell of the surface is two triangles.
    """
    xy = np.ascontiguousarray(points, dtype=np.float64)
    near: BoolArray = _near_steep(
        xy, surface.south_up, surface.cell, surface.origin, distance, math.tan(steep)
    )
    if walls is not None:
        local = walls.origin.inverse().apply(xy)
        near |= _near_wall(local, walls.solid, walls.resolution, distance)
    return near


@njit
def _near_steep(
    points: FloatArray, z: Any, cell: Any, origin: Any, distance: float, rise: float
) -> BoolArray:
    """Search the cells within `distance` of each point along both axes; row 0 is south."""
    rows, cols = z.shape
    cx, cy = cell
    near = np.zeros(len(points), np.bool_)
    for k in range(len(points)):
        # In meters from the south-west node.
        x, y = points[k, 0] - origin[0], points[k, 1] - origin[1]
        # A cell holds both of its edges: a point on the line between two is on either.
        i0, i1 = max(0, math.ceil((x - distance) / cx) - 1), min(cols - 2, math.floor((x + distance) / cx))
        j0, j1 = max(0, math.ceil((y - distance) / cy) - 1), min(rows - 2, math.floor((y + distance) / cy))
        for j in range(j0, j1 + 1):
            for i in range(i0, i1 + 1):
                if near[k]:
                    break
                sw, se = float(z[j, i]), float(z[j, i + 1])
                nw, ne = float(z[j + 1, i]), float(z[j + 1, i + 1])
                west, south = i * cx, j * cy
                east, north = west + cx, south + cy
                if math.hypot((se - sw) / cx, (ne - se) / cy) > rise:
                    near[k] = _to_triangle(x, y, west, south, east, south, east, north) <= distance
                if not near[k] and math.hypot((ne - nw) / cx, (nw - sw) / cy) > rise:
                    near[k] = _to_triangle(x, y, west, south, east, north, west, north) <= distance
    return near


@njit
def _near_wall(points: FloatArray, solid: BoolArray, resolution: float, distance: float) -> BoolArray:
    """Search the wall cells round points given in the wall grid's frame."""
    rows, cols = solid.shape
    near = np.zeros(len(points), np.bool_)
    for k in range(len(points)):
        x, y = points[k, 0], points[k, 1]
        i0, i1 = math.ceil((x - distance) / resolution) - 1, math.floor((x + distance) / resolution)
        j0, j1 = math.ceil((y - distance) / resolution) - 1, math.floor((y + distance) / resolution)
        for j in range(max(0, j0), min(rows - 1, j1) + 1):
            for i in range(max(0, i0), min(cols - 1, i1) + 1):
                if solid[j, i]:
                    dx = max(i * resolution - x, 0.0, x - (i + 1) * resolution)
                    dy = max(j * resolution - y, 0.0, y - (j + 1) * resolution)
                    near[k] |= math.hypot(dx, dy) <= distance
    return near


@njit
def _to_triangle(
    x: float, y: float, ax: float, ay: float, bx: float, by: float, cx: float, cy: float
) -> float:
    """Return the distance of a point to a triangle given counter-clockwise; 0 inside."""
    inside = (
        (bx - ax) * (y - ay) - (by - ay) * (x - ax) >= 0
        and (cx - bx) * (y - by) - (cy - by) * (x - bx) >= 0
        and (ax - cx) * (y - cy) - (ay - cy) * (x - cx) >= 0
    )
    if inside:
        return 0.0
    nearest: float = min(
        _to_segment(x, y, ax, ay, bx, by),
        _to_segment(x, y, bx, by, cx, cy),
        _to_segment(x, y, cx, cy, ax, ay),
    )
    return nearest


@njit
def _to_segment(x: float, y: float, ax: float, ay: float, bx: float, by: float) -> float:
    """Return the distance of a point to a segment."""
    dx, dy = bx - ax, by - ay
    t = ((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy)
    t = min(1.0, max(0.0, t))
    return math.hypot(x - ax - t * dx, y - ay - t * dy)


def count_hits(world: World, hits: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Return (n,) hits on walls and on other ground of scans with hits (k, 2)."""
    # All scans together: each call copies the surface.
    near = near_obstacle(np.concatenate(hits), world.surface, world.walls, WALL_DISTANCE)
    scan = np.repeat(np.arange(len(hits)), [len(points) for points in hits])
    walls, ground = (np.bincount(scan[each], minlength=len(hits)) for each in (near, ~near))
    return walls.astype(np.float64), ground.astype(np.float64)


def observed_support(world: World, scans: Sequence[LaserScan], poses: Sequence[Pose3]) -> dict[str, float]:
    """Count returns and hits on walls of recorded scans at poses `T_world_base`."""
    points = [
        (pose @ scan.T_base_laser).apply(scan.points)[:, :2] for scan, pose in zip(scans, poses, strict=True)
    ]
    walls, _ = count_hits(world, points)
    return {
        "beams": len(scans[0].ranges),
        "range_max": scans[0].range_max,
        "returns_median": float(np.median([len(each) for each in points])),
        "walls_median": float(np.median(walls)),
    }
