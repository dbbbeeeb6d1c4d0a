"""The walls of a laser map: exact cells that stand upright on the floor."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lirs_wct.errors import ConfigError
from lirs_wct.pose import Pose2


@dataclass(frozen=True, slots=True)
class WallGrid:
    """Cells of a laser map that are wall from the floor at z = 0 up to one height.

    Attributes:
        solid: (rows, cols) bool, row 0 = south (ROS order).
        resolution: edge of a cell, metres.
        origin: `T_world_grid`: pose of the outer corner of cell (0, 0), from the map's YAML.
        height: metres.

    Raises:
        ConfigError: the array is not a bool matrix, or resolution or height is not above 0.
    """

    solid: NDArray[np.bool_]
    resolution: float
    origin: Pose2 = field(default_factory=Pose2)
    height: float = 1.0

    def __post_init__(self) -> None:
        if self.solid.ndim != 2 or self.solid.dtype != np.bool_:
            raise ConfigError(f"walls must be a bool matrix, got {self.solid.dtype} {self.solid.shape}")
        if not self.resolution > 0:
            raise ConfigError(f"resolution must be above 0 m, got {self.resolution}")
        if not self.height > 0:
            raise ConfigError(f"wall height must be above 0 m, got {self.height}")

    @property
    def shape(self) -> tuple[int, int]:
        """Rows (northward), columns (eastward)."""
        return self.solid.shape[0], self.solid.shape[1]

    @property
    def corners(self) -> NDArray[np.float64]:
        """(4, 2) outer corners in the world frame, counter-clockwise from cell (0, 0)."""
        h, w = self.solid.shape[0] * self.resolution, self.solid.shape[1] * self.resolution
        return self.origin.apply(((0.0, 0.0), (w, 0.0), (w, h), (0.0, h)))
