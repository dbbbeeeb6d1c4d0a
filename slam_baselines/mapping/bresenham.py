"""The cells that a beam passes, by Bresenham's line."""

from __future__ import annotations

from typing import Any

import numpy as np

from lirs_wct.kernels import njit


@njit(cache=True, nogil=True)
def line_cells(row: int, col: int, last_row: int, last_col: int) -> Any:
    """Return (n, 2) row and column of the cells from the first to the last, which is left out."""
    dy, dx = last_row - row, last_col - col
    along, across = max(abs(dx), abs(dy)), min(abs(dx), abs(dy))
    cells = np.empty((along, 2), np.int64)
    error = along // 2
    for k in range(along):
        cells[k, 0], cells[k, 1] = row, col
        error += across
        sideways = error >= along
        if sideways:
            error -= along
        if abs(dx) >= abs(dy) or sideways:
            col += 1 if dx > 0 else -1
        if abs(dx) < abs(dy) or sideways:
            row += 1 if dy > 0 else -1
    return cells
