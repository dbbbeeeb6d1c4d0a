"""Where the pixels of a raster lie on the earth."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lirs_wct.arrays import FloatArray
from lirs_wct.geometry.geodesy.earth import CoordinateSystem

Affine = tuple[float, float, float, float, float, float]
"""a, b, c, d, e, f of x = a u + b v + c, y = d u + e v + f."""
TURNED = 1e-4
"""Sine of a raster's turn, or cosine between its rows and columns, that is worth a word."""


@dataclass(frozen=True, slots=True)
class Georeference:
    """Coordinates and ground meters of a raster's pixels.

    Attributes:
        system: of the coordinates.
        affine: column and row of a pixel's middle (whole numbers) to coordinates.
        steps: meters eastward and northward on the ground, at the raster's middle, from one column to the
            next, and from one row to the next: ((east, north), (east, north)).
        located: whether the coordinates are known, and not only their spacing.
    """

    system: CoordinateSystem
    affine: Affine
    steps: tuple[tuple[float, float], tuple[float, float]]
    located: bool = True

    @staticmethod
    def of(system: CoordinateSystem, affine: Affine, shape: tuple[int, int]) -> Georeference:
        """Return the georeference of a raster of (rows, cols) pixels.

        Raises:
            ConfigError: the raster's middle is no place on the earth, or PROJ is needed and not there.
        """
        a, b, c, d, e, f = affine
        u, v = (shape[1] - 1) / 2, (shape[0] - 1) / 2
        ground = system.ground_meters(a * u + b * v + c, d * u + e * v + f)
        column, row = (ground @ np.array(((a, b), (d, e)))).T.tolist()
        return Georeference(system, affine, (tuple(column), tuple(row)))

    @staticmethod
    def on_grid(system: CoordinateSystem, affine: Affine, *, located: bool = True) -> Georeference:
        """Return the georeference of a raster whose units are taken for ground meters."""
        a, b, _, d, e, _ = (value * system.unit for value in affine)
        return Georeference(system, affine, ((a, d), (b, e)), located)

    @property
    def pixel(self) -> tuple[float, float]:
        """Ground meters from one column, and one row, to the next."""
        return math.hypot(*self.steps[0]), math.hypot(*self.steps[1])

    @property
    def heading(self) -> float:
        """Degrees north of east to which the columns go on."""
        return math.degrees(math.atan2(self.steps[0][1], self.steps[0][0]))

    @property
    def turn(self) -> float:
        """Degrees by which the raster is turned in its own coordinates, from x towards y."""
        return math.degrees(math.atan2(self.affine[3], self.affine[0]))

    @property
    def skewed(self) -> bool:
        """Whether columns and rows are not at right angles."""
        (ce, cn), (re, rn) = self.steps
        return abs(ce * re + cn * rn) > 100 * TURNED * math.hypot(ce, cn) * math.hypot(re, rn)

    def upright(self, pixels: NDArray[Any]) -> tuple[NDArray[Any], Georeference]:
        """Return pixels and georeference with the columns as near to east, the rows to south, as they go.

        Rows and columns are exchanged and turned round; no pixel is computed anew.
        """
        found, (a, b, c, d, e, f) = self, self.affine
        if abs(self.steps[0][0]) < abs(self.steps[1][0]):
            pixels, (a, b, d, e) = pixels.swapaxes(0, 1), (b, a, e, d)
            found = replace(found, steps=found.steps[::-1])
        (ce, cn), (re, rn) = found.steps
        if ce < 0:
            last = pixels.shape[1] - 1
            pixels, (a, c, d, f) = pixels[:, ::-1], (-a, c + a * last, -d, f + d * last)
            ce, cn = -ce, -cn
        if rn > 0:
            last = pixels.shape[0] - 1
            pixels, (b, c, e, f) = pixels[::-1], (-b, c + b * last, -e, f + e * last)
            re, rn = -re, -rn
        steps = ((ce, cn), (re, rn))
        return np.ascontiguousarray(pixels), replace(found, affine=(a, b, c, d, e, f), steps=steps)

    def coordinates(self, column: float, row: float) -> tuple[float, float]:
        """Return the coordinates of a place between pixels."""
        a, b, c, d, e, f = self.affine
        return a * column + b * row + c, d * column + e * row + f


def middle_of_pixels(corner: Affine) -> Affine:
    """Return the affine map of pixels' middles from that of their upper-left corners, as GDAL gives it."""
    a, b, c, d, e, f = corner
    return a, b, c + (a + b) / 2, d, e, f + (d + e) / 2


def matrix(affine: Affine) -> FloatArray:
    """Return the (3, 3) matrix of an affine map."""
    return np.array((affine[:3], affine[3:], (0.0, 0.0, 1.0)))
