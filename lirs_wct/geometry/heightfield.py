"""The height field, a picture as a surface in meters, and its resampling."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeVar

import cv2
import numpy as np
import scipy  # its modules load on first use
from numpy.typing import ArrayLike, NDArray

from lirs_wct.arrays import BoolArray, Float32Array, FloatArray
from lirs_wct.display import ShownAsPicture
from lirs_wct.errors import ConfigError


@dataclass(frozen=True, slots=True)
class HeightField(ShownAsPicture):
    """Heights on a regular grid; each cell is two triangles.

    A cell splits along the diagonal from its south-west to its north-east node, as MuJoCo's does.

    Attributes:
        z: (rows, cols) float32 meters, row 0 = north edge as in the picture, column 0 = west.
        cell: spacing of the nodes eastward and northward, meters.
        origin: x, y of the south-west node in the world frame, meters.

    Raises:
        ConfigError: fewer than 2x2 nodes, a height that is not finite, or a spacing not above 0.
    """

    z: Float32Array
    cell: tuple[float, float]
    origin: tuple[float, float]

    def __post_init__(self) -> None:
        if self.z.ndim != 2 or min(self.z.shape) < 2 or self.z.dtype != np.float32:
            raise ConfigError(
                f"a height field needs at least 2x2 float32 heights, got {self.z.dtype} {self.z.shape}"
            )
        if not (self.cell[0] > 0 and self.cell[1] > 0):
            raise ConfigError(f"cell of a height field must be above 0 m, got {self.cell}")
        if not np.isfinite(self.z).all():
            raise ConfigError("heights of a height field must be finite")

    def __repr__(self) -> str:
        (rows, cols), (width, depth) = self.shape, self.size
        nodes = f"{rows} x {cols} nodes"
        return f"HeightField({nodes}, {width:.4g} m x {depth:.4g} m, relief {self.relief:.4g} m)"

    @staticmethod
    def centered(z: Float32Array, cell: tuple[float, float]) -> HeightField:
        """Build with the picture's center at the world's origin."""
        rows, cols = z.shape
        return HeightField(z, cell, (-(cols - 1) * cell[0] / 2, -(rows - 1) * cell[1] / 2))

    @property
    def shape(self) -> tuple[int, int]:
        """Rows, columns of nodes."""
        return self.z.shape[0], self.z.shape[1]

    @property
    def size(self) -> tuple[float, float]:
        """Extent eastward and northward, meters."""
        rows, cols = self.z.shape
        return (cols - 1) * self.cell[0], (rows - 1) * self.cell[1]

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """West, south, east, north, meters."""
        (x, y), (w, h) = self.origin, self.size
        return x, y, x + w, y + h

    @property
    def relief(self) -> float:
        """Highest minus lowest height, meters."""
        return float(self.z.max() - self.z.min())

    @property
    def south_up(self) -> Float32Array:
        """(rows, cols) heights with row 0 = south; only this property flips the y axis."""
        return np.ascontiguousarray(self.z[::-1])

    def contains(self, x: ArrayLike, y: ArrayLike) -> BoolArray:
        """Whether points lie on the field, border included."""
        w, s, e, n = self.bounds
        px, py = np.asarray(x), np.asarray(y)
        inside: BoolArray = (px >= w) & (px <= e) & (py >= s) & (py <= n)
        return inside

    def height_at(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """Return the surface height at points (broadcast), meters; NaN off the field.

        Linear on each triangle, so equal to the mesh of the full grid.
        """
        rows, cols = self.z.shape
        px, py = np.broadcast_arrays(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))
        inside = self.contains(px, py)
        u = np.where(inside, (px - self.origin[0]) / self.cell[0], 0.0)
        v = np.where(inside, (py - self.origin[1]) / self.cell[1], 0.0)
        i = np.clip(u.astype(np.int64), 0, cols - 2)
        j = np.clip(v.astype(np.int64), 0, rows - 2)
        u, v = u - i, v - j
        south, north = rows - 1 - j, rows - 2 - j
        sw, se = self.z[south, i].astype(np.float64), self.z[south, i + 1].astype(np.float64)
        nw, ne = self.z[north, i].astype(np.float64), self.z[north, i + 1].astype(np.float64)
        below = sw + u * (se - sw) + v * (ne - se)
        above = sw + u * (ne - nw) + v * (nw - sw)
        return np.where(inside, np.where(u >= v, below, above), np.nan)

    def slope(self) -> FloatArray:
        """Return (rows, cols) the steepest angle at each node, radians (central differences)."""
        dz_dy, dz_dx = np.gradient(self.z.astype(np.float64), self.cell[1], self.cell[0])
        angle: FloatArray = np.arctan(np.hypot(dz_dx, dz_dy))
        return angle


Number = TypeVar("Number", bound=np.floating[Any])
STRIP = 512
"""Rows of nodes that are sampled together; all at once would take several times the memory."""


def resample(values: Float32Array, width: int, height: int) -> Float32Array:
    """Resample values on another grid over the same ground; corner nodes stay corner nodes.

    Before shrinking, a Gaussian blur removes detail finer than the new grid (no aliasing).
    """
    rows, cols = values.shape
    shrink_x, shrink_y = (cols - 1) / (width - 1), (rows - 1) / (height - 1)
    if max(shrink_x, shrink_y) > 1:
        sigma_x, sigma_y = (max(0.5 * (s - 1), 1e-3) for s in (shrink_x, shrink_y))
        values = np.asarray(
            cv2.GaussianBlur(values, (0, 0), sigma_x, sigmaY=sigma_y, borderType=cv2.BORDER_REPLICATE),
            dtype=np.float32,
        )
    # One axis after the other: the maps stay small whatever the size.
    return _sample_columns(_sample_columns(values, width).T, height).T.copy()


def fewer_nodes(surface: HeightField, most: int) -> HeightField:
    """Return a surface on the same ground with at most `most` nodes along each side."""
    rows, cols = (min(n, most) for n in surface.shape)
    width, depth = surface.size
    z = resample(surface.z, cols, rows)
    return HeightField(z, (width / (cols - 1), depth / (rows - 1)), surface.origin)


def sample_surface(
    surface: HeightField, bounds: tuple[float, float, float, float], shape: tuple[int, int]
) -> HeightField:
    """Return a surface within bounds on nodes of its own, exact at each node."""
    (west, south, east, north), (rows, cols) = bounds, shape
    x, y = np.linspace(west, east, cols), np.linspace(north, south, rows)
    x, y = np.clip(x, west, east), np.clip(y, south, north)
    z = np.empty(shape, np.float32)
    for start in range(0, rows, STRIP):
        part = slice(start, start + STRIP)
        z[part] = surface.height_at(x[None, :], y[part, None])
    return HeightField(z, ((east - west) / (cols - 1), (north - south) / (rows - 1)), (west, south))


def _sample_columns(values: Float32Array, n: int) -> Float32Array:
    """Return (rows, n) values, interpolated linearly at n equidistant columns."""
    at = np.linspace(0, values.shape[1] - 1, n)
    left = np.minimum(at.astype(np.int64), values.shape[1] - 2)
    share = (at - left).astype(np.float32)
    out: Float32Array = values[:, left] * (1 - share) + values[:, left + 1] * share
    return out


def nearest_values(values: NDArray[Number], missing: BoolArray) -> NDArray[Number]:
    """Return a grid whose missing values are those of the nearest node."""
    nearest = scipy.ndimage.distance_transform_edt(missing, return_distances=False, return_indices=True)
    filled: NDArray[Number] = values[tuple(nearest)]
    return filled
