"""Engines of a sweep: serial, or worker processes of this machine. Results do not depend on the engine."""

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
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, Protocol

from lirs_validation.experiment.scenario import Scenario, ScenarioCache
from lirs_validation.interrupts import end_with
from lirs_validation.sweep.experiment import Experiment, Outcome, attempt
from lirs_wct.errors import ConfigError
from lirs_wct.files import remove_leftovers, remove_orphans
from lirs_wct.progress import Progress

MOST_MEMORY = 1e18
"""Largest memory limit that the system accepts, bytes."""

ProgressOf = Callable[[str], Progress]
"""Function that returns the progress callback of an experiment by name."""
ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMBA")}
"""Environment of a worker: as many threads as workers, or they fight for the cores."""
GRACE = 3.0
"""Seconds that a worker has to clean up before it is killed."""
TRACE = "lirs-wct-trace-"
"""Prefix of the files with tracebacks of crashed workers."""
SPAWN = multiprocessing.get_context("spawn")
TRIES = 2
"""Processes that an experiment gets in all, if they die."""
LONGEST_WAIT = 3600.0
"""Seconds of one wait, at most; longer waits are not supported by the system."""


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Limits of an experiment's time and memory. A limit requires a separate process.

    Attributes:
        seconds: wall-clock time of a whole experiment; None = no limit.
        memory: private memory of its process, bytes; None = no limit.

    Raises:
        ConfigError: a limit is not above 0, or not finite.
    """

    seconds: float | None = None
    memory: float | None = None

    def __post_init__(self) -> None:
        if self.seconds is not None and not self.seconds > 0:
            raise ConfigError(f"the cell timeout must be above 0 s, got {self.seconds:g}")
        if self.memory is not None and not 0 < self.memory <= MOST_MEMORY:
            raise ConfigError(f"the cell's memory must be above 0 bytes, got {self.memory:g}")

    @property
    def any(self) -> bool:
        """Whether there is a limit at all."""
        return self.seconds is not None or self.memory is not None


class Executor(Protocol):
    """Interface of an engine: run each experiment at least once, yield one outcome each."""

    def run(self, experiments: Sequence[Experiment], out: Path, progress_of: ProgressOf) -> Iterator[Outcome]:
        """Run experiments into folders of `out`. The caller writes the outcomes of failures."""
        ...


class Serial:
    """Run one experiment after the other in this process; real-time factors are valid."""

    def run(self, experiments: Sequence[Experiment], out: Path, progress_of: ProgressOf) -> Iterator[Outcome]:
        """Run experiments into folders of `out`."""
        scenarios = ScenarioCache()
        for experiment in experiments:
            yield attempt(experiment, out, scenarios, progress_of(experiment.name), concurrent=False)


@dataclass(frozen=True)
class Job:
    """Job of a worker. A scenario that is already built saves its construction."""

    experiment: Experiment
    out: Path
    concurrent: bool
    scenario: Scenario | None = None


class Worker:
    """Worker process that runs one job at a time and can be killed.

    Its messages come through `pipe`: `("begun",)`, then `("progress", step, share)` any number of
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
        """Send a job to the worker. Its time starts with the message `begun`."""
        self.job, self._since = job, float("inf")
        with contextlib.suppress(OSError):  # it has died: the pipe will say so
            self.pipe.send(job)

    def began(self) -> None:
        """Start the clock of the job."""
        self._since = time.monotonic()

    def seconds_left(self) -> float | None:
        """Return the seconds left for the job; None = no limit."""
        if self._limits.seconds is None or self._since == float("inf"):
            return None
        return max(0.0, self._since + self._limits.seconds - time.monotonic())

    def where(self) -> str:
        """Return the traceback of the crash or of the present state, if any."""
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
        """Ask the process to clean up and end; `stop` enforces it."""
        self._process.terminate()

    def stop(self) -> None:
        """End the process: wait GRACE seconds for its cleanup, then kill it."""
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
    """Ignore Ctrl-C during a process start, until the process has its own handler."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@dataclass(frozen=True, kw_only=True)
class Processes:
    """Run experiments in separate processes, `jobs` at a time.

    A process that is killed, hangs or leaks costs only its own run.

    Attributes:
        jobs: number of concurrent runs; with one, real-time factors are valid as in `Serial`.
        limits: of an experiment.
        scenario: world that is already built.
        concurrent: whether other engines run at the same time.
    """

    jobs: int
    limits: Limits = field(default_factory=Limits)
    scenario: Scenario | None = None
    concurrent: bool = False

    def run(self, experiments: Sequence[Experiment], out: Path, progress_of: ProgressOf) -> Iterator[Outcome]:
        """Run experiments into folders of `out`."""
        pool = _Pool(self, experiments, out, progress_of)
        try:
            yield from pool.outcomes()
        finally:
            pool.stop()


class _Pool:
    """Workers of one sweep and their jobs."""

    def __init__(
        self, engine: Processes, experiments: Sequence[Experiment], out: Path, progress_of: ProgressOf
    ) -> None:
        self._engine, self._out, self._progress_of = engine, out, progress_of
        self._waiting = deque(experiments)
        self._tries: Counter[str] = Counter()
        self._workers: list[Worker] = []

    def outcomes(self) -> Iterator[Outcome]:
        """Yield each experiment's outcome as it ends."""
        while self._waiting or self._busy:
            self._hand_out()
            for worker in self._talking():
                outcome = self._listen(worker)
                if outcome is not None:
                    yield outcome
            for worker in [w for w in self._busy if w.seconds_left() == 0.0]:
                yield self._give_up(worker)

    def stop(self) -> None:
        """End all processes; they clean up concurrently."""
        for worker in self._workers:
            worker.ask_to_end()
        while self._workers:
            self._dismiss(self._workers[-1])

    @property
    def _busy(self) -> list[Worker]:
        return [worker for worker in self._workers if worker.job is not None]

    def _hand_out(self) -> None:
        """Give every idle worker an experiment; start workers while there are too few."""
        while self._waiting and len(self._busy) < self._engine.jobs:
            idle = [worker for worker in self._workers if worker.job is None]
            if not idle:
                idle.append(Worker(self._engine.limits))
                self._workers.append(idle[0])
            concurrent = self._engine.concurrent or self._engine.jobs > 1
            idle[0].begin(Job(self._waiting.popleft(), self._out, concurrent, self._engine.scenario))

    def _talking(self) -> list[Worker]:
        """Wait until a worker sends a message, dies or exceeds its time; return those ready."""
        left = [seconds for w in self._busy if (seconds := w.seconds_left()) is not None]
        ready = wait([w.pipe for w in self._busy], min([*left, LONGEST_WAIT]))
        return [worker for worker in self._busy if worker.pipe in ready]

    def _listen(self, worker: Worker) -> Outcome | None:
        assert worker.job is not None
        name = worker.job.experiment.name
        try:
            message = worker.pipe.recv()
        except (EOFError, OSError):
            return self._handle_crash(worker)
        match message:
            case ("begun",):
                worker.began()
            case ("progress", step, share):
                self._progress_of(name)(step, share)
            case ("done", Outcome() as outcome):
                worker.job = None
                if outcome.status == "error":  # frees leaked memory
                    self._dismiss(worker)
                return outcome
        return None

    def _handle_crash(self, worker: Worker) -> Outcome | None:
        """Retry the experiment of a dead worker, or return its failure."""
        assert worker.job is not None
        experiment, cause, trace = worker.job.experiment, worker.cause_of_death(), worker.where()
        self._dismiss(worker)
        self._tries[experiment.name] += 1
        if self._tries[experiment.name] < TRIES:
            self._waiting.appendleft(experiment)
            return None
        reason = f"the process that ran it died {TRIES} times ({cause})"
        return Outcome(experiment=experiment.name, status="error", reason=reason, trace=trace)

    def _give_up(self, worker: Worker) -> Outcome:
        assert worker.job is not None
        experiment, trace = worker.job.experiment, worker.where()
        self._dismiss(worker)
        reason = f"no end within the experiment's {self._engine.limits.seconds:g} s"
        return Outcome(experiment=experiment.name, status="timeout", reason=reason, trace=trace)

    def _dismiss(self, worker: Worker) -> None:
        self._workers.remove(worker)
        worker.stop()
        if worker.job is not None:
            remove_leftovers([self._out / worker.job.experiment.name])
