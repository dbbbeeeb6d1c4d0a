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
"""Bytes that the system can be asked to keep a process below."""

ProgressOf = Callable[[str], Progress]
"""Gives each experiment, by its name, the progress of its own work."""
ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMBA")}
"""Environment of a worker: as many threads as workers, or they fight for the cores."""
GRACE = 3.0
"""Seconds that a worker is given to tidy up before it is killed."""
TRACE = "lirs-wct-trace-"
"""Beginning of the names of the files in which workers say where they crashed."""
SPAWN = multiprocessing.get_context("spawn")
TRIES = 2
"""An experiment whose process dies is given another one; not a third."""
LONGEST_WAIT = 3600.0
"""Seconds; the system cannot wait for weeks."""


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What an experiment may use before it is stopped; a limit needs a process of its own.

    Attributes:
        seconds: wall-clock time of a whole experiment; None = any.
        memory: private memory of its process, bytes; None = any.

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
    """Runs experiments, each at least once, and yields one outcome for each, as it ends."""

    def run(self, experiments: Sequence[Experiment], out: Path, progress_of: ProgressOf) -> Iterator[Outcome]:
        """Run experiments into folders of `out`; failures are outcomes, which the caller writes."""
        ...


class Serial:
    """One experiment after the other in this process: nothing beside it, so its real-time factors count."""

    def run(self, experiments: Sequence[Experiment], out: Path, progress_of: ProgressOf) -> Iterator[Outcome]:
        """Run experiments into folders of `out`."""
        scenarios = ScenarioCache()
        for experiment in experiments:
            yield attempt(experiment, out, scenarios, progress_of(experiment.name), concurrent=False)


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


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@dataclass(frozen=True, kw_only=True)
class Processes:
    """Experiments in processes of their own, `jobs` at a time.

    Attributes:
        jobs: how many at a time; with one, its real-time factors count as those of `Serial` do.
        limits: of an experiment.
        scenario: a world that was built elsewhere.
        concurrent: whether others work beside this engine too.
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
    """The workers of one sweep and what each of them is at."""

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
            for worker in [w for w in self._busy if w.left() == 0.0]:
                yield self._give_up(worker)

    def stop(self) -> None:
        """End every process; they tidy up beside each other."""
        for worker in self._workers:
            worker.ask_to_end()
        while self._workers:
            self._dismiss(self._workers[-1])

    @property
    def _busy(self) -> list[Worker]:
        return [worker for worker in self._workers if worker.job is not None]

    def _hand_out(self) -> None:
        """Give every idle worker an experiment, and make workers while there are too few."""
        while self._waiting and len(self._busy) < self._engine.jobs:
            idle = [worker for worker in self._workers if worker.job is None]
            if not idle:
                idle.append(Worker(self._engine.limits))
                self._workers.append(idle[0])
            concurrent = self._engine.concurrent or self._engine.jobs > 1
            idle[0].begin(Job(self._waiting.popleft(), self._out, concurrent, self._engine.scenario))

    def _talking(self) -> list[Worker]:
        """Wait until a worker speaks or dies, or until one's time is over."""
        left = [seconds for w in self._busy if (seconds := w.left()) is not None]
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
                if outcome.status == "error":  # what it leaked goes with it
                    self._dismiss(worker)
                return outcome
        return None

    def _handle_crash(self, worker: Worker) -> Outcome | None:
        """Give the experiment of a dead worker to another one, or give it up."""
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
