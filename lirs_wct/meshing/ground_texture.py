"""Default textures: heights and slopes in earth colors, floor slabs, wall plaster."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import scipy  # its modules load on first use

from lirs_wct.arrays import ByteArray, FloatArray
from lirs_wct.errors import SourceError
from lirs_wct.formats.picture import read_picture
from lirs_wct.geometry import WallGrid
from lirs_wct.geometry.grid import mask_at
from lirs_wct.geometry.heightfield import HeightField

TEXTURE_SUFFIXES = (".png", ".jpg", ".jpeg")
"""Texture formats that both Gazebo and the MuJoCo viewer support."""
PIXELS = 1024
EARTH = np.array(((92, 110, 70), (146, 138, 96), (178, 158, 122), (222, 214, 200)), np.float64)
"""Meadow, dry grass, rock, scree: red, green, blue from the lowest to the highest ground."""
FLOOR, WALL = np.array((205, 203, 196), np.float64), np.array((120, 116, 112), np.float64)
FLOOR_SPAN, SLABS, TILE_PIXELS = 2.0, 4, 512
"""Side of the floor's texture (meters), slabs along it, and pixels along a repeated texture."""
SUN = np.array((-0.5, 0.5, 0.7071))
"""Unit vector towards the light: north-west, as on printed maps since the Swiss Dufour map, 45 deg up."""


def checked_texture(path: Path | None, max_pixels: int) -> Path | None:
    """Return the path of a texture after a check of its file.

    Raises:
        SourceError: the texture is missing, damaged, or neither PNG nor JPEG.
    """
    if path is None:
        return None
    if path.suffix.lower() not in TEXTURE_SUFFIXES:
        raise SourceError(f"{path}: a texture must be a PNG or JPEG picture ({', '.join(TEXTURE_SUFFIXES)})")
    read_picture(path, max_pixels, alpha=True)
    return path


def ground_texture(surface: HeightField, walls: WallGrid | None = None) -> ByteArray:
    """Return a (rows, cols, 3) BGR top view of the surface, row 0 = north.

    The longer side has 1024 px.
    """
    west, south, _, _ = surface.bounds
    span = max(surface.size)
    cols, rows = (max(2, round(PIXELS * side / span)) for side in surface.size)
    x = west + (np.arange(cols) + 0.5) * surface.size[0] / cols
    y = (south + (np.arange(rows)[::-1] + 0.5) * surface.size[1] / rows)[:, None]
    if walls is None:
        rgb = _earth(surface, x, y, (surface.size[1] / rows, surface.size[0] / cols))
    else:
        points = np.stack(np.broadcast_arrays(x, y), axis=-1)
        on_wall = mask_at(walls.solid, walls.resolution, walls.origin, points)
        rgb = np.where(on_wall[..., None], WALL.astype(np.uint8), FLOOR.astype(np.uint8))
    return np.ascontiguousarray(rgb[..., ::-1])


@cache
def floor_texture() -> ByteArray:
    """Return (512, 512, 3) BGR, read-only: seamless slabs over `FLOOR_SPAN` meters."""
    side = TILE_PIXELS // SLABS
    shade = np.random.default_rng(1).normal(0.0, 3.0, (SLABS, SLABS)).repeat(side, 0).repeat(side, 1)
    joint = np.minimum(np.arange(TILE_PIXELS) % side, side - 1 - np.arange(TILE_PIXELS) % side) < 1
    shade[joint] = shade[:, joint] = -28.0
    return _apply_shade(FLOOR, shade + _grain(2, 2.5))


@cache
def wall_texture() -> ByteArray:
    """Return (512, 512, 3) BGR, read-only: seamless rough plaster of any size."""
    return _apply_shade(WALL, _grain(3, 6.0))


def _grain(seed: int, strength: float) -> FloatArray:
    """Return (512, 512) periodic noise with blotches of a tenth of its size."""
    noise = np.random.default_rng(seed).normal(size=(TILE_PIXELS, TILE_PIXELS))
    blotches = scipy.ndimage.gaussian_filter(noise, TILE_PIXELS / 40, mode="wrap")
    fine = scipy.ndimage.gaussian_filter(noise, 1.0, mode="wrap")
    grain: FloatArray = strength * (blotches / blotches.std() + 0.6 * fine / fine.std())
    return grain


def _apply_shade(color: FloatArray, shade: FloatArray) -> ByteArray:
    pixels = np.clip(color[::-1] + shade[..., None], 0, 255).astype(np.uint8)
    pixels.setflags(write=False)
    return pixels


def _earth(surface: HeightField, x: FloatArray, y: FloatArray, pixel: tuple[float, float]) -> ByteArray:
    # Strip by strip and color by color: all at once would take a hundred megabytes.
    z = np.concatenate([surface.height_at(x, strip) for strip in np.array_split(y, 16)])
    light = 0.55 + 0.6 * lambert(z, pixel)
    z -= z.min()
    z /= max(float(z.max()), 1e-9)
    levels = np.linspace(0, 1, len(EARTH))
    rgb = np.empty((*z.shape, 3), np.uint8)
    for k in range(3):
        rgb[..., k] = np.clip(np.interp(z, levels, EARTH[:, k]) * light, 0, 255)
    return rgb


def lambert(z: FloatArray, pixel: tuple[float, float]) -> FloatArray:
    """Return the brightness in [0, 1] of each node under `SUN`, row 0 = north."""
    dz_dy, dz_dx = np.gradient(z, *pixel)
    cosine = (-dz_dx * SUN[0] + dz_dy * SUN[1] + SUN[2]) / np.sqrt(dz_dx**2 + dz_dy**2 + 1)
    brightness: FloatArray = np.clip(cosine, 0, 1)
    return brightness
