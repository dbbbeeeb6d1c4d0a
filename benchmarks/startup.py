"""What a user waits for before anything moves: help, a second short run, and all kernels of a first run.

    python benchmarks/startup.py [--mapper NAME ...] [--quick] [--json FILE]

Processor seconds of whole processes, which other programs lengthen less than those of a clock. A first run
begins with an empty cache of Numba's, in a folder of its own; of it the table shows what each kernel took to
compile, those that it calls left out. It exits 1 where a limit is not kept.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

MAPPERS = ("hector", "gmapping", "cartographer")
LIMITS = {"help": 0.5, "second run": 3.0, "first run, hector": 25.0, "first run, all": 45.0}
"""Processor seconds."""
TOLD = 12
"""Kernels that the table shows."""


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--mapper", nargs="+", default=MAPPERS, choices=MAPPERS)
    parser.add_argument("--quick", action="store_true", help="hector alone")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    parser.add_argument("--compile", metavar="MAPPERS", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.compile:
        print(json.dumps(compile_times(given.compile.split(","))))
        return
    mappers = ["hector"] if given.quick else list(given.mapper)
    figures, kernels = measure(mappers)
    console = Console(width=120)
    console.print(limits_table(figures))
    console.print(kernel_table(kernels))
    if given.json:
        given.json.write_text(json.dumps({**figures, "kernels": kernels}, indent=1) + "\n", encoding="utf-8")
    sys.exit(any(figures[name] > limit for name, limit in LIMITS.items() if name in figures))


def measure(mappers: list[str]) -> tuple[dict[str, float], dict[str, float]]:
    """Return the figures, and the compile time of each kernel of a first run of all mappers."""
    program = [str(Path(sys.executable).with_name("lirs-wct"))]
    run = [*program, "validate", "simple", "--seconds", "1"]
    figures, kernels = {}, {}
    with tempfile.TemporaryDirectory() as folder:
        figures["help"] = min(cpu_seconds([*program, "--help"], folder)[0] for _ in range(3))
        for k, names in enumerate([["hector"], mappers]):
            what = "all" if k else "hector"
            if k and names == ["hector"]:
                break
            cache, command = f"{folder}/{what}", [sys.executable, __file__, "--compile", ",".join(names)]
            figures[f"first run, {what}"], told = cpu_seconds(command, cache)
            kernels = json.loads(told)
            if not k:
                out = ["-o", f"{folder}/out"]
                cpu_seconds([*run, *out], cache)
                figures["second run"] = min(cpu_seconds([*run, *out], cache)[0] for _ in range(3))
    return figures, kernels


def cpu_seconds(command: list[str], cache: str) -> tuple[float, str]:
    """Run a command with a cache of Numba's; return its processor seconds and what it printed."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    env = {**os.environ, "NUMBA_CACHE_DIR": cache}
    done = subprocess.run(command, env=env, check=True, capture_output=True, text=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime, done.stdout


def compile_times(mappers: list[str]) -> dict[str, float]:
    """Run each mapper for a second; return the processor seconds that each kernel took to compile."""
    from numba.core.event import Event, Listener, register

    from lirs_validation import validate

    class Compilations(Listener):
        """Sums of what each compilation took without those within it."""

        def __init__(self) -> None:
            self.begun: list[tuple[float, float]] = []
            self.seconds: dict[str, float] = {}

        def on_start(self, event: Event) -> None:
            self.begun.append((time.process_time(), 0.0))

        def on_end(self, event: Event) -> None:
            begun, within = self.begun.pop()
            whole = time.process_time() - begun
            function: Any = event.data["dispatcher"].py_func
            name = f"{function.__module__}.{function.__qualname__}"
            self.seconds[name] = self.seconds.get(name, 0.0) + whole - within
            if self.begun:
                begun, within = self.begun[-1]
                self.begun[-1] = begun, within + whole

    listener = Compilations()
    register("numba:compile", listener)
    for mapper in mappers:
        validate("simple", mapper=mapper, seconds=1)
    return listener.seconds


def limits_table(figures: dict[str, float]) -> Table:
    """Return the figures beside their limits."""
    shown = Table("processor seconds", "measured", "limit", "kept")
    for name, value in figures.items():
        shown.add_row(name, f"{value:.2f}", f"<= {LIMITS[name]:g}", "yes" if value <= LIMITS[name] else "no")
    return shown


def kernel_table(kernels: dict[str, float]) -> Table:
    """Return the kernels that take longest, and the sum of all."""
    shown = Table("kernel", "compile [s]", title=f"{len(kernels)} functions, {sum(kernels.values()):.1f} s")
    for name, seconds in sorted(kernels.items(), key=lambda item: -item[1])[:TOLD]:
        shown.add_row(name, f"{seconds:.2f}")
    return shown


if __name__ == "__main__":
    main()
