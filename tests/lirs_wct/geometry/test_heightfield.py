"""Height fields anywhere, with cells that are not square, against their triangles one by one."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from lirs_wct.errors import ConfigError
from lirs_wct.geometry import HeightField

# 3 rows (north first) by 4 columns; 2 m eastward and 5 m northward between nodes.
FIELD = HeightField(np.arange(12, dtype=np.float32).reshape(3, 4) ** 2, (2.0, 5.0), (-7.0, 100.0))


def test_where_it_lies_by_hand() -> None:
    assert FIELD.shape == (3, 4)
    assert FIELD.size == (6.0, 10.0)
    assert FIELD.bounds == (-7.0, 100.0, -1.0, 110.0)
    assert FIELD.relief == 121.0
    assert HeightField(FIELD.z + 9, FIELD.cell, FIELD.origin).relief == 121.0
    assert FIELD.south_up[:, 0].tolist() == [64.0, 16.0, 0.0]
    middle = HeightField.centered(FIELD.z, (2.0, 5.0))
    assert middle.bounds == (-3.0, -5.0, 3.0, 5.0)
    assert middle.cell == (2.0, 5.0)


@pytest.mark.parametrize(
    ("x", "y", "inside"),
    [
        (-7.0, 100.0, True),
        (-1.0, 110.0, True),
        (-7.0, 110.0, True),
        (-7.001, 105.0, False),
        (-0.999, 105.0, False),
        (-4.0, 99.999, False),
        (-4.0, 110.001, False),
    ],
)
def test_the_border_belongs_to_it(x: float, y: float, inside: bool) -> None:
    assert bool(FIELD.contains(x, y)) == inside
    assert math.isnan(float(FIELD.height_at(x, y))) != inside


def height(field: HeightField, x: float, y: float) -> float:
    """Return the height on the triangle that holds a point, by its barycentric coordinates."""
    (cx, cy), (x0, y0), z = field.cell, field.origin, field.z[::-1].astype(float)
    for j, i in np.ndindex(z.shape[0] - 1, z.shape[1] - 1):
        for nodes in (((i, j), (i + 1, j), (i + 1, j + 1)), ((i, j), (i + 1, j + 1), (i, j + 1))):
            corners = np.array([(x0 + c * cx, y0 + r * cy, 1.0) for c, r in nodes])
            weights = np.linalg.solve(corners.T, (x, y, 1.0))
            if (weights >= -1e-9).all():
                return float(weights @ [z[r, c] for c, r in nodes])
    return math.nan


@given(st.integers(0, 2**32 - 1))
def test_heights_are_those_of_the_triangles(seed: int) -> None:
    rng = np.random.default_rng(seed)
    z = rng.normal(0, 3, rng.integers(2, 6, 2)).astype(np.float32)
    field = HeightField(z, tuple(rng.uniform(0.1, 4, 2).tolist()), tuple(rng.uniform(-90, 90, 2).tolist()))
    west, south, east, north = field.bounds
    points = rng.uniform((west, south), (east, north), (12, 2))
    found = field.height_at(points[:, 0], points[:, 1])
    np.testing.assert_allclose(found, [height(field, x, y) for x, y in points.tolist()], atol=1e-6)
    outside = points + rng.choice((-1, 1), (12, 2)) * (east - west, north - south) * 1.01
    assert np.isnan(field.height_at(outside[:, 0], outside[:, 1])).all()


@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(0.1, 5), st.floats(0.1, 5))
def test_the_slope_of_a_plane(east: float, north: float, cx: float, cy: float) -> None:
    z = np.add.outer(north * cy * np.arange(4)[::-1], east * cx * np.arange(5)).astype(np.float32)
    slope = HeightField(z, (cx, cy), (3.0, 4.0)).slope()
    assert slope.shape == (4, 5)
    np.testing.assert_allclose(slope, math.atan(math.hypot(east, north)), atol=1e-4)


@pytest.mark.parametrize(
    ("z", "cell"),
    [
        (np.zeros((1, 2), np.float32), (1.0, 1.0)),
        (np.zeros((2, 1), np.float32), (1.0, 1.0)),
        (np.zeros((2, 2)), (1.0, 1.0)),
        (np.zeros(4, np.float32), (1.0, 1.0)),
        (np.zeros((2, 2, 2), np.float32), (1.0, 1.0)),
        (np.zeros((2, 2), np.float32), (0.0, 1.0)),
        (np.zeros((2, 2), np.float32), (1.0, 0.0)),
        (np.zeros((2, 2), np.float32), (1.0, math.nan)),
        (np.float32([[0, 0], [0, np.inf]]), (1.0, 1.0)),
    ],
)
def test_what_is_none_is_refused(z: np.ndarray, cell: tuple[float, float]) -> None:
    with pytest.raises(ConfigError, match="height"):
        HeightField(z, cell, (0.0, 0.0))
    assert HeightField(np.zeros((2, 2), np.float32), (1e-9, 1e-9), (0.0, 0.0)).shape == (2, 2)
