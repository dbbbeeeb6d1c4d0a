"""Walls of a laser map: cells, corners, and what is refused."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp

from lirs_wct.errors import ConfigError
from lirs_wct.geometry.grid import WallGrid
from lirs_wct.geometry.pose import Pose2
from lirs_wct.meshing.solid import merged_rectangles

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


def test_what_is_just_legal() -> None:
    assert WallGrid(WALLS, 1e-9, height=1e-9).resolution == 1e-9
    nothing = WALLS & False
    assert WallGrid(nothing, 0.5, hole=~WALLS).floor.tolist() == WALLS.tolist()
    assert not WallGrid(WALLS, 0.5, hole=~WALLS).floor.any()


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
