"""Worker processes that do many jobs, replaced after a crash or a time limit."""

from __future__ import annotations

import faulthandler
import math
import os
import threading
import time
import traceback
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal, TypeVar

from lirs_validation.processes import ChildProcess
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
TRACE_SECONDS = 0.3
"""Time after the limit in which a worker writes its traceback, seconds."""
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
        self._traces = TemporaryDirectory(prefix="lirs-wct-traces-")

    def __enter__(self) -> WorkerPool:
        return self

    def __exit__(self, *_: object) -> None:
        self._stop(self._workers)
        self._traces.cleanup()

    def run(
        self, jobs: Sequence[Job[T]], report: Report = lambda number, step, share: None
    ) -> Iterator[tuple[int, T | Failure]]:
        """Yield the number and the result of each job as it ends.

        An error of a job is raised. A job whose process dies is tried once more.
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
                idle = _Worker(Path(self._traces.name), self._seconds)
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
            worker.process.terminate()
        for worker in list(workers):
            self._workers.remove(worker)
            worker.end()


IDLE = -1
"""Number of no job."""


class _Worker(ChildProcess):
    """Process that does one job at a time.

    It sends `("begun",)`, then `("progress", step, share)` any number of times, then `("done", result)` or
    `("raised", error)`.

    Attributes:
        job: number of the present job.
    """

    def __init__(self, traces: Path, seconds: float | None) -> None:
        super().__init__(f"{__name__}:do_jobs", GRACE, env=os.environ | ONE_THREAD)
        self._trace, self._seconds = traces / f"{self.process.pid}", seconds
        self.job, self._deadline = IDLE, math.inf
        with suppress(OSError):  # it has died: the pipe will say so
            self.pipe.send((self._trace, seconds))

    @property
    def seconds_left(self) -> float:
        """Seconds left for the job, infinite without a limit."""
        return max(0.0, self._deadline - time.monotonic())

    def begin(self, number: int, job: Job[Any]) -> None:
        """Send a job. Its time starts with the message `begun`."""
        self.job, self._deadline = number, math.inf
        with suppress(OSError):
            self.pipe.send(job)

    def receive(self) -> tuple[Any, ...] | Failure:
        """Return the next message, or the failure of a dead or overdue process."""
        if self.seconds_left == 0.0:
            return self._failure("timeout", f"no end within the experiment's {self._seconds:g} s")
        try:
            message: tuple[Any, ...] = self.pipe.recv()
        except (EOFError, OSError):
            cause = self.cause_of_death()
            return self._failure("error", f"the process that ran it died {TRIES} times ({cause})")
        if message[0] == "begun" and self._seconds is not None:
            self._deadline = time.monotonic() + self._seconds + TRACE_SECONDS
        elif message[0] in ("done", "raised"):
            self.job = IDLE
        return message

    def _failure(self, status: Literal["error", "timeout"], reason: str) -> Failure:
        self.end()
        written = self._trace.is_file()
        return Failure(status, reason, self._trace.read_text(errors="replace") if written else "")


def do_jobs(pipe: Connection) -> None:
    """Do the jobs that a pool sends."""
    trace, seconds = pipe.recv()
    file = trace.open("w")
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
