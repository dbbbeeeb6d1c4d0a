"""Hillshade of a world: shaded heights, walls, color scale of heights."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.colors import Colormap, LinearSegmentedColormap

from lirs_wct.arrays import FloatArray
from lirs_wct.drawing.canvas import BAND, Canvas
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.world import World

AZIMUTH, ALTITUDE = math.radians(315), math.radians(45)
"""Direction of the light: north-west, as on printed maps since the Swiss Dufour map."""
WALL = (0.16, 0.16, 0.20)
FLOOR, BEYOND = (0.97, 0.97, 0.96), (0.84, 0.84, 0.85)
"""Colors of a laser map's known cells and of its unknown cells."""


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
