"""Elevation maps as pictures: heights in color, and by how much they are off."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch

from lirs_validation.metrics.spatial.elevation import ElevationMap
from lirs_wct.arrays import FloatArray
from lirs_wct.drawing.canvas import UNKNOWN_SHADE, Canvas
from lirs_wct.drawing.hillshade import WALL, height_colors
from lirs_wct.drawing.style import BLUE, VERMILLION, legend, map_axes, rgb, title
from lirs_wct.world import World

FULL = 0.20
"""Meters that a height is off where its color is full."""


def elevation_panels(axes: tuple[Axes, Axes], canvas: Canvas, world: World, built: ElevationMap) -> None:
    """Show the mapper's elevation map, and by how much it differs from the true surface."""
    map_axes(axes[0], canvas, height_picture(canvas, world, built))
    title(axes[0], "Elevation by the mapper's poses")
    map_axes(axes[1], canvas, error_picture(canvas, world, built))
    title(axes[1], "Less the surface")
    handles = [
        Patch(color=BLUE, label=f"{FULL:.1f} m too low"),
        Patch(color=VERMILLION, label="too high"),
    ]
    legend(axes[1], handles)


def height_picture(canvas: Canvas, world: World, built: ElevationMap) -> FloatArray:
    """Return (rows, cols, 3) heights on the colors of the world's terrain; gray = not seen."""
    low, high = float(world.surface.z.min()), float(world.surface.z.max())
    z = _sampled(canvas, built, built.mean)
    picture = height_colors()((np.nan_to_num(z, nan=low) - low) / max(high - low, 1.0))[..., :3]
    return _with_unknown(picture, z, canvas, world)


def error_picture(canvas: Canvas, world: World, built: ElevationMap) -> FloatArray:
    """Return (rows, cols, 3) white = right, blue = too low, vermillion = too high, gray = none."""
    error = _sampled(canvas, built, built.error(world.surface, world.walls))
    share = np.clip(np.nan_to_num(error) / FULL, -1, 1)[..., None]
    color = np.where(share > 0, rgb(VERMILLION), rgb(BLUE))
    return _with_unknown(1 - np.abs(share) * (1 - color), error, canvas, world)


def _with_unknown(picture: FloatArray, values: FloatArray, canvas: Canvas, world: World) -> FloatArray:
    picture[np.isnan(values)] = UNKNOWN_SHADE
    if world.walls is not None:
        picture[canvas.walls(world.walls)] = WALL
    return picture


def _sampled(canvas: Canvas, grid: ElevationMap, values: FloatArray) -> FloatArray:
    """Return (rows, cols) the values (of the grid's cells) at the canvas' pixels; NaN off the grid."""
    index = np.floor((canvas.centers - grid.origin) / grid.cell).astype(np.int64)
    col, row = index[..., 0], index[..., 1]
    inside = (row >= 0) & (row < values.shape[0]) & (col >= 0) & (col < values.shape[1])
    return np.where(inside, values[np.where(inside, row, 0), np.where(inside, col, 0)], np.nan)
