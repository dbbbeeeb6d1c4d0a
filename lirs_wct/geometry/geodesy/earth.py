"""Coordinate reference systems of elevation data: latitude, longitude and ground meters of coordinates.

Known here are geographic coordinates, web Mercator (EPSG:3857) and UTM; of any other system PROJ knows more,
through rasterio (the extra `geo`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from lirs_wct.arrays import FloatArray
from lirs_wct.errors import ConfigError

WGS84 = (6378137.0, 298.257223563)
"""Semi-major axis, meters, and inverse flattening."""
MERCATOR = (3857, 900913, 3785, 102113, 102100)
GEOGRAPHIC = (4326, 4269, 4258, 4979, 4283, 7844, 6318, 4937, 9754)
"""Latitude and longitude on datums that agree with WGS 84 to about a meter."""
_UTM = {32600: 1, 32700: -1, 26900: 1, 25800: 1, 28300: -1, 7800: -1, 6329: 1}
"""EPSG code of zone 0 -> hemisphere: WGS 84 N and S, NAD 83, ETRS 89, GDA 94, GDA 2020, NAD 83 (2011)."""
_SCALE, _EAST, _SOUTH = 0.9996, 500e3, 10_000e3
"""UTM's scale on the central meridian, false easting, and false northing of the southern hemisphere."""

Form = Literal["geographic", "mercator", "utm", "other", "unknown"]


@dataclass(frozen=True)
class CoordinateSystem:
    """A coordinate reference system.

    Attributes:
        name: `EPSG:code`, WKT of one without a code, or empty where none is known.
        form: how it is computed; `other` by PROJ, `unknown` not at all.
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
        form: Form = "other"
        if code in MERCATOR:
            form = "mercator"
        elif code in GEOGRAPHIC:
            form = "geographic"
        elif _utm_zone(code) is not None:
            form = "utm"
        return CoordinateSystem(f"EPSG:{code}", form, unit)

    @property
    def label(self) -> str:
        """What to call it in a line of text."""
        if "[" in self.name:
            return self.name.split('"')[1]
        if self.name or self.form != "geographic":
            return self.name
        return f"degrees, radius {self.ellipsoid[0] / 1000:.6g} km"

    @cached_property
    def _code(self) -> int:
        return int(self.name.removeprefix("EPSG:"))

    def to_geographic(self, x: ArrayLike, y: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return latitudes and longitudes of coordinates, degrees.

        Raises:
            ConfigError: the system is unknown, or PROJ is needed and not there.
        """
        px, py = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
        if self.form == "geographic":
            return py, px
        if self.form == "mercator":
            return _mercator_inverse(px * self.unit, py * self.unit)
        if self.form == "utm":
            zone, hemisphere = _utm_zone(self._code) or (0, 1)
            return _utm_inverse(px * self.unit, py * self.unit, zone, hemisphere)
        if self.form == "other":
            return _by_proj(self.name, self.label, px, py)
        raise ConfigError("no coordinate reference system is known")

    def ground_meters(self, x: float, y: float) -> FloatArray:
        """Return (2, 2) meters eastward and northward on the ground per unit of x and of y, at a place.

        Raises:
            ConfigError: as `to_geographic`, or the place is a pole or beyond.
        """
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

    Args:
        latitude: degrees.
        ellipsoid: semi-major axis, meters, and inverse flattening; 0 = sphere.
    """
    a, inverse = ellipsoid
    f = 1 / inverse if inverse else 0.0
    e2, phi = f * (2 - f), math.radians(latitude)
    w = math.sqrt(1 - e2 * math.sin(phi) ** 2)
    return math.radians(a / w * math.cos(phi)), math.radians(a * (1 - e2) / w**3)


def _mercator_inverse(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return latitudes and longitudes of web Mercator's meters: Snyder 1987, eqs. 7-4 and 7-5."""
    a = WGS84[0]
    return np.degrees(np.pi / 2 - 2 * np.arctan(np.exp(-y / a))), np.degrees(x / a)


def _utm_zone(code: int) -> tuple[int, int] | None:
    """Return zone and hemisphere (1 = north) of an EPSG code; None where it is none of UTM."""
    for base, hemisphere in _UTM.items():
        if 1 <= code - base <= 60 and (base != 6329 or code <= 6348):
            return code - base, hemisphere
    return None


def _utm_inverse(x: FloatArray, y: FloatArray, zone: int, hemisphere: int) -> tuple[FloatArray, FloatArray]:
    """Return latitudes and longitudes of UTM's meters: Karney 2011, eqs. 11, 15, 25 and 36, to n^4."""
    a, f = WGS84[0], 1 / WGS84[1]
    n, e = f / (2 - f), math.sqrt(f * (2 - f))
    radius = a / (1 + n) * (1 + n**2 / 4 + n**4 / 64) * _SCALE
    xi, eta = (y - (0 if hemisphere > 0 else _SOUTH)) / radius, (x - _EAST) / radius
    beta = (
        n / 2 - 2 * n**2 / 3 + 37 * n**3 / 96 - n**4 / 360,
        n**2 / 48 + n**3 / 15 - 437 * n**4 / 1440,
        17 * n**3 / 480 - 37 * n**4 / 840,
        4397 * n**4 / 161280,
    )
    zeta = xi + 1j * eta
    zeta = zeta - sum(b * np.sin(2 * (j + 1) * zeta) for j, b in enumerate(beta))
    conformal = np.sin(zeta.real) / np.hypot(np.sinh(zeta.imag), np.cos(zeta.real))
    tau = conformal.copy()
    for _ in range(4):  # Newton's method, eqs. 19 to 21
        sigma = np.sinh(e * np.arctanh(e * tau / np.hypot(1, tau)))
        found = tau * np.hypot(1, sigma) - sigma * np.hypot(1, tau)
        slope = (1 + (1 - e**2) * tau**2) / ((1 - e**2) * np.hypot(1, found) * np.hypot(1, tau))
        tau = tau + (conformal - found) * slope
    longitude = np.degrees(np.arctan2(np.sinh(zeta.imag), np.cos(zeta.real))) + 6 * zone - 183
    return np.degrees(np.arctan(tau)), longitude


def _by_proj(name: str, label: str, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    try:
        import rasterio.crs
        import rasterio.warp
    except ModuleNotFoundError:
        raise ConfigError(f"{label} is not known without rasterio: pip install 'lirs-wct[geo]'") from None
    try:
        known, wgs84 = rasterio.crs.CRS.from_user_input(name), rasterio.crs.CRS.from_epsg(4326)
        found = rasterio.warp.transform(known, wgs84, x.ravel(), y.ravel())
    except Exception as error:  # rasterio passes on errors of GDAL of many kinds
        raise ConfigError(f"PROJ knows no latitudes and longitudes of {label}") from error
    longitude, latitude = (np.reshape(values, x.shape) for values in found[:2])
    return latitude, longitude
