"""Rectangles that cover a mask once, and few of them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from lirs_wct.geometry.rectangles import merged_rectangles

masks = hnp.arrays(np.bool_, hnp.array_shapes(min_dims=2, max_dims=2, max_side=9))


@given(masks)
def test_boxes_cover_every_wall_cell_once(solid: np.ndarray) -> None:
    covered = np.zeros(solid.shape, int)
    for r0, c0, r1, c1 in merged_rectangles(solid):
        covered[r0:r1, c0:c1] += 1
    assert np.array_equal(covered, solid.astype(int))


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


@given(st.integers(1, 9), st.integers(1, 9), st.integers(0, 3), st.integers(0, 3))
def test_a_rectangle_is_one(height: int, width: int, south: int, west: int) -> None:
    mask = np.zeros((south + height + 1, west + width + 2), np.bool_)
    mask[south : south + height, west : west + width] = True
    assert merged_rectangles(mask).tolist() == [[south, west, south + height, west + width]]


def test_nothing_needs_none_and_a_mask_is_left_as_it_was() -> None:
    assert merged_rectangles(np.zeros((3, 4), np.bool_)).shape == (0, 4)
    mask = np.ones((2, 3), np.bool_)
    merged_rectangles(mask)
    assert mask.all()


@pytest.mark.parametrize("turned", [False, True])
def test_the_better_of_both_directions_is_taken(turned: bool) -> None:
    # Row by row the first row is taken whole and cuts the columns below; column by column it is two.
    mask = np.array([[1, 1, 1, 1], [1, 0, 0, 0], [1, 0, 0, 0], [1, 0, 1, 1]], np.bool_)
    assert len(merged_rectangles(mask.T if turned else mask)) == 3
