"""Coordinate systems of elevation data, georeferences of rasters, places of worlds on the earth.

Projected coordinates are converted by PROJ, without network.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lirs_wct.arrays import FloatArray
from lirs_wct.errors import ConfigError

if TYPE_CHECKING:
    from pyproj import CRS, Transformer

WGS84 = (6378137.0, 298.257223563)
"""Semi-major axis, meters, and inverse flattening."""
MERCATOR = (3857, 900913, 3785, 102113, 102100)
GEOGRAPHIC = (4326, 4269, 4258, 4979, 4283, 7844, 6318, 4937, 9754)
"""Latitude and longitude on datums that agree with WGS 84 to about a meter."""
Form = Literal["geographic", "other", "unknown"]


class OutsideSystemError(ConfigError):
    """Coordinates for which a coordinate system has no latitudes and longitudes."""


@dataclass(frozen=True)
class CoordinateSystem:
    """A coordinate reference system.

    Attributes:
        name: `EPSG:code`, WKT of one without a code, or empty where none is known.
        form: `other` is converted by PROJ, `unknown` cannot be converted.
        unit: meters in a unit of projected coordinates.
        ellipsoid: semi-major axis in meters and inverse flattening (0 = sphere) of geographic coordinates.
    """

    name: str = ""
    form: Form = "unknown"
    unit: float = 1.0
    ellipsoid: tuple[float, float] = WGS84

    @staticmethod
    def of_code(code: int, unit: float = 1.0) -> CoordinateSystem:
        """Return the system of an EPSG code."""
        form: Form = "geographic" if code in GEOGRAPHIC else "other"
        return CoordinateSystem(f"EPSG:{code}", form, unit)

    @property
    def label(self) -> str:
        """Short name of the system for messages."""
        if "[" in self.name:
            return self.name.split('"')[1]
        if self.name or self.form != "geographic":
            return self.name
        return f"degrees, radius {self.ellipsoid[0] / 1000:.6g} km"

    def to_geographic(self, x: ArrayLike, y: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return latitudes and longitudes of coordinates, degrees."""
        px, py = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
        if self.form == "geographic":
            return py, px
        if self.form == "unknown":
            raise ConfigError("no coordinate reference system is known")
        _require_proj()
        from pyproj.exceptions import ProjError  # imported here to keep the start of other commands fast

        try:
            longitude, latitude = _transformer(self.name).transform(px, py)
        except ProjError as error:
            raise ConfigError(f"PROJ knows no latitudes and longitudes of {self.label}") from error
        if not (np.isfinite(latitude).all() and np.isfinite(longitude).all()):
            raise OutsideSystemError(f"PROJ knows no latitudes and longitudes of {self.label} there")
        return np.asarray(latitude), np.asarray(longitude)

    def ground_meters(self, x: float, y: float) -> FloatArray:
        """Return (2, 2) ground meters (rows east, north) per unit of x and y."""
        step = 1e-4 if self.form == "geographic" else 10.0 / self.unit
        at = np.array(((x + step, y), (x - step, y), (x, y + step), (x, y - step), (x, y)))
        latitude, longitude = self.to_geographic(at[:, 0], at[:, 1])
        if not (np.isfinite(latitude).all() and abs(latitude[4]) < 90):
            raise ConfigError(f"center lies at latitude {latitude[4]:g}, degrees have no width there")
        per_degree = meters_per_degree(float(latitude[4]), self.ellipsoid)
        degrees_east = (longitude[[0, 2]] - longitude[[1, 3]] + 180) % 360 - 180
        degrees_north = latitude[[0, 2]] - latitude[[1, 3]]
        meters: FloatArray = np.stack((degrees_east * per_degree[0], degrees_north * per_degree[1]))
        return meters / (2 * step)


def meters_per_degree(latitude: float, ellipsoid: tuple[float, float] = WGS84) -> tuple[float, float]:
    """Return meters in a degree eastward and northward on an ellipsoid.

    Radii of curvature in the prime vertical and the meridian: Snyder 1987, eqs. 4-20 and 4-19.
    """
    a, inverse = ellipsoid
    f = 1 / inverse if inverse else 0.0
    e2, phi = f * (2 - f), math.radians(latitude)
    w = math.sqrt(1 - e2 * math.sin(phi) ** 2)
    return math.radians(a / w * math.cos(phi)), math.radians(a * (1 - e2) / w**3)


def _require_proj() -> None:
    """Raise an error without PROJ."""
    if find_spec("pyproj") is None:
        raise ConfigError("coordinate systems need the package pyproj: pip install 'lirs-wct[dem]'")


@lru_cache(maxsize=64)
def _transformer(name: str) -> Transformer:
    """Return PROJ's conversion of a system to WGS 84."""
    from pyproj import CRS, Transformer, network

    network.set_network_enabled(active=False)
    code = int(name.removeprefix("EPSG:")) if name.startswith("EPSG:") else None
    if code in MERCATOR:
        code = MERCATOR[0]
    crs = CRS.from_wkt(name) if code is None else CRS.from_epsg(code)
    return Transformer.from_crs(crs, CRS.from_epsg(4326), always_xy=True)


def system_of_wkt(text: str) -> tuple[CoordinateSystem, float | None]:
    """Return the coordinate system of a WKT text, and its meters per unit of height."""
    _require_proj()
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    text = text.strip("\0 \n")
    try:
        crs = CRS.from_wkt(text)
    except CRSError:
        return CoordinateSystem(text, "other"), None
    plane, *vertical = crs.sub_crs_list if crs.is_compound else [crs]
    if plane.is_bound and plane.source_crs is not None:
        plane = plane.source_crs
    unit = 1.0 if plane.is_geographic else _unit(plane)
    height_unit = _unit(vertical[0]) if vertical else None
    if len(plane.axis_info) > 2:
        height_unit = float(plane.axis_info[2].unit_conversion_factor)
    code = plane.to_epsg()
    if code is not None:
        return CoordinateSystem.of_code(code, unit), height_unit
    geod = plane.get_geod()
    if plane.is_geographic and geod is not None:
        ellipsoid = geod.a, 1 / geod.f if geod.f else 0.0
        return CoordinateSystem(plane.to_wkt(), "geographic", unit, ellipsoid), height_unit
    if geod is None:
        return CoordinateSystem("", "unknown", unit), height_unit  # a local system
    return CoordinateSystem(plane.to_wkt(), "other", unit), height_unit


def _unit(crs: CRS) -> float:
    """Return meters in the unit of a system's first axis."""
    return float(crs.axis_info[0].unit_conversion_factor) if crs.axis_info else 1.0


Affine = tuple[float, float, float, float, float, float]
"""a, b, c, d, e, f of x = a u + b v + c, y = d u + e v + f."""
TURNED = 1e-4
"""Largest ignored sine of a raster's turn, or cosine between its rows and columns."""


@dataclass(frozen=True, slots=True)
class Georeference:
    """Coordinates and ground meters of a raster's pixels.

    Attributes:
        system: Coordinate reference system.
        affine: map from column and row of a pixel's middle (whole numbers) to coordinates.
        steps: meters eastward and northward on the ground, at the raster's middle, from one column to the
            next, and from one row to the next: ((east, north), (east, north)).
    """

    system: CoordinateSystem
    affine: Affine
    steps: tuple[tuple[float, float], tuple[float, float]]

    @staticmethod
    def of(system: CoordinateSystem, affine: Affine, shape: tuple[int, int]) -> Georeference:
        """Return the georeference of a raster of (rows, cols) pixels."""
        a, b, c, d, e, f = affine
        u, v = (shape[1] - 1) / 2, (shape[0] - 1) / 2
        ground = system.ground_meters(a * u + b * v + c, d * u + e * v + f)
        column, row = (ground @ np.array(((a, b), (d, e)))).T.tolist()
        return Georeference(system, affine, (tuple(column), tuple(row)))

    @staticmethod
    def on_grid(system: CoordinateSystem, affine: Affine) -> Georeference:
        """Return the georeference of a raster; its units are treated as ground meters."""
        a, b, _, d, e, _ = (value * system.unit for value in affine)
        return Georeference(system, affine, ((a, d), (b, e)))

    @property
    def pixel(self) -> tuple[float, float]:
        """Ground meters from column to column, and from row to row."""
        return math.hypot(*self.steps[0]), math.hypot(*self.steps[1])

    @property
    def heading(self) -> float:
        """Direction of increasing column, degrees north of east."""
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
        """Transpose and flip pixels so that columns run closest to east, rows closest to south.

        Pixels are only reordered, not resampled. Returns them with their georeference.
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
    """Convert GDAL's affine map of upper-left pixel corners to that of pixel middles."""
    a, b, c, d, e, f = corner
    return a, b, c + (a + b) / 2, d, e, f + (d + e) / 2


@dataclass(frozen=True, slots=True)
class Place:
    """The place of the world's frame on the earth.

    Attributes:
        system: Coordinate reference system.
        affine: map from x and y of the world, meters, to coordinates.
        height: Height of z = 0 above the datum, meters; None where heights are not the file's own.
    """

    system: CoordinateSystem
    affine: Affine
    height: float | None = None

    def coordinates(self, x: ArrayLike, y: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the coordinates of points of the world, in the place's system."""
        px, py = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
        a, b, c, d, e, f = self.affine
        return a * px + b * py + c, d * px + e * py + f

    def to_geographic(self, x: ArrayLike, y: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return latitudes and longitudes of points of the world, degrees."""
        return self.system.to_geographic(*self.coordinates(x, y))

    def heading(self) -> float:
        """Return the direction of the world's x axis at its origin, degrees north of east."""
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
        """Return the place of a world whose z = 0 lies some meters higher."""
        return self if self.height is None else replace(self, height=self.height + meters)
