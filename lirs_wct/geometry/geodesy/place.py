"""Where a world lies on the earth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from lirs_wct.arrays import FloatArray
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.geodesy.earth import CoordinateSystem, meters_per_degree
from lirs_wct.geometry.geodesy.georeference import Affine


@dataclass(frozen=True, slots=True)
class Place:
    """Where the world's frame lies.

    Attributes:
        system: of the coordinates.
        affine: x and y of the world, meters, to coordinates.
        height: of z = 0 above the data's own datum, meters; None where heights are not the file's.
    """

    system: CoordinateSystem
    affine: Affine
    height: float | None = None

    def coordinates(self, x: ArrayLike, y: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the coordinates of points of the world, in the place's own system."""
        px, py = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
        a, b, c, d, e, f = self.affine
        return a * px + b * py + c, d * px + e * py + f

    def to_geographic(self, x: ArrayLike, y: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return latitudes and longitudes of points of the world, degrees.

        Raises:
            ConfigError: the system is unknown, or PROJ is needed and not there.
        """
        return self.system.to_geographic(*self.coordinates(x, y))

    def heading(self) -> float:
        """Return the degrees north of east to which the world's x axis points, at its origin.

        Raises:
            ConfigError: as `to_geographic`.
        """
        latitude, longitude = self.to_geographic(np.array((0.0, 10.0)), np.zeros(2))
        east, north = meters_per_degree(float(latitude[0]))
        along = (float(np.diff(longitude)[0]) + 180) % 360 - 180
        return float(np.degrees(np.arctan2(float(np.diff(latitude)[0]) * north, along * east)))

    def label(self) -> str:
        """Return the system, the world's origin and the height of z = 0, in words."""
        try:
            latitude, longitude = (float(value) for value in self.to_geographic(0.0, 0.0))
            origin = (
                f"{abs(latitude):.6f} {'N' if latitude >= 0 else 'S'} "
                f"{abs(longitude):.6f} {'E' if longitude >= 0 else 'W'}"
            )
        except ConfigError:
            origin = "origin {:.8g}, {:.8g}".format(*map(float, self.coordinates(0.0, 0.0)))
        height = "" if self.height is None else f", z = 0 at {self.height:.2f} m"
        return ", ".join(part for part in (self.system.label, origin) if part) + height

    def raised(self, meters: float) -> Place:
        """Return the place of a world whose z = 0 lies so much higher."""
        return self if self.height is None else replace(self, height=self.height + meters)
