"""Wall times of a mapper's updates."""

from __future__ import annotations

import time
from array import array
from typing import TypedDict

import numpy as np


class Times(TypedDict, total=False):
    """The times of MapperStats; empty before the first update."""

    ms_p50: float
    ms_p95: float
    ms_max: float


class Stopwatch:
    """Wall times of updates, milliseconds."""

    def __init__(self) -> None:
        self._ms = array("d")

    def start(self) -> int:
        """Return the time now, nanoseconds."""
        return time.perf_counter_ns()

    def stop(self, started: int) -> None:
        """Note how long ago `started` was."""
        self._ms.append((time.perf_counter_ns() - started) * 1e-6)

    def summary(self) -> Times:
        """Return the times of MapperStats."""
        if not self._ms:
            return {}
        p50, p95, most = np.percentile(self._ms, (50, 95, 100))
        return {"ms_p50": float(p50), "ms_p95": float(p95), "ms_max": float(most)}
