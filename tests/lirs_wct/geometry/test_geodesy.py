"""Lengths of degrees on ellipsoids, against differences of points and published values."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from lirs_wct.geometry.geodesy import meters_per_degree


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
