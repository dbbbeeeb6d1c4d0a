"""CPU seconds of the fast tests: `make test` stores them, it and `make check` tell what is over the limits.

Kernels that no drive needs are compiled by the first test that calls them; this time is left out.

An excess fails no test: machines differ.
"""

import os
import time
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from numba.core.event import Event, Listener, register

LIMITS = tomllib.loads(Path(__file__).with_name("style_limits.toml").read_text(encoding="utf-8"))
BEGUN = pytest.StashKey[float]()
STORED = "lirs_wct/cpu_seconds_of_fast_tests"
"""Key in pytest's cache."""
measured: dict[str, float] = {}
"""CPU seconds of each fast test of this run."""


class Compilation(Listener):
    """CPU seconds of numba's compiler, which works once a checkout in whichever test comes first."""

    seconds = begun = 0.0
    depth = 0

    def on_start(self, event: Event) -> None:
        self.begun = self.begun if self.depth else time.process_time()
        self.depth += 1

    def on_end(self, event: Event) -> None:
        self.depth -= 1
        self.seconds += 0.0 if self.depth else time.process_time() - self.begun


compilation = Compilation()
register("numba:compile", compilation)


def cpu_seconds() -> float:
    """Return the CPU time of this process, compilation left out, and of its ended children."""
    return time.process_time() - compilation.seconds + sum(os.times()[2:4])


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> None:
    item.stash[BEGUN] = cpu_seconds()


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_teardown(item: pytest.Item) -> None:
    # Travels with the report from a worker of xdist.
    item.user_properties.append(("cpu_seconds", cpu_seconds() - item.stash[BEGUN]))


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if report.when == "teardown" and "slow" not in report.keywords:
        measured[report.nodeid] = round(dict[str, Any](report.user_properties)["cpu_seconds"], 3)


def summary(seconds: Mapping[str, float], limits: Mapping[str, Any] = LIMITS) -> list[str]:
    """Return lines: the total, and each test over the limit of one, the longest first."""
    one, every, total = (
        limits["fast_test_cpu_seconds"],
        limits["fast_tests_cpu_seconds"],
        sum(seconds.values()),
    )
    excess = f", {total - every:.0f} over the limit" if total > every else ""
    over = sorted((name for name in seconds if seconds[name] > one), key=lambda name: -seconds[name])
    return [
        f"{len(seconds)} fast tests took {total:.0f} CPU seconds{excess}; {len(over)} took more than {one:g}",
        *(f"{seconds[name]:8.2f} {name}" for name in over),
    ]


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    chosen, cache = config.option.markexpr, getattr(config, "cache", None)
    if chosen not in ("not slow", "slow") or cache is None:
        return
    if chosen == "not slow":
        cache.set(STORED, measured)
    seconds = cache.get(STORED, {})
    if seconds:
        terminalreporter.section("CPU seconds of the fast tests")
        terminalreporter.write_line("\n".join(summary(seconds)))
