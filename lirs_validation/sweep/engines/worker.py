"""A process that runs experiments for another one, and can be killed without taking anything with it."""

from __future__ import annotations

import contextlib
import faulthandler
import multiprocessing
import os
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from lirs_validation.experiment.scenario import Scenario, ScenarioCache
from lirs_validation.interrupts import end_with
from lirs_validation.sweep.engines.base import Limits
from lirs_validation.sweep.experiment import Experiment, attempt
from lirs_wct.files import remove_orphans

ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMBA")}
"""Environment of a worker: as many threads as workers, or they fight for the cores."""
GRACE = 3.0
"""Seconds that a worker is given to tidy up before it is killed."""
TRACE = "lirs-wct-trace-"
"""Beginning of the names of the files in which workers say where they crashed."""
SPAWN = multiprocessing.get_context("spawn")


@dataclass(frozen=True)
class Job:
    """What a worker is asked to do; a scenario that was built elsewhere spares it building."""

    experiment: Experiment
    out: Path
    concurrent: bool
    scenario: Scenario | None = None


class Worker:
    """Another process, one job at a time.

    What it says comes through `pipe`: `("begun",)`, then `("progress", step, share)` any number of
    times, then `("done", outcome)`.
    """

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        remove_orphans(Path(tempfile.gettempdir()), TRACE)
        file, name = tempfile.mkstemp(prefix=f"{TRACE}{os.getpid()}-", suffix=".trace")
        os.close(file)
        self._trace = Path(name)
        self.pipe, far = SPAWN.Pipe()
        self.job: Job | None = None
        self._since = 0.0
        self._process = SPAWN.Process(target=_work, args=(far, limits.memory, name, os.getpid()), daemon=True)
        with _environment(ONE_THREAD), _ignore_sigint():
            self._process.start()
        far.close()

    @property
    def pid(self) -> int:
        """Process id."""
        assert self._process.pid is not None
        return self._process.pid

    def begin(self, job: Job) -> None:
        """Give it a job; its time counts from when it says that it began."""
        self.job, self._since = job, float("inf")
        with contextlib.suppress(OSError):  # it has died: the pipe will say so
            self.pipe.send(job)

    def began(self) -> None:
        """Start the clock of the job."""
        self._since = time.monotonic()

    def left(self) -> float | None:
        """Return the seconds that the job may still take; None = any."""
        if self._limits.seconds is None or self._since == float("inf"):
            return None
        return max(0.0, self._since + self._limits.seconds - time.monotonic())

    def where(self) -> str:
        """Return where in Python it crashed, or ask where it is at present; empty if it does not say."""
        if hasattr(signal, "SIGUSR1") and self._process.is_alive():
            os.kill(self.pid, signal.SIGUSR1)
            time.sleep(0.3)
        return self._trace.read_text(encoding="utf-8", errors="replace")

    def cause_of_death(self) -> str:
        """Return how the process ended."""
        self._process.join(GRACE)
        code = self._process.exitcode
        if code is None or code >= 0:
            return f"exit code {code}"
        return f"signal {signal.Signals(-code).name}"

    def ask_to_end(self) -> None:
        """Let it tidy up and end; `stop` sees to it that it does."""
        self._process.terminate()

    def stop(self) -> None:
        """End it: it may tidy up for a moment, then it is killed."""
        self.ask_to_end()
        self._process.join(GRACE)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self.pipe.close()
        self._trace.unlink(missing_ok=True)


def _work(pipe: Connection, memory: float | None, trace: str, parent: int) -> None:
    """Do jobs until the pipe is closed or the parent asks to end."""
    with contextlib.suppress(KeyboardInterrupt):
        _serve(pipe, memory, trace, parent)
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)  # taking the interpreter down in order lasts seconds


def _serve(pipe: Connection, memory: float | None, trace: str, parent: int) -> None:
    end_with(parent)
    file = Path(trace).open("w", encoding="utf-8")  # noqa: SIM115  open as long as the process lives
    faulthandler.enable(file)
    if hasattr(signal, "SIGUSR1"):
        faulthandler.register(signal.SIGUSR1, file=file)
    if memory is not None:
        _limit_memory(memory)
    scenarios = ScenarioCache()
    while True:
        try:
            job: Job = pipe.recv()
        except EOFError:
            return
        pipe.send(("begun",))
        if job.scenario is not None:
            scenarios.put(job.scenario)

        def progress(step: str, share: float) -> None:
            pipe.send(("progress", step, share))

        pipe.send(("done", attempt(job.experiment, job.out, scenarios, progress, concurrent=job.concurrent)))


def _limit_memory(limit: float) -> None:
    if sys.platform == "win32":
        return
    import resource

    resource.setrlimit(resource.RLIMIT_DATA, (int(limit), int(limit)))


@contextlib.contextmanager
def _environment(values: dict[str, str]) -> Iterator[None]:
    before: dict[str, Any] = {key: os.environ.get(key) for key in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for key, value in before.items():
            if value is None:
                del os.environ[key]
            else:
                os.environ[key] = value


@contextlib.contextmanager
def _ignore_sigint() -> Iterator[None]:
    """Let a process start so that Ctrl-C does not reach it before it can say how it takes it."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
