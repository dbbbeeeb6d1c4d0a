"""Fast formatting of numbers as text."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lirs_wct.arrays import ByteArray, FloatArray, IntArray, njit

_LONGEST = 22
"""Characters of a sign, 19 digits, a point and a separator."""


def fixed_text(table: ArrayLike, decimals: ArrayLike, between: bytes = b" ") -> bytes:
    """Return a table as decimal text: columns separated, rows ended by newlines.

    Redundant zeros are omitted (`.5`, `-3`), as XML Schema's double allows.

    Args:
        table: (rows, columns) finite numbers below 9e18 / 10**decimals.
        decimals: digits after the point, 0 to 9, for each column.
        between: a character that separates columns, or one for each gap between two.
    """
    values = np.ascontiguousarray(table, dtype=np.float64)
    digits = np.broadcast_to(np.asarray(decimals, dtype=np.int64), values.shape[1:]).copy()
    out = np.empty(values.size * _LONGEST, dtype=np.uint8)
    ends = np.full(values.shape[1], ord("\n"), np.uint8)
    ends[:-1] = np.frombuffer(between, np.uint8)
    return out[: _write(values, digits, ends, out)].tobytes()


@njit
def _write(values: FloatArray, decimals: IntArray, ends: ByteArray, out: ByteArray) -> int:
    """Write the text into `out`, with a character after each column; return its length."""
    at = 0
    reverse = np.empty(24, np.uint8)
    rows, cols = values.shape
    for row in range(rows):
        for col in range(cols):
            places = decimals[col]
            scale = 10**places
            v = np.int64(np.floor(abs(values[row, col]) * scale + 0.5))
            if values[row, col] < 0 and v > 0:
                out[at] = 45
                at += 1
            while places > 0 and v % 10 == 0:
                v //= 10
                places -= 1
            n = 0
            while n < places or v > 0:
                reverse[n] = 48 + v % 10
                v //= 10
                n += 1
            if n == 0:
                out[at] = 48
                at += 1
            for k in range(n - 1, -1, -1):
                if k == places - 1:
                    out[at] = 46
                    at += 1
                out[at] = reverse[k]
                at += 1
            out[at] = ends[col]
            at += 1
    return at
