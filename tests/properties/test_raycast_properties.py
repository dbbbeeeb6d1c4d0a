"""What must hold for any field and any ray."""

import numpy as np
from hypothesis import example, given, settings, strategies as st
from hypothesis.extra import numpy as hnp

from lirs_envs.lidar.ray_casting import RayCaster
from lirs_wct.geometry import HeightField
from tests.reference.triangle_rays import triangle_ranges, triangles_of

HEIGHTS = st.floats(-2.0, 2.0, width=32)
"""Also flat, terraced and spiked fields: hypothesis likes 0, 1 and equal values."""
FIELDS = st.builds(
    HeightField,
    hnp.arrays(
        np.float32,
        hnp.array_shapes(min_dims=2, max_dims=2, min_side=2, max_side=20),
        elements=st.one_of(st.sampled_from((0.0, 1.0)), HEIGHTS),
    ),
    st.tuples(st.sampled_from((0.25, 1.0, 0.3)), st.sampled_from((0.25, 1.0, 0.7))),
    st.tuples(st.sampled_from((0.0, -1.3)), st.sampled_from((0.0, 2.1))),
)
COORDINATES = st.one_of(st.sampled_from((0.0, 0.25, 0.5, 1.0)), st.floats(-3.0, 3.0))
POINTS = st.tuples(COORDINATES, COORDINATES, COORDINATES)
SLOPES = st.one_of(st.sampled_from((0.0, 1.0, -1.0, 0.5, 1e-13, -1e-16)), st.floats(-1.0, 1.0))


def normalized(d: tuple[float, float, float]) -> np.ndarray | None:
    length = float(np.linalg.norm(d))
    return np.array(d) / length if length > 1e-3 else None


DIRECTIONS = st.tuples(SLOPES, SLOPES, SLOPES).map(normalized).filter(lambda d: d is not None)


@settings(max_examples=100)
@given(FIELDS, POINTS, DIRECTIONS)
def test_a_hit_lies_on_the_surface(surface: HeightField, point, direction) -> None:
    t = float(RayCaster(surface).cast(point, direction[None])[0])
    assert t >= 0.0
    if np.isfinite(t):
        x, y, z = np.array(point) + t * direction
        west, south, east, north = surface.bounds
        x, y = np.clip(x, west, east), np.clip(y, south, north)
        steepest = 4.0 / min(surface.cell)
        assert abs(z - float(surface.height_at(x, y))) < 1e-9 * (1 + steepest)


FLAT = HeightField(np.zeros((2, 2), np.float32), (1.0, 1.0), (0.0, 0.0))


@settings(max_examples=100)
@example(FLAT, (0.5, 0.25, -1e-45), np.array((1.0, 0.0, -1e-16)))
@given(FIELDS, POINTS, DIRECTIONS)
def test_never_through(surface: HeightField, point, direction) -> None:
    """Nothing that is well inside a triangle may be missed or passed, but by a ray that lies in its plane."""
    found = RayCaster(surface).cast(point, direction[None])[0]
    triangles, rays = triangles_of(surface), (np.array([point]), direction[None])
    assert found <= triangle_ranges(triangles, *rays, grow=-1e-6, grazing=1e-9)[0] + 1e-6


def test_the_oracle_leaves_out_rays_in_the_plane_only() -> None:
    triangles, down = triangles_of(FLAT), np.array(((0.6, 0.0, -0.8),))
    along = np.array(((1.0, 0.0, -1e-16),))
    for height, directions, expected in ((0.0, along, np.inf), (0.0, down, 0.0), (1e-3, down, 1.25e-3)):
        origin = np.array(((0.5, 0.25, height),))
        found = triangle_ranges(triangles, origin, directions, grow=-1e-6, grazing=1e-9)[0]
        assert found == expected or abs(found - expected) < 1e-12


@settings(max_examples=100)
@example(HeightField(np.zeros((2, 8), np.float32), (0.3, 0.25), (0.0, 0.0)), 1.0, 0.0, 1.0, False)
@given(FIELDS, st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.floats(0.01, 50.0), st.booleans())
def test_straight_down_and_up_measure_the_height(surface, fx: float, fy: float, gap: float, above) -> None:
    (west, south, east, north), sign = surface.bounds, 1.0 if above else -1.0
    x, y = west + fx * (east - west), south + fy * (north - south)
    z = float(surface.height_at(np.clip(x, west, east), np.clip(y, south, north)))
    t = RayCaster(surface).cast((x, y, z + sign * gap), [[0.0, 0.0, -sign]])[0]
    assert abs(t - gap) < 1e-6
