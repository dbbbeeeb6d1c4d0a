import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lirs_wct.formats.meshes.text import fixed_text


@pytest.mark.parametrize(
    ("number", "decimals", "text"),
    [
        (0, 0, "0"),
        (0, 3, "0"),
        (-0.0001, 3, "0"),
        (0.5, 3, ".5"),
        (-0.25, 3, "-.25"),
        (12.0, 3, "12"),
        (100, 0, "100"),
        (1.0004, 3, "1"),
        (0.0996, 3, ".1"),
        (0.012, 3, ".012"),
        (-24.9512, 4, "-24.9512"),
        (999.9999, 3, "1000"),
    ],
)
def test_numbers(number: float, decimals: int, text: str) -> None:
    assert fixed_text([[number]], decimals) == f"{text}\n".encode()


def test_table() -> None:
    assert fixed_text([[1, 0.5], [2, -0.25]], (0, 2)) == b"1 .5\n2 -.25\n"
    assert fixed_text(np.empty((0, 3)), 2) == b""
    assert fixed_text([[1, 2, 3], [40, 5, 6]], 0, b"/;") == b"1/2;3\n40/5;6\n"


@given(st.floats(-1e6, 1e6), st.integers(0, 6))
def test_read_back(number: float, decimals: int) -> None:
    assert float(fixed_text([[number]], decimals)) == pytest.approx(number, abs=0.501 * 10**-decimals)
