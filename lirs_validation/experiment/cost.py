"""Cost of a run: processor time, memory, compilation, system load."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

if sys.platform != "win32":
    import resource

_SELF = Path("/proc/self")


@dataclass(frozen=True, slots=True)
class Cost:
    """Cost of processes.

    Attributes:
        cpu_seconds: Processor time of all threads.
        peak_memory: Largest resident memory, bytes, shared memory counted in each process; None where the
            system has no such count.
    """

    cpu_seconds: float
    peak_memory: int | None

    def __add__(self, other: Cost) -> Cost:
        """Return the cost of two processes together; their peaks may not have come at the same time."""
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
        return Cost(time.process_time() - self._begun, _peak_memory())


def _peak_memory() -> int | None:
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
    """Measure the time of Numba's compiler in a block, to compile kernels or load them from its cache.

    The yielded function returns the seconds so far.
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
