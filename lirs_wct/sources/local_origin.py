"""Local origin of sources in coordinates of a country, whose float32 digits would not suffice."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from lirs_wct.arrays import FloatArray

FAR = 10_000.0
"""Distance from the origin, meters, beyond which the center of a source becomes the world's origin."""


def local_origin(low: FloatArray, high: FloatArray, unit: float = 1.0) -> tuple[float, float]:
    """Return the coordinates of the world's origin: 0, 0 of a source near there.

    Args:
        low: smallest x and y of the source.
        high: largest x and y.
        unit: meters per unit of the coordinates.
    """
    if np.abs((low, high)).max() * unit <= FAR:
        return 0.0, 0.0
    x, y = ((low + high) / 2).round().tolist()
    return x, y


def warn_of_origin(path: Path, origin: tuple[float, float]) -> None:
    """Say which coordinates of a far source are the world's origin."""
    if origin != (0.0, 0.0):
        x, y = origin
        warnings.warn(
            f"{path}: lies far from its origin: its point {x:.0f}, {y:.0f} becomes 0, 0 of the world",
            stacklevel=4,
        )
