"""Grids of cells: occupancy, walls, holes, their cover by rectangles, and resampling."""

from __future__ import annotations

import math
import warnings
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp

from lirs_wct.errors import ConfigError
from lirs_wct.geometry import OccupancyGrid, WallGrid
from lirs_wct.geometry.grid import resample
from lirs_wct.geometry.pose import Pose2
from lirs_wct.meshing.walls import merged_rectangles

poses = st.builds(Pose2, st.floats(-50, 50), st.floats(-50, 50), st.floats(-3, 3))


@given(poses, st.floats(0.01, 2.0), st.integers(-30, 30), st.integers(-30, 30))
def test_a_cells_center_lies_in_that_cell(origin: Pose2, resolution: float, row: int, col: int) -> None:
    grid = OccupancyGrid(np.zeros((2, 2), np.float32), resolution, origin)
    assert grid.cells(grid.centers((row, col))).tolist() == [row, col]


def test_unknown_is_neither_free_nor_occupied() -> None:
    grid = OccupancyGrid.from_probability([[0.0, 1.0, np.nan, 0.5]], 1.0)
    assert grid.known.tolist() == [[True, True, False, True]]
    assert grid.occupied.tolist() == [[False, True, False, False]]
    assert grid.free.tolist() == [[True, False, False, False]]


def test_log_odds_beyond_float32_are_certain_without_a_warning() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        grid = OccupancyGrid(np.array([[-200.0, 200.0]], np.float32), 1.0)
        assert grid.probability.tolist() == [[0.0, 1.0]]


def test_row_0_is_the_south_and_column_0_the_west() -> None:
    """A grid of 2 rows and 3 columns, a quarter turn to the left: its columns run north."""
    p = np.array([(0.1, 0.9, 0.1), (0.1, 0.1, 0.9)])
    grid = OccupancyGrid.from_probability(p, 0.5, Pose2(10.0, -4.0, math.pi / 2))
    assert grid.shape == (2, 3)
    np.testing.assert_allclose(grid.occupied_points(), [(9.75, -3.25), (9.25, -2.75)], atol=1e-12)
    assert grid.cells([(9.75, -3.25), (9.25, -2.75), (10.1, -4.1)]).tolist() == [[0, 1], [1, 2], [-1, -1]]
    upright = OccupancyGrid.from_probability(p, 0.5)
    assert upright.origin == Pose2()
    assert upright.centers([(0, 0), (1, 2)]).tolist() == [[0.25, 0.25], [1.25, 0.75]]
    assert upright.cells((1.25, 0.75)).tolist() == [1, 2]


def test_a_cell_holds_its_lower_edges() -> None:
    grid = OccupancyGrid(np.zeros((4, 4), np.float32), 0.25, Pose2(-1.0, 2.0))
    points = [(-1.0, 2.0), (-0.75, 2.0), (-1.0, 2.25), (-0.75 - 2**-40, 2.25), (-1.0 - 2**-40, 2.0)]
    assert grid.cells(points).tolist() == [[0, 0], [0, 1], [1, 0], [1, 0], [0, -1]]


@pytest.mark.parametrize(
    ("p", "occupied", "free"),
    [(0.651, True, False), (0.649, False, False), (0.251, False, False), (0.249, False, True)],
)
def test_thresholds_are_those_of_map_saver(p: float, occupied: bool, free: bool) -> None:
    grid = OccupancyGrid.from_probability([[p]], 1.0)
    assert (grid.occupied[0, 0], grid.free[0, 0]) == (occupied, free)


@given(poses, poses, st.floats(0.01, 2.0))
def test_moved_cells_are_the_same_cells(T: Pose2, origin: Pose2, resolution: float) -> None:
    grid = OccupancyGrid(np.float32([[1.0, np.nan, -1.0]]), resolution, origin)
    moved = grid.moved(T)
    assert moved.log_odds is grid.log_odds
    assert moved.resolution == resolution
    cells = [(0, 0), (0, 2), (3, -4)]
    np.testing.assert_allclose(moved.centers(cells), T.apply(grid.centers(cells)), atol=1e-9)
    np.testing.assert_allclose(
        grid.centers(cells), origin.apply(np.array([(0.5, 0.5), (2.5, 0.5), (-3.5, 3.5)]) * resolution)
    )


@pytest.mark.parametrize(
    ("log_odds", "resolution"),
    [
        (np.zeros((2, 2), np.float32), 0.0),
        (np.zeros((2, 2), np.float32), -1.0),
        (np.zeros((2, 2)), 1.0),
        (np.zeros(4, np.float32), 1.0),
        (np.zeros((2, 2, 1), np.float32), 1.0),
    ],
)
def test_what_is_no_grid_is_refused(log_odds: np.ndarray, resolution: float) -> None:
    with pytest.raises(ConfigError, match=r"resolution|float32 matrix"):
        OccupancyGrid(log_odds, resolution)
    assert OccupancyGrid(np.zeros((1, 1), np.float32), 1e-9).shape == (1, 1)


def test_a_mask_is_what_certain_probabilities_are() -> None:
    mask = np.random.default_rng(3).random((5, 7)) < 0.4
    grid = OccupancyGrid.from_mask(mask, 0.5, Pose2(1, 2, 0.3))
    expected = OccupancyGrid.from_probability(mask.astype(float), 0.5, Pose2(1, 2, 0.3))
    assert grid.log_odds.tobytes() == expected.log_odds.tobytes()
    assert (grid.resolution, grid.origin) == (expected.resolution, expected.origin)


@given(
    poses,
    st.floats(0.05, 2.0),
    st.integers(0, 4),
    st.integers(0, 6),
    st.floats(0.01, 0.99),
    st.floats(0.01, 0.99),
)
def test_a_point_is_free_where_its_cell_is_and_nowhere_outside(
    origin: Pose2, resolution: float, row: int, col: int, across: float, along: float
) -> None:
    p = np.random.default_rng(0).uniform(0, 1, (3, 5))
    p[0, 0], p[2, 4], p[1, 1] = 0.1, 0.1, np.nan
    grid = OccupancyGrid.from_probability(p, resolution, origin)
    place = origin.apply(((col - 1 + along) * resolution, (row - 1 + across) * resolution))
    inside = 1 <= row <= 3 and 1 <= col <= 5
    assert grid.free_at(*place.tolist()) == (inside and bool(p[row - 1, col - 1] < 0.25))


@given(st.integers(2, 9), st.integers(2, 9), st.integers(0, 12), st.integers(0, 12))
def test_finer_grids_lie_on_straight_lines_between_the_nodes(
    rows: int, cols: int, more: int, wide: int
) -> None:
    z = np.random.default_rng(rows * 10 + cols).normal(size=(rows, cols)).astype(np.float32)
    found = resample(z, cols + wide, rows + more)
    assert (found.shape, found.dtype) == ((rows + more, cols + wide), np.float32)
    x, y = np.linspace(0, cols - 1, cols + wide), np.linspace(0, rows - 1, rows + more)
    across = np.array([np.interp(x, np.arange(cols), row) for row in z])
    expected = np.array([np.interp(y, np.arange(rows), column) for column in across.T]).T
    np.testing.assert_allclose(found, expected, atol=1e-5)
    np.testing.assert_allclose(
        found[[0, 0, -1, -1], [0, -1, 0, -1]], z[[0, 0, -1, -1], [0, -1, 0, -1]], atol=1e-6
    )


@pytest.mark.parametrize(("width", "height"), [(20, 31), (60, 16), (20, 16), (61, 16), (21, 61)])
def test_coarser_grids_are_blurred_by_half_of_what_they_shrink(width: int, height: int) -> None:
    """Of 61 x 31 nodes; the axis that does not shrink is blurred by next to nothing."""
    z = np.random.default_rng(3).normal(size=(31, 61)).astype(np.float32)
    sigmas = [max((61 - 1) / (width - 1) - 1, 2e-3) / 2, max((31 - 1) / (height - 1) - 1, 2e-3) / 2]
    blurred = cv2.GaussianBlur(z, (0, 0), sigmas[0], sigmaY=sigmas[1], borderType=cv2.BORDER_REPLICATE)
    expected = resample(np.repeat(blurred, 1, axis=0), 61, 31)  # as large: no blur
    np.testing.assert_array_equal(expected, blurred)
    x, y = np.linspace(0, 60, width), np.linspace(0, 30, height)
    across = np.array([np.interp(x, np.arange(61), row) for row in blurred])
    expected = np.array([np.interp(y, np.arange(31), column) for column in across.T]).T
    np.testing.assert_allclose(resample(z, width, height), expected, atol=1e-5)


def test_the_same_grid_stays_to_the_bit() -> None:
    z = np.random.default_rng(3).normal(size=(5, 4)).astype(np.float32)
    np.testing.assert_array_equal(resample(z, 4, 5), z)


WALLS = np.array([[True, False, False], [False, False, True]])
HOLES = np.array([[False, True, False], [False, False, False]])


def test_cells_are_wall_hole_or_floor() -> None:
    walls = WallGrid(WALLS, 0.5, hole=HOLES)
    assert walls.shape == (2, 3)
    assert walls.floor.tolist() == [[False, False, True], [True, True, False]]
    assert WallGrid(WALLS, 0.5).floor.tolist() == (~WALLS).tolist()
    assert (walls.origin, walls.height, WallGrid(WALLS, 0.5).hole) == (Pose2(), 1.0, None)


@given(st.integers(1, 5), st.integers(1, 5), st.floats(0.01, 3.0), st.floats(-3, 3))
def test_corners_are_those_of_the_outer_cells(rows: int, cols: int, edge: float, yaw: float) -> None:
    T = Pose2(-7.0, 2.0, yaw)
    found = WallGrid(np.ones((rows, cols), np.bool_), edge, T).corners
    expected = [
        T.apply((col * edge, row * edge)) for col, row in ((0, 0), (cols, 0), (cols, rows), (0, rows))
    ]
    np.testing.assert_allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"solid": WALLS.astype(np.uint8)}, "walls must be a bool matrix, got uint8"),
        ({"solid": WALLS.ravel()}, "walls must be a bool matrix"),
        ({"resolution": 0.0}, "resolution must be above 0 m"),
        ({"height": 0.0}, "height of the walls must be above 0 m"),
        ({"hole": HOLES[:, :2]}, r"holes must be a bool matrix \(2, 3\)"),
        ({"hole": HOLES.astype(np.int8)}, "holes must be a bool matrix"),
        ({"hole": WALLS}, "a cell cannot be both wall and hole"),
        ({"hole": HOLES | WALLS}, "a cell cannot be both wall and hole"),
        ({"solid": WALLS & False, "hole": WALLS | True}, "every cell is a hole"),
    ],
)
def test_what_are_no_walls(values: dict[str, Any], told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        WallGrid(**{"solid": WALLS, "resolution": 0.5, **values})


masks = hnp.arrays(np.bool_, hnp.array_shapes(min_dims=2, max_dims=2, max_side=9))


def greedy(mask: np.ndarray) -> list[tuple[int, int, int, int]]:
    """At the first cell that is left, the larger of the rectangles grown along one axis first."""
    left, boxes = mask.copy(), []
    while left.any():
        r, c = np.argwhere(left)[0].tolist()
        sizes = []
        for along_row in (True, False):
            r1, c1 = r + 1, c + 1
            for _ in range(2):
                while along_row and c1 < left.shape[1] and left[r:r1, c1].all():
                    c1 += 1
                while not along_row and r1 < left.shape[0] and left[r1, c:c1].all():
                    r1 += 1
                along_row = not along_row
            sizes.append((r1, c1))
        r1, c1 = max(sizes, key=lambda end: (end[0] - r) * (end[1] - c))
        left[r:r1, c:c1] = False
        boxes.append((r, c, r1, c1))
    return boxes


@given(masks)
def test_as_few_as_the_better_of_two_greedy_covers(mask: np.ndarray) -> None:
    straight, turned = greedy(mask), [(r0, c0, r1, c1) for c0, r0, c1, r1 in greedy(mask.T)]
    expected = straight if len(straight) <= len(turned) else turned
    assert merged_rectangles(mask).tolist() == [list(box) for box in expected]


def test_nothing_needs_none_and_a_mask_is_left_as_it_was() -> None:
    assert merged_rectangles(np.zeros((3, 4), np.bool_)).shape == (0, 4)
    mask = np.ones((2, 3), np.bool_)
    merged_rectangles(mask)
    assert mask.all()
