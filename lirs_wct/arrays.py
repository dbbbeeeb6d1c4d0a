"""Array types by element type, and the decorator of the kernels on them.

Docstrings state shapes, units and frames.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]
IntArray = NDArray[np.int64]
Int32Array = NDArray[np.int32]
ByteArray = NDArray[np.uint8]
BoolArray = NDArray[np.bool_]
RecordArray = NDArray[np.void]
"""Array of a structured type, with named fields."""

Vector3 = tuple[float, float, float]
"""x, y, z as Python numbers; in a hot loop a small array costs more than the arithmetic."""


def njit(*function: Any, **options: Any) -> Any:
    """Compile a kernel by numba.njit with common options; with others, it would compile some twice."""
    import numba  # slow import, needed by kernels only

    common = {"cache": True, "nogil": True, "no_cfunc_wrapper": True, "error_model": "numpy"}
    return numba.njit(*function, **common | options)
