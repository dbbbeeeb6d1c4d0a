"""Array types by element type; docstrings state shapes, units and frames."""

from __future__ import annotations

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
