"""Grids: heights of the ground, occupancy as log-odds, walls of a laser map."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import cv2
import numpy as np
import scipy  # its modules load on first use
from numpy.typing import ArrayLike, NDArray

from lirs_wct.arrays import BoolArray, Float32Array, FloatArray, IntArray
from lirs_wct.display import ShownAsPicture
from lirs_wct.errors import ConfigError, require_within
from lirs_wct.geometry.pose import Pose2


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


OCCUPIED = 0.65
"""A cell is occupied where its probability exceeds this (ROS map_saver's `occupied_thresh`)."""
FREE = 0.25
"""A cell is free where its probability is below this (ROS map_saver's `free_thresh`)."""
_FREE_LOG_ODDS = math.log(FREE / (1 - FREE))


@dataclass(frozen=True, slots=True)
class OccupancyGrid(ShownAsPicture):
    """Cells of a plane with their log-odds of occupancy; unknown is a separate state.

    Attributes:
        log_odds: (rows, cols) float32, row 0 = south (ROS order), NaN = unknown.
        resolution: edge of a cell, meters.
        origin: `T_frame_grid`: pose of the outer corner of cell (0, 0), as in a ROS map YAML.

    Raises:
        ConfigError: resolution is not positive or the array has the wrong shape or type.
    """

    log_odds: Float32Array
    resolution: float
    origin: Pose2 = field(default_factory=Pose2)

    def __post_init__(self) -> None:
        require_within(self, "(0, inf]", "resolution", unit="m")
        if self.log_odds.ndim != 2 or self.log_odds.dtype != np.float32:
            raise ConfigError(
                f"log_odds must be a float32 matrix, got {self.log_odds.dtype} {self.log_odds.shape}"
            )

    def __repr__(self) -> str:
        rows, cols = self.shape
        return (
            f"OccupancyGrid({rows} x {cols} cells of {self.resolution:g} m, {self.known.mean():.0%} known, "
            f"{self.occupied.sum()} occupied)"
        )

    @staticmethod
    def from_probability(p: ArrayLike, resolution: float, origin: Pose2 | None = None) -> OccupancyGrid:
        """Build from probabilities (rows, cols), clipped; row 0 = south, NaN = unknown."""
        q = np.clip(np.asarray(p, dtype=np.float64), 1e-6, 1 - 1e-6)
        np.divide(q, 1 - q, out=q)
        return OccupancyGrid(np.log(q, out=q).astype(np.float32), resolution, origin or Pose2())

    @staticmethod
    def from_mask(occupied: BoolArray, resolution: float, origin: Pose2 | None = None) -> OccupancyGrid:
        """Build from a mask (rows, cols) of occupied cells; the others are free."""
        free, wall = OccupancyGrid.from_probability(((0.0, 1.0),), resolution).log_odds[0]
        return OccupancyGrid(np.where(occupied, wall, free), resolution, origin or Pose2())

    @staticmethod
    def of_lattice(log_odds: Float32Array, resolution: float, row0: float, col0: float) -> OccupancyGrid:
        """Build from the known cells of log-odds; cell (0, 0) has a lattice's row, column."""
        known = ~np.isnan(log_odds)
        rows, cols = (np.flatnonzero(known.any(axis=axis)) for axis in (1, 0))
        if len(rows) == 0:
            return OccupancyGrid(np.full((1, 1), np.nan, np.float32), resolution)
        corner = Pose2(float((col0 + cols[0]) * resolution), float((row0 + rows[0]) * resolution))
        box = log_odds[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
        return OccupancyGrid(box.copy(), resolution, corner)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows (northward), columns (eastward)."""
        return self.log_odds.shape[0], self.log_odds.shape[1]

    @property
    def probability(self) -> Float32Array:
        """(rows, cols) probability of being occupied, NaN = unknown."""
        # Computed in place: with millions of cells, a further array costs more than the arithmetic.
        p = np.negative(self.log_odds)
        with np.errstate(over="ignore"):  # Beyond float32, the probability is 0.
            np.exp(p, out=p)
        p += 1
        return np.divide(1, p, out=p)

    @property
    def known(self) -> BoolArray:
        """(rows, cols) cells that are not unknown."""
        return ~np.isnan(self.log_odds)

    @property
    def occupied(self) -> BoolArray:
        """(rows, cols) known cells with p > 0.65."""
        return self.probability > OCCUPIED

    @property
    def free(self) -> BoolArray:
        """(rows, cols) known cells with p < 0.25."""
        return self.probability < FREE

    def free_at(self, x: float, y: float) -> bool:
        """Whether the cell of a point is free; False outside the grid."""
        row, col = self.cells((x, y)).tolist()
        inside = 0 <= row < self.shape[0] and 0 <= col < self.shape[1]
        # An unknown cell is NaN; comparisons with NaN are False.
        return bool(inside and self.log_odds[row, col] < _FREE_LOG_ODDS)

    def cells(self, points: ArrayLike) -> IntArray:
        """Return (..., 2) row and column of points (..., 2), also outside the grid."""
        local = self.origin.inverse().apply(points)
        return np.floor(local[..., ::-1] / self.resolution).astype(np.int64)

    def centers(self, cells: ArrayLike) -> FloatArray:
        """Return (..., 2) centers of cells (..., 2) given as row, column."""
        rc = np.asarray(cells, dtype=np.float64)
        return self.origin.apply((rc[..., ::-1] + 0.5) * self.resolution)

    def occupied_points(self) -> FloatArray:
        """Return (n, 2) centers of the occupied cells."""
        return self.centers(np.argwhere(self.occupied))

    def moved(self, T_new_frame: Pose2) -> OccupancyGrid:
        """Return the same cells expressed in another frame."""
        return replace(self, origin=T_new_frame @ self.origin)


def mask_at(mask: BoolArray, resolution: float, origin: Pose2, points: ArrayLike) -> BoolArray:
    """Return the values (...) of a grid's mask at points (..., 2); False outside."""
    local = np.floor(origin.inverse().apply(points) / resolution).astype(np.int64)
    col, row = local[..., 0], local[..., 1]
    inside = (row >= 0) & (row < mask.shape[0]) & (col >= 0) & (col < mask.shape[1])
    found: BoolArray = inside & mask[np.where(inside, row, 0), np.where(inside, col, 0)]
    return found


@dataclass(frozen=True, slots=True)
class WallGrid:
    """Cells of a laser map: wall above z = 0, floor, or hole.

    Attributes:
        solid: (rows, cols) bool, row 0 = south (ROS order).
        resolution: edge of a cell, meters.
        origin: `T_world_grid`: pose of the outer corner of cell (0, 0), from the map's YAML.
        height: meters.
        hole: (rows, cols) bool, cells without wall and without floor; None = the floor is whole.

    Raises:
        ConfigError: an array is not a bool matrix of the one shape, a cell is wall and hole, no floor or
            wall is left, or resolution or height is not above 0.
    """

    solid: BoolArray
    resolution: float
    origin: Pose2 = field(default_factory=Pose2)
    height: float = 1.0
    hole: BoolArray | None = None

    def __post_init__(self) -> None:
        if self.solid.ndim != 2 or self.solid.dtype != np.bool_:
            raise ConfigError(f"walls must be a bool matrix, got {self.solid.dtype} {self.solid.shape}")
        require_within(self, "(0, inf]", "resolution", unit="m")
        require_within(self, "(0, inf]", "height", of="the walls", unit="m")
        if self.hole is None:
            return
        if self.hole.shape != self.solid.shape or self.hole.dtype != np.bool_:
            raise ConfigError(
                f"holes must be a bool matrix {self.solid.shape}, got {self.hole.dtype} {self.hole.shape}"
            )
        if (self.hole & self.solid).any():
            raise ConfigError("a cell cannot be both wall and hole")
        if self.hole.all():
            raise ConfigError("every cell is a hole: no floor and no wall is left")

    @property
    def shape(self) -> tuple[int, int]:
        """Rows (northward), columns (eastward)."""
        return self.solid.shape[0], self.solid.shape[1]

    @property
    def floor(self) -> BoolArray:
        """(rows, cols) bool, the cells that are neither wall nor hole."""
        return ~self.solid if self.hole is None else ~(self.solid | self.hole)

    def enclose(self) -> WallGrid:
        """Return the walls with wall cells around the grid, if its border is open."""
        if all(side.all() for side in (self.solid[0], self.solid[-1], self.solid[:, 0], self.solid[:, -1])):
            return self
        x, y = self.origin.apply((-self.resolution, -self.resolution)).tolist()
        return replace(
            self,
            solid=np.pad(self.solid, 1, constant_values=True),
            hole=None if self.hole is None else np.pad(self.hole, 1),
            origin=Pose2(x, y, self.origin.yaw),
        )

    @property
    def corners(self) -> FloatArray:
        """(4, 2) outer corners in the world frame, counter-clockwise from cell (0, 0)."""
        h, w = self.solid.shape[0] * self.resolution, self.solid.shape[1] * self.resolution
        return self.origin.apply(((0.0, 0.0), (w, 0.0), (w, h), (0.0, h)))
