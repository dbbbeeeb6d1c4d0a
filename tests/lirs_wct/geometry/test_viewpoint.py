"""An overview sees the whole box, from outside, and not from farther than it must."""

import math
from itertools import product

import numpy as np
from hypothesis import given, strategies as st

from lirs_wct.geometry.pose import overview

lengths = st.floats(0.01, 1e4)


@given(st.tuples(lengths, lengths, lengths), st.floats(-100, 100), st.floats(0.2, 1.5), st.floats(0.5, 2.5))
def test_every_corner_is_in_the_picture(
    size: tuple[float, float, float], shift: float, fovy: float, aspect: float
) -> None:
    low = np.array((shift, -2 * shift, 3.0))
    view = overview(low, low + size, fovy, aspect)
    corners = np.array(list(product(*zip(low, low + size, strict=True))))
    ahead, right, up = view.axes @ (corners - view.position).T
    assert (ahead > 0).all()
    half = math.tan(fovy / 2)
    across, high = np.abs(right) / (ahead * half * aspect), np.abs(up) / (ahead * half)
    assert 0.7 < max(across.max(), high.max()) <= 1.0
    np.testing.assert_allclose(np.cross(view.axes[1], view.axes[0]), view.axes[2], atol=1e-12)
