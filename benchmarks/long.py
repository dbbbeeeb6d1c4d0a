"""Two simulated hours in one drive: memory per hour, its linearity, the clock, the speed at both ends.

    nice -n 10 python benchmarks/long.py [SOURCE] [--mapper hector] [--hours 2] [--quick]

Processor time and resident memory are read once per simulated minute; memory is compared with a line through
its readings after the first 10 minutes. A broken limit makes the exit code 1.
"""

from __future__ import annotations

import sys
import time
from contextlib import closing
from typing import Any

import numpy as np

from benchmarks.steps import arguments, resident_mb
from lirs_validation.config import RunConfig
from lirs_validation.experiment.drive import drive
from lirs_validation.experiment.run import ReadyRun, prepare

MINUTE = 60.0
END = 10
"""Minutes at the beginning and at the end that are compared."""
LIMITS = {"mb_per_hour": 300.0, "off_line_mb": 30.0, "clock_error": 1e-6, "cpu_change": 0.10}


def measure(ready: ReadyRun) -> dict[str, Any]:
    """Drive to the end and return the figures."""
    log = ready.log()
    readings = [(0.0, time.process_time(), resident_mb())]
    for driven in drive(ready.simulation, ready.driver, ready.mapper, log, ready.seconds):
        if driven >= len(readings) * MINUTE - 1e-9:
            readings.append((driven, time.process_time(), resident_mb()))
    at, cpu, memory = np.array(readings).T
    speed = np.diff(cpu) / np.diff(at)
    settled = at >= END * MINUTE
    line = np.polyfit(at[settled] / 3600, memory[settled], 1)
    stamps = np.array([scan.stamp for scan in log.scans])
    exact = np.arange(len(stamps)) * ready.simulation.period
    first, last = float(np.median(speed[:END])), float(np.median(speed[-END:]))
    return {
        "simulated": float(at[-1]),
        "status": f"{log.status}: {log.reason}" if log.reason else log.status,
        "cpu_seconds": float(cpu[-1] - cpu[0]),
        "mb_at_start": float(memory[0]),
        "mb_at_end": float(memory[-1]),
        "mb_per_hour": float(line[0]),
        "off_line_mb": float(np.abs(memory[settled] - np.polyval(line, at[settled] / 3600)).max()),
        "clock_error": float(np.abs(stamps - exact).max()),
        "cpu_ms_first": 1e3 * first,
        "cpu_ms_last": 1e3 * last,
        "cpu_change": abs(last / first - 1),
    }


def main() -> None:
    """Drive, print the figures and check them."""
    given = arguments(__doc__, "source", source="simple", mapper="hector", hours=2.0, quick=False)
    seconds = 3600 * (0.5 if given.quick else given.hours)
    ready = prepare(RunConfig(source=given.source, mapper=given.mapper, seconds=seconds))
    with closing(ready.mapper):
        figures = measure(ready)
    over = [name for name, limit in LIMITS.items() if figures[name] > limit]
    for name, value in figures.items():
        limit = f" (at most {LIMITS[name]:g})" if name in LIMITS else ""
        print(f"{name:14} {value if isinstance(value, str) else f'{value:.4g}'}{limit}")
    if over or figures["simulated"] < seconds - 1e-6:
        sys.exit(f"over its limit, or ended early: {', '.join(over)}")


if __name__ == "__main__":
    main()
