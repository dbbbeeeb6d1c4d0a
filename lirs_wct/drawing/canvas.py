"""Canvas of a top-view picture: square pixels over the world, hillshade, maps, paths."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from matplotlib.colors import Colormap, LinearSegmentedColormap

from lirs_wct.arrays import BoolArray, FloatArray
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.geometry.pose import Pose2, Trajectory
from lirs_wct.geometry.walls import WallGrid
from lirs_wct.world import World

MARGIN = 1.0
"""Margin around paths and known cells, meters."""
BAND = 64
"""Rows of pixels per step; it limits the memory of intermediate arrays."""
FREE_SHADE, UNKNOWN_SHADE = 1.0, 0.80
"""Gray of free cells and of unknown cells."""
AZIMUTH, ALTITUDE = math.radians(315), math.radians(45)
"""Direction of the light: north-west, as on printed maps since the Swiss Dufour map."""
WALL = (0.16, 0.16, 0.20)
FLOOR, BEYOND = (0.97, 0.97, 0.96), (0.84, 0.84, 0.85)
"""Colors of a laser map's known cells and of its unknown cells."""


@dataclass(frozen=True)
class Canvas:
    """Placement of a picture in the world; row 0 = north.

    Attributes:
        bounds: west, south, east, north in meters.
        shape: rows, columns of square pixels.
    """

    bounds: tuple[float, float, float, float]
    shape: tuple[int, int]

    @staticmethod
    def over(bounds: tuple[float, float, float, float], pixels: int = 900) -> Canvas:
        """Lay square pixels over bounds, `pixels` along the longer side."""
        west, south, east, north = bounds
        pixel = max(east - west, north - south) / pixels
        rows, cols = max(1, round((north - south) / pixel)), max(1, round((east - west) / pixel))
        return Canvas((west, south, west + cols * pixel, south + rows * pixel), (rows, cols))

    @property
    def pixel(self) -> float:
        """Edge of a pixel, meters."""
        return (self.bounds[2] - self.bounds[0]) / self.shape[1]

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """West, east, south, north, as matplotlib's `imshow` expects."""
        west, south, east, north = self.bounds
        return west, east, south, north

    @property
    def centers(self) -> FloatArray:
        """(rows, cols, 2) x and y of the pixels' centers, meters."""
        return self._centers(slice(None))

    def _bands(self) -> Iterator[slice]:
        return (slice(first, first + BAND) for first in range(0, self.shape[0], BAND))

    def _centers(self, rows: slice) -> FloatArray:
        """Return (rows, cols, 2) the centers of some rows, meters."""
        west, _, _, north = self.bounds
        x = west + (np.arange(self.shape[1]) + 0.5) * self.pixel
        y = north - (np.arange(self.shape[0])[rows] + 0.5) * self.pixel
        return np.stack(np.meshgrid(x, y), axis=-1)

    def heights(self, surface: HeightField) -> FloatArray:
        """Return (rows, cols) meters; NaN off the surface."""
        heights = np.empty(self.shape)
        for band in self._bands():
            xy = self._centers(band)
            heights[band] = surface.height_at(xy[..., 0], xy[..., 1])
        return heights

    def mark_pixels(self, mask: BoolArray, resolution: float, origin: Pose2) -> BoolArray:
        """Return the pixels that contain a marked cell of a grid, also of cells smaller than a pixel.

        Row 0 of `mask` is south.
        """
        seen, to_grid = np.empty(self.shape, np.bool_), origin.inverse()
        for band in self._bands():
            local = np.floor(to_grid.apply(self._centers(band)) / resolution).astype(np.int64)
            col, row = local[..., 0], local[..., 1]
            inside = (row >= 0) & (row < mask.shape[0]) & (col >= 0) & (col < mask.shape[1])
            seen[band] = inside & mask[np.where(inside, row, 0), np.where(inside, col, 0)]
        if resolution < self.pixel:
            points = origin.apply((np.argwhere(mask)[:, ::-1] + 0.5) * resolution)
            self._touch(seen, points)
        return seen

    def _touch(self, pixels: BoolArray, points: FloatArray) -> None:
        col = np.floor((points[:, 0] - self.bounds[0]) / self.pixel).astype(np.int64)
        row = np.floor((self.bounds[3] - points[:, 1]) / self.pixel).astype(np.int64)
        inside = (row >= 0) & (row < self.shape[0]) & (col >= 0) & (col < self.shape[1])
        pixels[row[inside], col[inside]] = True

    def walls(self, walls: WallGrid) -> BoolArray:
        """Return the pixels that contain a wall cell."""
        return self.mark_pixels(walls.solid, walls.resolution, walls.origin)

    def known(self, grid: OccupancyGrid) -> BoolArray:
        """Return the pixels that contain a known cell of a map."""
        return self.mark_pixels(grid.known, grid.resolution, grid.origin)

    def occupied(self, grid: OccupancyGrid) -> BoolArray:
        """Return the pixels that contain an occupied cell of a map."""
        return self.mark_pixels(grid.occupied, grid.resolution, grid.origin)

    def grid_picture(self, grid: OccupancyGrid) -> FloatArray:
        """Return the (rows, cols, 3) picture of a map: black occupied, white free, gray unknown."""
        shade = np.full(self.shape, UNKNOWN_SHADE)
        shade[self.known(grid)] = FREE_SHADE
        shade[self.occupied(grid)] = 0.0
        return np.repeat(shade[..., None], 3, axis=-1)


def bounds_shown(path: Trajectory, grid: OccupancyGrid) -> tuple[float, float, float, float]:
    """Return west, south, east, north of a path and a map's known cells.

    Meters, with a margin.
    """
    boxes = [(*path.xy.min(axis=0).tolist(), *path.xy.max(axis=0).tolist())]
    known = bounds_of(grid)
    if known is not None:
        boxes.append(known)
    seen = np.array(boxes)
    west, south = (seen[:, :2].min(axis=0) - MARGIN).tolist()
    east, north = (seen[:, 2:].max(axis=0) + MARGIN).tolist()
    return west, south, east, north


def bounds_of(grid: OccupancyGrid) -> tuple[float, float, float, float] | None:
    """Return west, south, east, north of a map's known cells, meters; None without any."""
    rows, cols = (np.flatnonzero(grid.known.any(axis=axis)) for axis in (1, 0))
    if len(rows) == 0:
        return None
    low, high = (rows[0], cols[0]), (rows[-1] + 1, cols[-1] + 1)
    corners = np.array([(c, r) for r in (low[0], high[0]) for c in (low[1], high[1])], dtype=np.float64)
    xy = grid.origin.apply(corners * grid.resolution)
    (west, south), (east, north) = xy.min(axis=0).tolist(), xy.max(axis=0).tolist()
    return west, south, east, north


def height_colors() -> Colormap:
    """Return a color scale from low (slate) to high (sand) with rising brightness."""
    return LinearSegmentedColormap.from_list("relief", ["#7d97a5", "#a9b5ac", "#d3cfb4", "#f6e8c6"])


def shaded_heights(world: World, canvas: Canvas) -> FloatArray:
    """Return a (rows, cols, 3) hillshade tinted by height; for a laser map, floor and walls."""
    if world.truth is not None:
        rgb = np.where(canvas.known(world.truth)[..., None], FLOOR, BEYOND)
    else:
        rgb = shaded_surface(world.surface, canvas)
    if world.walls is not None:
        rgb[canvas.walls(world.walls)] = WALL
    return rgb


def shaded_surface(surface: HeightField, canvas: Canvas) -> FloatArray:
    """Return a (rows, cols, 3) hillshade in [0, 1] tinted by height.

    Row 0 = north. Lambertian shading (Horn, "Hill shading and the reflectance map", Proc. IEEE 1981).
    Heights are exaggerated until the ground's typical slope is visible.
    """
    z = canvas.heights(surface)
    low, high = float(surface.z.min()), float(surface.z.max())
    colors, light = height_colors(), 0.42 + 0.78 * shading(z, canvas.pixel)[..., None]
    rgb = np.empty((*z.shape, 3))
    for first in range(0, len(z), BAND):
        band = slice(first, first + BAND)
        tint = colors((np.nan_to_num(z[band], nan=low) - low) / max(high - low, 1e-9))[..., :3]
        np.clip(tint * light[band], 0, 1, out=rgb[band])
    return rgb


def shading(z: FloatArray, pixel: float) -> FloatArray:
    """Return (rows, cols) brightness in [0, 1] of heights in meters.

    Row 0 = north. Level ground has 0.7.
    """
    height = np.where(np.isnan(z), np.nanmin(z) if np.isfinite(z).any() else 0.0, z)
    if min(height.shape) < 2:
        return np.full(height.shape, math.sin(ALTITUDE))
    north, east = np.gradient(height, -pixel, pixel)
    typical = float(np.median(np.hypot(north, east)))
    exaggeration = float(np.clip(0.25 / typical, 1.0, 6.0)) if typical > 1e-4 else 1.0
    east, north = east * exaggeration, north * exaggeration
    light = (
        math.sin(AZIMUTH) * math.cos(ALTITUDE),
        math.cos(AZIMUTH) * math.cos(ALTITUDE),
        math.sin(ALTITUDE),
    )
    lambert = (light[2] - east * light[0] - north * light[1]) / np.sqrt(1 + east**2 + north**2)
    brightness: FloatArray = np.clip(lambert, 0.0, 1.0)
    return brightness
