"""Real-time factor: simulated time over wall-clock time, its mean and spread."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from lirs_wct.arrays import FloatArray


def real_time_factor(walls: Sequence[float], period: float) -> dict[str, Any]:
    """Return mean, standard deviation, minimum and series of a drive's real-time factor.

    Args:
        walls: wall-clock seconds of each tick.
        period: simulated seconds of a tick.
    """
    series = 1.0 / per_second(walls, period)
    mean = 1.0 / (sum(walls) / (len(walls) * period))
    return {"mean": mean, "std": float(np.std(series)), "min": float(series.min()), "series": series.tolist()}


def per_second(values: Sequence[float], period: float) -> FloatArray:
    """Return (n,) means per simulated second of per-tick values, over each whole second.

    A last part of a second counts by its share.
    """
    ticks = max(1, round(1.0 / period))
    whole = [values[i : i + ticks] for i in range(0, len(values), ticks)]
    return np.array([sum(part) / (len(part) * period) for part in whole if part], dtype=np.float64)
