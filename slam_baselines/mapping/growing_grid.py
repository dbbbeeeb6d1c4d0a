"""A lattice of cells that grows where it is needed: maps without fixed bounds."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

BLOCK = 128
"""Bounds are multiples of this number of cells, so that the grid grows seldom."""


class GrowingGrid:
    """Layers of equal shape over one square lattice, cell (0, 0) at the frame's origin.

    Attributes:
        resolution: edge of a cell, meters.
        row0: lattice row (northward) of the arrays' row 0.
        col0: lattice column (eastward) of the arrays' column 0.
        layers: name -> (rows, cols) array; replaced by larger ones when the grid grows.
    """

    def __init__(self, resolution: float, layers: Mapping[str, tuple[DTypeLike, float]]) -> None:
        """Start empty; `layers` gives each layer's type and initial value."""
        self.resolution = resolution
        self.row0 = 0
        self.col0 = 0
        self._held = math.inf, math.inf, -math.inf, -math.inf
        self._fill = dict(layers)
        self.layers: dict[str, NDArray[Any]] = {name: _full((0, 0), spec) for name, spec in layers.items()}

    @property
    def shape(self) -> tuple[int, int]:
        """Rows, columns."""
        rows, cols = next(iter(self.layers.values())).shape
        return rows, cols

    @property
    def nbytes(self) -> int:
        """Memory of all layers."""
        return sum(layer.nbytes for layer in self.layers.values())

    def ensure(self, west: float, south: float, east: float, north: float) -> bool:
        """Extend the grid by a box (meters); return whether the arrays were replaced."""
        held = self._held
        if west >= held[0] and south >= held[1] and east <= held[2] and north <= held[3]:
            return False
        rows, cols = self.shape
        c_lo, c_hi = _blocks(west / self.resolution, east / self.resolution)
        r_lo, r_hi = _blocks(south / self.resolution, north / self.resolution)
        if rows:
            r_lo, r_hi = min(r_lo, self.row0), max(r_hi, self.row0 + rows)
            c_lo, c_hi = min(c_lo, self.col0), max(c_hi, self.col0 + cols)
            if (r_hi - r_lo, c_hi - c_lo) == (rows, cols):
                return False
        at_row, at_col = self.row0 - r_lo, self.col0 - c_lo
        for name, old in self.layers.items():
            new = _full((r_hi - r_lo, c_hi - c_lo), self._fill[name])
            new[at_row : at_row + rows, at_col : at_col + cols] = old
            self.layers[name] = new
        self.row0, self.col0 = r_lo, c_lo
        # A box within these bounds needs no other blocks, by the rounding of _blocks.
        res = self.resolution
        self._held = (c_lo + 1) * res, (r_lo + 1) * res, (c_hi - 2) * res, (r_hi - 2) * res
        return True


def _full(shape: tuple[int, int], spec: tuple[DTypeLike, float]) -> NDArray[Any]:
    """Return a filled layer; zeros cost no memory until they are written."""
    dtype, value = spec
    return np.zeros(shape, dtype) if value == 0 else np.full(shape, value, dtype)


def _blocks(low: float, high: float) -> tuple[int, int]:
    """Round bounds in cells outward to whole blocks, with one cell to spare for interpolation."""
    return int((low - 1) // BLOCK) * BLOCK, int(-((-high - 2) // BLOCK)) * BLOCK
