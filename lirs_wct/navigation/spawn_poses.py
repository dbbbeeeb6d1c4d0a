"""Spawn poses of footprints on free ground, and the mapped area of a laser map."""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass
from importlib.resources import files

import cv2
import numpy as np

from lirs_wct.arrays import BoolArray, Float32Array, FloatArray, IntArray
from lirs_wct.geometry import OccupancyGrid, Pose2
from lirs_wct.navigation.traversability import distance_to

MARGIN = 0.22
"""Free ground beyond a robot's radius at a roomy start, meters."""
TIGHT_MARGIN = 0.15
"""The same without a roomy start, meters; path planning keeps this margin."""
GENTLE = math.radians(12)
"""Steepest ground of a roomy start, radians, even if the robot can drive steeper ground."""


@dataclass(frozen=True)
class Footprint:
    """Size and slope limit of a robot.

    Attributes:
        robot: name of the robot.
        radius: radius of its enclosing circle, meters.
        max_slope: steepest ground that it drives, radians.
    """

    robot: str
    radius: float
    max_slope: float

    @property
    def limits(self) -> tuple[tuple[float, float], ...]:
        """Clearance (meters) and slope (radians) of a roomy start, then of any start."""
        return (
            (round(self.radius + MARGIN, 6), min(self.max_slope, GENTLE)),
            (round(self.radius + TIGHT_MARGIN, 6), self.max_slope),
        )


ROBOTS = tomllib.loads(files("lirs_wct").joinpath("robots.toml").read_text(encoding="utf-8"))
FOOTPRINTS = tuple(
    Footprint(name, figures["radius"], math.radians(figures["max_slope"]))
    for name, figures in sorted(ROBOTS.items(), key=lambda item: -item[1]["radius"])
    if "left_wheels" in figures
)
"""Wheeled robots, the largest first."""


EDGE = 0.15
"""Share of the free area's extent on each side without start poses."""
VIEW = 1.0
"""Free distance ahead of a robot's center at its start, meters."""
FAR, DIRECTIONS = 20.0, 24
"""Range (meters) and number of directions of the search for the longest view."""
LEAST = 0.05
"""Share of the largest enclosed extent below which an area counts as closet or scan gap."""
NEAR = 1.0
"""Distance from the origin of a map's frame within which an area counts as being at the origin, meters."""


def spawn_poses(free: OccupancyGrid, count: int = 8, *, corridors: bool = False) -> tuple[Pose2, ...]:
    """Return up to `count` poses on the largest connected free area, the roomiest first.

    Each pose faces the center of that area and lies in its inner part, because a robot at the edge of the
    world sees little of it. The method is farthest-point sampling: the same grid gives the same poses.

    Args:
        free: grid whose free cells are legal positions of a robot's center.
        count: largest number of poses.
        corridors: whether a pose that would face a wall turns to its longest view instead.
    """
    area = _inner(largest_area(free.free))
    points = free.centers(np.argwhere(area))
    if len(points) == 0:
        return ()
    room = distance_to(~area, free.resolution)[area]
    middle = points.mean(axis=0)
    first = int(np.argmax(np.minimum(room, 3.0) - 0.02 * np.hypot(*(points - middle).T)))
    chosen = _farthest(points, np.minimum(room, 2.0), first, min(count, len(points)))
    return tuple(_facing(free if corridors else None, points[i], middle) for i in chosen)


def _inner(area: BoolArray) -> BoolArray:
    """Return the part of an area away from the ends of its extent; all of it if that is empty."""
    inner = area.copy()
    for axis in (0, 1):
        filled = np.flatnonzero(area.any(axis=1 - axis))
        if len(filled) == 0:
            return area
        low, high = int(filled[0]), int(filled[-1])
        at = np.arange(area.shape[axis])
        outside = (at < low + EDGE * (high - low)) | (at > high - EDGE * (high - low))
        inner[(outside, slice(None)) if axis == 0 else (slice(None), outside)] = False
    return inner if inner.any() else area


def _farthest(points: FloatArray, bonus: FloatArray, first: int, count: int) -> list[int]:
    """Return indices; each next point maximizes its distance to the earlier ones plus its bonus."""
    chosen = [first]
    gap = np.full(len(points), np.inf)
    while len(chosen) < count:
        gap = np.minimum(gap, np.hypot(*(points - points[chosen[-1]]).T))
        chosen.append(int(np.argmax(gap + bonus)))
    return chosen


def _facing(free: OccupancyGrid | None, point: FloatArray, target: FloatArray) -> Pose2:
    """Return the pose at a point that faces a target, or the longest view if the target is hidden."""
    dx, dy = (target - point).tolist()
    yaw = math.atan2(dy, dx) if math.hypot(dx, dy) > 1e-9 else 0.0
    if free is not None and min(VIEW, math.hypot(dx, dy)) > _view(free, point, yaw, VIEW):
        directions = [2 * math.pi * k / DIRECTIONS - math.pi for k in range(DIRECTIONS)]
        yaw = max(directions, key=lambda direction: _view(free, point, direction, FAR))
    return Pose2(float(point[0]), float(point[1]), yaw)


def _view(free: OccupancyGrid, point: FloatArray, yaw: float, reach: float) -> float:
    """Return the free distance ahead of a point, at most `reach`, meters."""
    steps = np.arange(0.0, reach + free.resolution / 2, free.resolution / 2)
    ahead = point + steps[:, None] * np.array((math.cos(yaw), math.sin(yaw)))
    rows, cols = free.cells(ahead).T
    inside = (rows >= 0) & (rows < free.shape[0]) & (cols >= 0) & (cols < free.shape[1])
    blocked = ~inside
    blocked[inside] = free.log_odds[rows[inside], cols[inside]] >= 0
    return float(steps[np.argmax(blocked)]) if blocked.any() else reach


def largest_area(mask: BoolArray) -> BoolArray:
    """Return the largest 4-connected area of a mask; all False if the mask is empty."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    sizes = stats[1:, cv2.CC_STAT_AREA]
    if len(sizes) == 0:
        return np.zeros_like(mask)
    area: BoolArray = labels == 1 + int(np.argmax(sizes))
    return area


def mapped_area(free: OccupancyGrid, border: float) -> BoolArray:
    """Return (rows, cols) whether a cell is in the area where the map was recorded.

    This is the free area at the origin of the map's frame, where the mapping robot started. If nothing is
    free there, it is the area with the largest extent, islands included, that walls separate from the map's
    border: a race track, not its infield and not the space outside. All False if no cell is free.

    Args:
        free: grid whose free cells are legal positions of a small robot's center.
        border: distance that such a robot keeps from the border, meters.
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
    """Return the number of cells within each area's outer contour.

    Small areas count the cells of their bounding box.
    """
    extents = (stats[1:, cv2.CC_STAT_WIDTH] * stats[1:, cv2.CC_STAT_HEIGHT]).astype(np.float32)
    for k in np.flatnonzero(extents >= LEAST * extents.max()):
        left, top, width, height = stats[1 + k, :4].tolist()
        part = (labels[top : top + height, left : left + width] == 1 + k).astype(np.uint8)
        contours, _ = cv2.findContours(part, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        extents[k] = sum(cv2.contourArea(contour) for contour in contours)
    return extents


def _label_at_origin(free: OccupancyGrid, labels: IntArray, mask: BoolArray) -> int:
    """Return the label of the free cell nearest to the frame's origin; 0 if none is near."""
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
