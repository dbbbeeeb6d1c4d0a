"""Reader of laser maps: walls on a level floor."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from lirs_wct.errors import ConfigError, require_known
from lirs_wct.formats.map_server import read_map, read_map_picture
from lirs_wct.geometry import HeightField, OccupancyGrid, Pose2, WallGrid
from lirs_wct.geometry.geodesy import CoordinateSystem, Place
from lirs_wct.ground import LaserMap, Window
from lirs_wct.sources.source import UNKNOWN, BuildOptions, Reading, Source, SourceKind, Unknown, local_origin


def read_laser_map(source: Source, options: BuildOptions) -> Reading:
    """Read a laser map as walls on a level floor."""
    if source.kind is SourceKind.MAP:
        truth = read_map(source.path, options.max_pixels)
    elif options.resolution is None:
        raise ConfigError(f"{source.path}: a map picture without YAML needs --resolution (meters a pixel)")
    else:
        truth = read_map_picture(source.path, options.resolution, options.max_pixels)
    size, origin = truth.resolution * np.array(truth.shape[::-1]), truth.origin
    corners = origin.apply(size * ((0, 0), (0, 1), (1, 0), (1, 1)))
    x, y = local_origin(source.path, corners.min(axis=0), corners.max(axis=0))
    truth = replace(truth, origin=Pose2(origin.x - x, origin.y - y, origin.yaw))
    if options.window is not None:
        truth = cut_map(truth, options.window)
    truth = without_small_walls(truth, options.speckle)
    walls = walls_of(truth, options.wall_height, options.unknown)
    place = Place(CoordinateSystem(), (1.0, 0.0, x, 0.0, 1.0, y)) if (x, y) != (0.0, 0.0) else None
    return LaserMap(level_floor(walls), walls, truth), f"{truth.resolution:g} m a cell", place


def cut_map(grid: OccupancyGrid, window: Window) -> OccupancyGrid:
    """Keep the cells around a square (its bounding box in the grid's own axes)."""
    x, y, side = window
    corners = [(x + sx * side / 2, y + sy * side / 2) for sx in (-1, 1) for sy in (-1, 1)]
    cells = grid.cells(corners)
    low = np.maximum(cells.min(axis=0), 0)
    high = np.minimum(cells.max(axis=0) + 1, grid.shape)
    if np.any(high <= low):
        raise ConfigError(f"window {x:g},{y:g},{side:g} lies outside the map")
    part = np.ascontiguousarray(grid.log_odds[low[0] : high[0], low[1] : high[1]])
    shift = Pose2(float(low[1]) * grid.resolution, float(low[0]) * grid.resolution)
    return replace(grid, log_odds=part, origin=grid.origin @ shift)


def walls_of(grid: OccupancyGrid, height: float, unknown: Unknown = "floor") -> WallGrid:
    """Return the occupied cells of a map as walls, the unknown ones as asked."""
    require_known("kind of unknown cell", unknown, UNKNOWN)
    solid = grid.occupied | ~grid.known if unknown == "wall" else grid.occupied
    hole = ~grid.known if unknown == "hole" and not grid.known.all() else None
    return WallGrid(solid, grid.resolution, grid.origin, height, hole)


def without_small_walls(grid: OccupancyGrid, min_cells: int) -> OccupancyGrid:
    """Return a map without groups of fewer than `min_cells` connected occupied cells.

    The cells of these groups become free. Cells that touch at a corner are connected.
    """
    occupied = grid.occupied
    _, label, stats, _ = cv2.connectedComponentsWithStats(occupied.astype(np.uint8), connectivity=8)
    small = (stats[:, cv2.CC_STAT_AREA] < min_cells)[label] & occupied
    if not small.any():
        return grid
    return OccupancyGrid.from_probability(
        np.where(small, 0.0, grid.probability), grid.resolution, grid.origin
    )


def level_floor(walls: WallGrid) -> HeightField:
    """Return level ground under the whole map, whatever its yaw."""
    low, high = walls.corners.min(axis=0), walls.corners.max(axis=0)
    width, depth = (high - low).tolist()
    return HeightField(np.zeros((2, 2), np.float32), (width, depth), (float(low[0]), float(low[1])))
