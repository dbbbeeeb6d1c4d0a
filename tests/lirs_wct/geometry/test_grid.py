"""The occupancy grid: three states, one frame, cells found again."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.pose import Pose2

poses = st.builds(Pose2, st.floats(-50, 50), st.floats(-50, 50), st.floats(-3, 3))


@given(poses, st.floats(0.01, 2.0), st.integers(-30, 30), st.integers(-30, 30))
def test_a_cells_centre_lies_in_that_cell(origin: Pose2, resolution: float, row: int, col: int) -> None:
    grid = OccupancyGrid(np.zeros((2, 2), np.float32), resolution, origin)
    assert grid.cells(grid.centers((row, col))).tolist() == [row, col]


@given(poses)
def test_moving_a_grid_moves_its_points(T: Pose2) -> None:
    p = np.full((3, 4), 0.1)
    p[1, 2] = 0.9
    grid = OccupancyGrid.from_probability(p, 0.5, Pose2(1, 2, 0.3))
    np.testing.assert_allclose(grid.moved(T).occupied_points(), T.apply(grid.occupied_points()), atol=1e-9)


def test_unknown_is_neither_free_nor_occupied() -> None:
    grid = OccupancyGrid.from_probability([[0.0, 1.0, np.nan, 0.5]], 1.0)
    assert grid.known.tolist() == [[True, True, False, True]]
    assert grid.occupied.tolist() == [[False, True, False, False]]
    assert grid.free.tolist() == [[True, False, False, False]]
