"""Heights in the colors of map tiles: Mapbox's Terrain-RGB and Mapzen's Terrarium."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lirs_wct.arrays import FloatArray
from lirs_wct.geometry.geodesy.earth import WGS84, CoordinateSystem
from lirs_wct.geometry.geodesy.georeference import Georeference

Encoding = Literal["gray", "terrain-rgb", "terrarium"]
ENCODINGS: tuple[Encoding, ...] = ("gray", "terrain-rgb", "terrarium")
LOWEST, HIGHEST = -11_500.0, 9_000.0
"""Heights of the earth, meters: colors that mean others are those of a picture."""
_TILE = re.compile(r"(\d{1,2})/(\d+)/(\d+)(@2x)?")
_WORLD = 2 * math.pi * WGS84[0]
"""Meters of web Mercator around the world."""


def decode(pixels: NDArray[Any], encoding: Encoding) -> FloatArray:
    """Return (rows, cols) meters of (rows, cols, 3 or more) 8-bit BGR pixels.

    Terrain-RGB: -10000 + 0.1 (65536 R + 256 G + B), Mapbox's documentation of Terrain-RGB. Terrarium:
    256 R + G + B / 256 - 32768, documentation of Mapzen's (Tilezen's) terrain tiles.
    """
    blue, green, red = (pixels[..., k].astype(np.float64) for k in range(3))
    if encoding == "terrain-rgb":
        return np.asarray(-10000.0 + 0.1 * (65536.0 * red + 256.0 * green + blue))
    return np.asarray(256.0 * red + green + blue / 256.0 - 32768.0)


def guess(pixels: NDArray[Any]) -> Encoding | None:
    """Return how the colors of a picture are likely heights; None where they are just colors.

    Heights of the earth fill a hundredth of what either encoding can say. Red hardly changes then, green
    jumps where it does, since it begins anew, and blue, the smallest digit, seldom stands still.
    """
    if pixels.ndim != 3 or pixels.dtype != np.uint8:
        return None
    blue, green, red = (np.abs(np.diff(pixels[..., k].astype(np.int16), axis=1)) for k in range(3))
    jumps = green[red > 0]
    if np.median(blue) < 3 or (red > 0).mean() > 0.2 or (jumps.size and np.median(jumps) < 128):
        return None
    for encoding in ENCODINGS[1:]:
        meters = decode(pixels, encoding)
        if LOWEST <= meters.min() < meters.max() <= HIGHEST:
            return encoding
    return None


def tile_georeference(path: Path, shape: tuple[int, int]) -> Georeference | None:
    """Return where a tile lies that is stored as .../z/x/y.png; None of a file with another name."""
    named = _TILE.fullmatch("/".join((*path.resolve().parts[-3:-1], path.stem)))
    if named is None:
        return None
    zoom, column, row = (int(named[k]) for k in (1, 2, 3))
    if zoom > 24 or max(column, row) >= 2**zoom:
        return None
    side = _WORLD / 2**zoom
    sx, sy = side / shape[1], side / shape[0]
    west, north = column * side - _WORLD / 2, _WORLD / 2 - row * side
    affine = (sx, 0.0, west + sx / 2, 0.0, -sy, north - sy / 2)
    return Georeference.of(CoordinateSystem.of_code(3857), affine, shape)
