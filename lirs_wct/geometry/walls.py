"""The walls of a laser map: extruded cells, and their cover by rectangles."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from lirs_wct.arrays import BoolArray, FloatArray, IntArray, njit
from lirs_wct.checks import require_within
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.pose import Pose2


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


def merged_rectangles(mask: BoolArray) -> IntArray:
    """Return (n, 4) disjoint rectangles that cover a mask: row0, col0, row1, col1 (ends exclusive).

    Greedy: at the first uncovered cell, two rectangles grow, one along the row first and one along the column
    first; the larger one is taken. The result is the smaller cover of the mask and its transpose.
    """
    straight = _cover(mask)
    turned = _cover(np.ascontiguousarray(mask.T))[:, [1, 0, 3, 2]]
    return straight if len(straight) <= len(turned) else turned


def _cover(solid: BoolArray) -> IntArray:
    boxes: IntArray = _rectangles(solid.copy())
    return boxes


@njit
def _rectangles(left: BoolArray) -> IntArray:
    """Cover a mask by rectangles in row order; the mask is cleared."""
    rows, cols = left.shape
    boxes = np.empty((max(1, int(left.sum())), 4), np.int64)
    count = 0
    for r in range(rows):
        for c in range(cols):
            if not left[r, c]:
                continue
            wide = _grown(left, r, c, True)
            tall = _grown(left, r, c, False)
            if (wide[0] - r) * (wide[1] - c) >= (tall[0] - r) * (tall[1] - c):
                r1, c1 = wide
            else:
                r1, c1 = tall
            left[r:r1, c:c1] = False
            boxes[count, 0], boxes[count, 1], boxes[count, 2], boxes[count, 3] = r, c, r1, c1
            count += 1
    return boxes[:count].copy()


@njit
def _grown(left: BoolArray, r: int, c: int, along_row: bool) -> tuple[int, int]:
    """Return the far corner of a rectangle grown from (r, c)."""
    r1, c1 = r + 1, c + 1
    for axis in range(2):
        if (axis == 0) == along_row:
            while c1 < left.shape[1] and _all(left, r, c1, r1, c1 + 1):
                c1 += 1
        else:
            while r1 < left.shape[0] and _all(left, r1, c, r1 + 1, c1):
                r1 += 1
    return r1, c1


@njit
def _all(left: BoolArray, r0: int, c0: int, r1: int, c1: int) -> bool:
    """Whether all cells of a rectangle are uncovered; faster than `all` of a slice."""
    for r in range(r0, r1):
        for c in range(c0, c1):
            if not left[r, c]:
                return False
    return True
