"""Worker processes: each does many jobs, and is replaced after a crash or a time limit."""

from __future__ import annotations

import contextlib
import faulthandler
import math
import multiprocessing
import os
import signal
import sys
import tempfile
import threading
import time
import traceback
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, Literal, TypeVar

from lirs_validation.interrupts import end_with
from lirs_wct.files import remove_orphans
from lirs_wct.progress import Progress

T = TypeVar("T")
Job = Callable[[Progress], T]
"""Function that can be sent to a process and does the work there."""
Report = Callable[[int, str, float], None]
"""Function that receives a job's number, step and share."""
ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMBA")}
"""Environment of a worker: as many threads as workers, or they fight for the cores."""
GRACE = 3.0
"""Seconds that a worker has to clean up before it is killed."""
TRACE = "lirs-wct-trace-"
"""Prefix of the files with tracebacks of crashed workers."""
TRACE_SECONDS = 0.3
"""Time after the limit in which a worker writes its traceback, seconds."""
SPAWN = multiprocessing.get_context("spawn")
TRIES = 2
"""Processes that a job gets in all, if they die."""
LONGEST_WAIT = 3600.0
"""Seconds of one wait, at most; longer waits are not supported by the system."""


@dataclass(frozen=True)
class Failure:
    """End of a job whose process died or exceeded its time.

    Attributes:
        status: status of a run that ended so.
        reason: one line.
        trace: traceback of the process, as far as there is one.
    """

    status: Literal["error", "timeout"]
    reason: str
    trace: str


class WorkerPool:
    """Processes for the jobs of one caller; a `with` block ends them.

    Args:
        size: number of processes at a time.
        seconds: wall-clock time of a job; None = no limit.
    """

    def __init__(self, size: int, seconds: float | None = None) -> None:
        self._size, self._seconds = size, seconds
        self._workers: list[_Worker] = []

    def __enter__(self) -> WorkerPool:
        return self

    def __exit__(self, *_: object) -> None:
        self._stop(self._workers)

    def run(
        self, jobs: Sequence[Job[T]], report: Report = lambda number, step, share: None
    ) -> Iterator[tuple[int, T | Failure]]:
        """Yield the number and the result of each job as it ends; an error of a job is raised.

        A job whose process dies is tried once more.
        """
        waiting, tries = deque(range(len(jobs))), Counter[int]()
        try:
            while waiting or self._busy:
                self._hand_out(waiting, jobs)
                for worker in self._ready():
                    number = worker.job
                    match worker.receive():
                        case ("progress", step, share):
                            report(number, step, share)
                        case ("done", value):
                            yield number, value
                        case ("raised", error):
                            raise error
                        case Failure() as failure:
                            self._workers.remove(worker)
                            tries[number] += 1
                            if failure.status == "error" and tries[number] < TRIES:
                                waiting.appendleft(number)
                            else:
                                yield number, failure
        finally:
            self._stop(self._busy)

    @property
    def _busy(self) -> list[_Worker]:
        return [worker for worker in self._workers if worker.job != IDLE]

    def _hand_out(self, waiting: deque[int], jobs: Sequence[Job[Any]]) -> None:
        """Give every idle worker a job; start workers while there are too few."""
        while waiting and len(self._busy) < self._size:
            idle = next((worker for worker in self._workers if worker.job == IDLE), None)
            if idle is None:
                idle = _Worker(self._seconds)
                self._workers.append(idle)
            number = waiting.popleft()
            idle.begin(number, jobs[number])

    def _ready(self) -> list[_Worker]:
        """Wait until a worker sends a message, dies or exceeds its time; return those."""
        busy = self._busy
        pipes = wait([w.pipe for w in busy], min([LONGEST_WAIT, *(w.seconds_left for w in busy)]))
        return [worker for worker in busy if worker.pipe in pipes or worker.seconds_left == 0.0]

    def _stop(self, workers: Sequence[_Worker]) -> None:
        """End processes; they clean up concurrently."""
        for worker in workers:
            worker.ask_to_end()
        for worker in list(workers):
            self._workers.remove(worker)
            worker.stop()


IDLE = -1
"""Number of no job."""


class _Worker:
    """Process that does one job at a time.

    It sends `("begun",)`, then `("progress", step, share)` any number of times, then `("done", result)` or
    `("raised", error)`.

    Attributes:
        pipe: connection to the process.
        job: number of the present job.
    """

    def __init__(self, seconds: float | None) -> None:
        remove_orphans(Path(tempfile.gettempdir()), TRACE)
        file, name = tempfile.mkstemp(prefix=f"{TRACE}{os.getpid()}-", suffix=".trace")
        os.close(file)
        self._trace, self._seconds = Path(name), seconds
        self.pipe, far = SPAWN.Pipe()
        self.job, self._deadline = IDLE, math.inf
        self._process = SPAWN.Process(target=_work, args=(far, name, os.getpid(), seconds), daemon=True)
        with _one_thread(), _ignore_sigint():
            self._process.start()
        far.close()

    @property
    def seconds_left(self) -> float:
        """Seconds left for the job, infinite without a limit."""
        return max(0.0, self._deadline - time.monotonic())

    def begin(self, number: int, job: Job[Any]) -> None:
        """Send a job. Its time starts with the message `begun`."""
        self.job, self._deadline = number, math.inf
        with contextlib.suppress(OSError):  # it has died: the pipe will say so
            self.pipe.send(job)

    def receive(self) -> tuple[Any, ...] | Failure:
        """Return the next message, or the failure of a process that died or exceeded its time."""
        if self.seconds_left == 0.0:
            reason = f"no end within the experiment's {self._seconds:g} s"
            return Failure("timeout", reason, self.stop())
        try:
            message: tuple[Any, ...] = self.pipe.recv()
        except (EOFError, OSError):
            reason = f"the process that ran it died {TRIES} times ({self._cause_of_death()})"
            return Failure("error", reason, self.stop())
        if message[0] == "begun" and self._seconds is not None:
            self._deadline = time.monotonic() + self._seconds + TRACE_SECONDS
        elif message[0] in ("done", "raised"):
            self.job = IDLE
        return message

    def _cause_of_death(self) -> str:
        self._process.join(GRACE)
        code = self._process.exitcode
        if code is None or code >= 0:
            return f"exit code {code}"
        return f"signal {signal.Signals(-code).name}"

    def ask_to_end(self) -> None:
        """Ask the process to clean up and end; `stop` enforces it."""
        self._process.terminate()

    def stop(self) -> str:
        """End the process: wait GRACE seconds for its cleanup, then kill it; return its traceback."""
        self.ask_to_end()
        self._process.join(GRACE)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self.pipe.close()
        trace = self._trace.read_text(encoding="utf-8", errors="replace")
        self._trace.unlink()
        return trace


def _work(pipe: Connection, trace: str, parent: int, seconds: float | None) -> None:
    """Do jobs until the pipe is closed or the parent asks to end."""
    with contextlib.suppress(KeyboardInterrupt, EOFError):
        _serve(pipe, trace, parent, seconds)
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)  # taking the interpreter down in order lasts seconds


def _serve(pipe: Connection, trace: str, parent: int, seconds: float | None) -> None:
    end_with(parent)
    file = Path(trace).open("w", encoding="utf-8")  # noqa: SIM115  open as long as the process lives
    faulthandler.enable(file)
    while True:
        job: Job[Any] = pipe.recv()
        pipe.send(("begun",))
        if seconds is not None:
            faulthandler.dump_traceback_later(min(max(seconds, 1e-3), threading.TIMEOUT_MAX), file=file)
        try:
            message = ("done", job(lambda step, share: pipe.send(("progress", step, share))))
        except Exception as error:
            error.add_note("".join(traceback.format_exception(error)))
            message = ("raised", error)
        faulthandler.cancel_dump_traceback_later()
        pipe.send(message)


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    """Let processes that start in a block have one thread each."""
    before = {name: os.environ[name] for name in ONE_THREAD if name in os.environ}
    os.environ.update(ONE_THREAD)
    try:
        yield
    finally:
        for name in ONE_THREAD:
            del os.environ[name]
        os.environ.update(before)


@contextlib.contextmanager
def _ignore_sigint() -> Iterator[None]:
    """Ignore Ctrl-C during a process start, until the process has its own handler."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
