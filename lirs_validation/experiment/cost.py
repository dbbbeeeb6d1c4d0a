"""Cost of a run: processor time, memory, compilation, system load, real-time factor."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lirs_wct.arrays import FloatArray

if sys.platform != "win32":
    import resource

_SELF = Path("/proc/self")


@dataclass(frozen=True, slots=True)
class Cost:
    """Cost of processes.

    Attributes:
        cpu_seconds: processor time of all threads.
        peak_memory: largest resident memory, bytes, what processes share counted in each; None where the
            system has no such count.
    """

    cpu_seconds: float
    peak_memory: int | None

    def __add__(self, other: Cost) -> Cost:
        """Return the cost of two processes together.

        Their peaks may not have come at the same time.
        """
        peaks = self.peak_memory, other.peak_memory
        peak = None if None in peaks else sum(filter(None, peaks))
        return Cost(self.cpu_seconds + other.cpu_seconds, peak)


class CostMeter:
    """Meter of processor time and peak memory of this process."""

    def __init__(self) -> None:
        self._begun = time.process_time()
        with suppress(OSError):
            # Linux forgets the peak so far; elsewhere the peak is the process's whole life's.
            (_SELF / "clear_refs").write_text("5", encoding="ascii")

    def cost(self) -> Cost:
        """Return the cost since the meter was created."""
        return Cost(self.cpu_seconds(), self.peak_memory())

    def cpu_seconds(self) -> float:
        """Return the processor time since then, seconds, of all threads."""
        return time.process_time() - self._begun

    def peak_memory(self) -> int | None:
        """Return the peak resident memory, bytes; None if the system has no count."""
        with suppress(OSError):
            lines = (_SELF / "status").read_text(encoding="utf-8").splitlines()
            peaks = [line.split()[1] for line in lines if line.startswith("VmHWM:")]
            if peaks:
                return int(peaks[0]) * 1024
        if sys.platform == "win32":
            return None
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return peak if sys.platform == "darwin" else peak * 1024


@contextmanager
def compile_timer() -> Iterator[Callable[[], float]]:
    """Measure the time of Numba's compiler in a block.

    The yielded function returns the seconds so far.

    Kernels are compiled, or loaded from Numba's cache.
    """
    from numba.core.event import TimingListener, install_listener

    timer = TimingListener()
    with install_listener("numba:compiler_lock", timer):
        yield lambda: float(timer.duration) if timer.done else 0.0


def load_average() -> float | None:
    """Return the mean number of running processes in the last minute; None without a count."""
    with suppress(AttributeError, OSError):  # Windows has none
        return os.getloadavg()[0]
    return None


def is_shared(load: float | None) -> bool:
    """Whether more processes than cores wanted to run."""
    return load is not None and load > (os.cpu_count() or 1)


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
