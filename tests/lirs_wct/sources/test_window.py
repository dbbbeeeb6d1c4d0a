"""Squares cut out of surfaces and maps: which nodes and cells are kept, and where they lie."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from lirs_wct.errors import ConfigError
from lirs_wct.geometry import HeightField, OccupancyGrid
from lirs_wct.geometry.pose import Pose2
from lirs_wct.ground import Terrain, cut_surface, cut_terrain, leveled
from lirs_wct.sources.laser_map import cut_map

# 61 nodes from x = 10 to 40, 41 nodes from y = -8 to 2.
Z = np.random.default_rng(3).uniform(5, 9, (41, 61)).astype(np.float32)
SURFACE = HeightField(Z, (0.5, 0.25), (10.0, -8.0))


def nodes(field: HeightField) -> tuple[np.ndarray, np.ndarray]:
    """Return x and y of the columns and of the rows, the north first."""
    x = field.origin[0] + field.cell[0] * np.arange(field.shape[1])
    return x, field.origin[1] + field.cell[1] * np.arange(field.shape[0])[::-1]


@given(st.floats(0, 50), st.floats(-15, 9), st.floats(8, 40))
def test_nodes_of_the_square_rounded_outward_stay_where_they_are(x: float, y: float, side: float) -> None:
    half = side / 2
    if x + half <= 10 or x - half >= 40 or y + half <= -8 or y - half >= 2:
        with pytest.raises(ConfigError, match=r"lies outside the terrain: x 10 to 40, y -8 to 2 m"):
            cut_surface(SURFACE, (x, y, side))
        return
    part = cut_surface(SURFACE, (x, y, side))
    west, south, east, north = part.bounds
    assert part.cell == SURFACE.cell
    assert west <= max(x - half, 10) + 1e-6
    assert east >= min(x + half, 40) - 1e-6
    assert south <= max(y - half, -8) + 1e-6
    assert north >= min(y + half, 2) - 1e-6
    assert west > max(x - half, 10) - 0.5 - 1e-6 or part.shape[1] == 2
    assert east < min(x + half, 40) + 0.5 + 1e-6 or part.shape[1] == 2
    assert south > max(y - half, -8) - 0.25 - 1e-6 or part.shape[0] == 2
    assert north < min(y + half, 2) + 0.25 + 1e-6 or part.shape[0] == 2
    columns, rows = nodes(part)
    whole = SURFACE.height_at(columns[None, :], rows[:, None])
    np.testing.assert_allclose(part.z, whole, atol=1e-5)
    level, lift = leveled(part)
    np.testing.assert_allclose(level.z + lift, part.z, atol=1e-5)
    assert level.z.min() == 0.0


def test_a_square_of_nodes_by_hand() -> None:
    part = cut_surface(SURFACE, (25.0, -4.0, 8.0))  # x 21 to 29, y -8 to 0: on nodes, not one more
    assert (part.bounds, part.shape) == ((21.0, -8.0, 29.0, 0.0), (33, 17))
    kept = Z[8:41, 22:39]
    np.testing.assert_array_equal(part.z, kept)
    part = cut_surface(SURFACE, (25.1, -4.1, 8.0))  # x 21.1 to 29.1, y -8.1 to -0.1
    assert (part.bounds, part.shape) == ((21.0, -8.0, 29.5, 0.0), (33, 18))


@pytest.mark.parametrize(
    ("x", "y"), [(5.999, -3.0), (44.001, -3.0), (25.0, -12.001), (25.0, 6.001), (6.0, -3.0), (25.0, 6.0)]
)
def test_a_square_that_only_touches_lies_outside(x: float, y: float) -> None:
    with pytest.raises(ConfigError, match="lies outside the terrain"):
        cut_surface(SURFACE, (x, y, 8.0))


@pytest.mark.parametrize(
    ("window", "bounds"),
    [
        ((25.0, -3.0, 7.9), (21.05, -6.95, 28.95, 0.95)),
        ((25.1, -3.1, 0.4), (24.9, -3.3, 25.3, -2.9)),
        ((10.0, 2.0, 3.0), (10.0, 0.5, 11.5, 2.0)),
        ((40.0, -8.0, 3.0), (38.5, -8.0, 40.0, -6.5)),
    ],
)
def test_fewer_than_sixteen_cells_are_sampled_anew(
    window: tuple[float, float, float], bounds: tuple[float, float, float, float]
) -> None:
    part = cut_surface(SURFACE, window)
    assert part.shape == (65, 65)
    np.testing.assert_allclose(part.bounds, bounds, atol=1e-9)
    columns, rows = nodes(part)
    whole = SURFACE.height_at(np.clip(columns, 10, 40)[None, :], np.clip(rows, -8, 2)[:, None])
    np.testing.assert_allclose(part.z, whole, atol=1e-5)


@given(st.floats(10.0, 40.0), st.floats(-8.0, 2.0), st.floats(0.5, 30.0))
def test_a_mask_is_cut_as_its_surface_was(x: float, y: float, side: float) -> None:
    mask = np.random.default_rng(0).random(Z.shape) < 0.5
    ground, lift = cut_terrain(Terrain(SURFACE, mask), (x, y, side))
    columns, rows = nodes(ground.surface)
    col = np.rint((columns - 10.0) / 0.5).astype(int)
    row = 40 - np.rint((rows + 8.0) / 0.25).astype(int)
    np.testing.assert_array_equal(ground.no_ground, mask[np.ix_(row, col)])
    assert ground.sample_spacing == (0.5 if side < 8.0 else None)
    assert (ground.surface.z.min(), lift > 0) == (0.0, True)


@given(st.integers(0, 2**32 - 1))
def test_cells_of_a_map_about_the_square_stay_where_they_are(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(2, 12, 2).tolist())
    origin = Pose2(*rng.uniform((-9, -9, -3), (9, 9, 3)).tolist())
    grid = OccupancyGrid(rng.normal(size=shape).astype(np.float32), float(rng.uniform(0.05, 0.6)), origin)
    target = grid.centers(rng.uniform((-1, -1), np.array(shape)))
    window = (*target.tolist(), float(rng.uniform(0.1, 2.0)))
    x, y, side = window
    corners = origin.inverse().apply(
        [(x + sx * side / 2, y + sy * side / 2) for sx in (-1, 1) for sy in (-1, 1)]
    )
    (west, south), (east, north) = (
        corners.min(axis=0) / grid.resolution,
        corners.max(axis=0) / grid.resolution,
    )
    rows = [r for r in range(shape[0]) if r + 1 > south and r <= north]
    cols = [c for c in range(shape[1]) if c + 1 > west and c <= east]
    if not rows or not cols:
        with pytest.raises(ConfigError, match="lies outside the map"):
            cut_map(grid, window)
        return
    part = cut_map(grid, window)
    np.testing.assert_array_equal(
        part.log_odds, grid.log_odds[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
    )
    assert part.resolution == grid.resolution
    np.testing.assert_allclose(part.centers((0, 0)), grid.centers((rows[0], cols[0])), atol=1e-9)
    np.testing.assert_allclose(part.centers((5, -3)), grid.centers((rows[0] + 5, cols[0] - 3)), atol=1e-9)


def test_a_square_of_cells_by_hand() -> None:
    grid = OccupancyGrid(np.arange(20, dtype=np.float32).reshape(4, 5), 0.5, Pose2(2.0, -1.0))
    part = cut_map(grid, (3.25, -0.25, 0.9))  # x 2.8 to 3.7, y -0.7 to 0.2
    assert part.log_odds.tolist() == [[1, 2, 3], [6, 7, 8], [11, 12, 13]]
    assert part.origin == Pose2(2.5, -1.0)
    turned = cut_map(grid.moved(Pose2(0, 0, math.pi / 2)), (0.25, 3.25, 0.9))
    assert turned.log_odds.tolist() == part.log_odds.tolist()
    for window in ((1.0, 0.0, 1.99), (0.0, 9.0, 1.0), (5.51, 0.0, 2.0)):
        with pytest.raises(ConfigError, match="lies outside the map"):
            cut_map(grid, window)
    assert cut_map(grid, (1.0, 0.0, 2.01)).shape == (4, 1)
