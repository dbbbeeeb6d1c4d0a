"""The walls of a laser map: cells extruded from the floor."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from lirs_wct.arrays import BoolArray, FloatArray
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
        """Return the walls with a ring of wall cells around the grid; itself if its border is all wall."""
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
