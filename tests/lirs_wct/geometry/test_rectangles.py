"""Rectangles that cover a mask once, and few of them."""

import numpy as np
from hypothesis import given
from hypothesis.extra import numpy as hnp

from lirs_wct.geometry.rectangles import merged_rectangles

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
