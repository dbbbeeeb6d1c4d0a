"""A growing grid holds every box that it was asked for."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from slam_baselines.mapping.occupancy_map import GrowingGrid


@settings(max_examples=100, deadline=None)
@given(
    st.lists(st.tuples(*[st.floats(-40, 40)] * 2, *[st.floats(0, 30)] * 2), min_size=1, max_size=6),
    st.sampled_from((0.05, 0.1, 0.2)),
)
def test_a_grid_holds_every_box_with_a_cell_to_spare(
    boxes: list[tuple[float, float, float, float]], resolution: float
) -> None:
    grid = GrowingGrid(resolution, {"a": (np.uint8, 7)})
    for west, south, width, height in boxes:
        before = grid.layers["a"]
        grew = grid.ensure(west, south, west + width, south + height)
        assert grew == (grid.layers["a"] is not before)
        rows, cols = grid.shape
        assert grid.col0 <= west / resolution - 1 + 1e-6
        assert grid.row0 <= south / resolution - 1 + 1e-6
        assert grid.col0 + cols >= (west + width) / resolution + 2 - 1e-6
        assert grid.row0 + rows >= (south + height) / resolution + 2 - 1e-6
        assert not grid.ensure(west, south, west + width, south + height)
