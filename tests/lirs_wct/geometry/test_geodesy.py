"""Lengths of degrees on ellipsoids, against differences of points and published values."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from lirs_wct.errors import ConfigError
from lirs_wct.geometry.geodesy import CoordinateSystem, meters_per_degree


def degree(latitude: float, a: float, inverse: float) -> tuple[float, float]:
    """Return meters in a degree east and north, by differences of points on the ellipsoid."""
    b = a * (1 - 1 / inverse) if inverse else a

    def at(angle: float) -> np.ndarray:
        beta = math.atan2(b * math.sin(angle), a * math.cos(angle))  # parametric latitude
        return np.array((a * math.cos(beta), b * math.sin(beta)))

    phi, small = math.radians(latitude), 1e-6
    north = float(np.linalg.norm(at(phi + small) - at(phi - small))) / (2 * small)
    return math.radians(float(at(phi)[0])), math.radians(north)


@given(
    st.floats(-85, 85),
    st.sampled_from(((6378137.0, 298.257223563), (6377397.155, 299.1528128), (6371000.0, 0.0))),
)
def test_meters_in_a_degree_on_any_ellipsoid(latitude: float, ellipsoid: tuple[float, float]) -> None:
    a, inverse = ellipsoid
    found = meters_per_degree(latitude, ellipsoid)
    assert found == pytest.approx(degree(latitude, a, inverse), rel=1e-6)
    if a == 6378137.0:
        assert meters_per_degree(latitude) == found


def test_meters_in_a_degree_as_published() -> None:
    """WGS 84 (NGA's calculator): 111,319.5 and 110,574.3 m at the equator, 78,846.8 and 111,131.7 at 45."""
    assert meters_per_degree(0.0) == pytest.approx((111319.49, 110574.28), abs=0.05)
    assert meters_per_degree(45.0) == pytest.approx((78846.81, 111131.75), abs=0.05)
    assert 0 < meters_per_degree(89.999999)[0] < 0.01
    assert meters_per_degree(-45.0) == meters_per_degree(45.0)
    for latitude in (90.0, 91.0, -120.0):
        with pytest.raises(ConfigError, match="degrees have no width there"):
            CoordinateSystem.of_code(4326).ground_meters(7.0, latitude)
