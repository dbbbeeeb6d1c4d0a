"""Engines of a sweep: worker processes of this machine, or a Ray cluster.

Results do not depend on them. A worker process does many jobs, and is replaced after a crash or a time limit.
On a cluster only this process writes the results; a task whose worker dies is run again elsewhere.
"""

from __future__ import annotations

import faulthandler
import logging
import math
import os
import socket
import tempfile
import threading
import time
import traceback
import warnings
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property, partial
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, Literal, TypeVar

from lirs_validation.config import RunConfig
from lirs_validation.experiment.scenario import Scenario, ScenarioCache, build_scenario
from lirs_validation.processes import ChildProcess, importable
from lirs_validation.sweep.sweep import Outcome, ProgressOf, SweepTask, outcome_of
from lirs_wct import ConfigError, Progress, no_progress
from lirs_wct.files import atomic_folder, remove_leftovers

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
    """End of a job whose process died or exceeded its time."""

    status: Literal["error", "timeout"]
    reason: str
    trace: str


class WorkerPool:
    """Processes for jobs of at most `seconds` each; a `with` block ends them."""

    def __init__(self, size: int, seconds: float | None = None) -> None:
        self._size, self._seconds = size, seconds
        self._workers: list[_Worker] = []
        self._traces = tempfile.TemporaryDirectory(prefix="lirs-wct-traces-")

    def __enter__(self) -> WorkerPool:
        return self

    def __exit__(self, *_: object) -> None:
        self._stop(self._workers)
        self._traces.cleanup()

    def run(
        self, jobs: Sequence[Job[T]], report: Report = lambda number, step, share: None
    ) -> Generator[tuple[int, T | Failure]]:
        """Yield the number and the result of each job as it ends.

        An error of a job is raised. A job whose process dies is tried once more.
        """
        waiting, tries = deque(range(len(jobs))), Counter[int]()
        try:
            while waiting or self._busy:
                self._hand_out(waiting, jobs)
                busy = self._busy
                left = min([LONGEST_WAIT, *(worker.seconds_left for worker in busy)])
                pipes = wait([worker.pipe for worker in busy], left)
                for worker in busy:
                    if worker.pipe not in pipes and worker.seconds_left > 0.0:
                        continue
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


_SCENARIOS = ScenarioCache()
"""Worlds of a worker process."""


def do_task(
    task: SweepTask, out: Path, concurrent: bool, scenario: Scenario | None, progress: Progress
) -> Outcome:
    """Run a task, in a scenario that is already built if there is one."""
    if scenario is not None:
        _SCENARIOS.put(scenario)
    return task.attempt(out, _SCENARIOS, progress, concurrent=concurrent)


@dataclass(frozen=True, kw_only=True)
class Processes:
    """Run tasks in separate processes, `jobs` at a time.

    A process that is killed or hangs costs only its own run. Idle ones wait for further tasks.

    Attributes:
        jobs: Number of concurrent runs; with one, real-time factors are valid as in `Serial`.
        seconds: Wall-clock time of a whole task; None = no limit.
    """

    jobs: int
    seconds: float | None = None
    scenario: Scenario | None = None
    concurrent: bool = False

    @cached_property
    def _pool(self) -> WorkerPool:
        return WorkerPool(self.jobs, self.seconds)

    def run(self, tasks: Sequence[SweepTask], out: Path, progress_of: ProgressOf) -> Iterator[Outcome]:
        """Run tasks into folders of `out`."""
        names = [task.name for task in tasks]
        concurrent = self.concurrent or self.jobs > 1
        jobs = [partial(do_task, task, out, concurrent, self.scenario) for task in tasks]

        def report(number: int, step: str, share: float) -> None:
            progress_of(names[number])(step, share)

        try:
            with closing(self._pool.run(jobs, report)) as results:
                for number, outcome in results:
                    if isinstance(outcome, Failure):
                        yield Outcome(task=names[number], **vars(outcome))
                    else:
                        yield outcome
        finally:
            remove_leftovers(out / name for name in names)


LOCAL = "local"
"""Address of a cluster that this program starts on this machine, and stops after the sweep."""
RETRIES = 3
"""Retries of a task after the death of its worker."""
AHEAD = 2
"""Tasks handed to Ray for each of its cores: enough to keep it busy, few enough to stay small."""
PATIENCE = 5.0
"""Timeout of the connection to a cluster, seconds."""
TOKEN = Path.home() / ".ray" / "auth_token"

Files = dict[str, bytes]


@dataclass(frozen=True, kw_only=True)
class RayCluster:
    """Run tasks on a Ray cluster whose machines have this package.

    Attributes:
        address: Address of the cluster, or `local`.
        jobs: Concurrent tasks on a local cluster; None = one per core that Ray finds.
        seconds: Wall-clock time of a whole task; None = no limit.
    """

    address: str
    jobs: int | None = None
    seconds: float | None = None

    def run(self, tasks: Sequence[SweepTask], out: Path, progress_of: ProgressOf) -> Iterator[Outcome]:
        """Run tasks into folders of `out`."""
        with ray_session(self.address, self.jobs) as ray:
            before = _machines(ray)
            yield from self._outcomes(ray, tasks, out)
            if lost := before - _machines(ray):
                warnings.warn(
                    f"{len(lost)} of {len(before)} machines of the cluster were lost; others did their runs",
                    stacklevel=2,
                )

    def _outcomes(self, ray: Any, tasks: Sequence[SweepTask], out: Path) -> Iterator[Outcome]:
        perform = ray.remote(num_cpus=1, max_retries=RETRIES)(perform_remotely)
        room = AHEAD * max(1, int(ray.cluster_resources().get("CPU", 1)))
        waiting, lost = deque(tasks), Counter[str]()
        running, worlds = dict[Any, SweepTask](), dict[Any, Any]()
        while waiting or running:
            while waiting and len(running) < room:
                task = waiting.popleft()
                try:
                    scenario = _send_world(ray, task.world_config, worlds)
                except Exception as error:
                    yield outcome_of(error, task.name)
                else:
                    running[perform.remote(task, scenario, self.seconds, str(Path.cwd()))] = task
            for reference in ray.wait(list(running), timeout=1.0)[0]:
                task = running.pop(reference)
                outcome, is_lost = _collect(ray, reference, task.name, out)
                lost[task.name] += is_lost
                if is_lost and lost[task.name] <= RETRIES:
                    worlds.clear()
                    waiting.append(task)
                else:
                    yield outcome


def _collect(ray: Any, reference: Any, name: str, out: Path) -> tuple[Outcome, bool]:
    """Write a task's folder; return its outcome, and whether its data were lost.

    Ray itself repeats dead tasks, not those whose data lay on a lost machine.
    """
    try:
        outcome, files = ray.get(reference)
        if files:
            with atomic_folder(out / name) as folder:
                for file, data in files.items():
                    (folder / file).write_bytes(data)
    except Exception as error:
        return outcome_of(error, name), isinstance(error, ray.exceptions.ObjectLostError)
    return outcome, False


def _machines(ray: Any) -> set[str]:
    """Return the ids of the machines that are alive."""
    return {node["NodeID"] for node in ray.nodes() if node["Alive"]}


def _send_world(ray: Any, config: RunConfig | None, sent: dict[Any, Any]) -> Any:
    """Return Ray's reference to the scenario of a config; None without a config.

    Tasks come world by world: Ray frees the one before after its last task.
    """
    if config is None:
        return None
    key = (config.source, config.build)
    if key not in sent:
        sent.clear()
        sent[key] = ray.put(build_scenario(config))
    return sent[key]


def perform_remotely(
    task: SweepTask, scenario: Scenario | None, seconds: float | None, here: str
) -> tuple[Outcome, Files]:
    """Run a task on a machine of the cluster; return the files that it wrote."""
    with suppress(OSError):
        os.chdir(here)  # a mapper of your own lies there, where the machines share a file system
    with tempfile.TemporaryDirectory(prefix="lirs-wct-") as temporary, importable(Path(here)):
        out = Path(temporary)
        if seconds is not None:
            engine = Processes(jobs=1, seconds=seconds, scenario=scenario, concurrent=True)
            outcome = next(engine.run([task], out, lambda name: no_progress))
        else:
            outcome = do_task(task, out, True, scenario, no_progress)
        folder = out / task.name
        files = {p.name: p.read_bytes() for p in folder.iterdir()} if folder.is_dir() else {}
    return outcome, files


@contextmanager
def ray_session(address: str, jobs: int | None = None) -> Iterator[Any]:
    """Connect to Ray for a `with` block. An existing cluster keeps running."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    named = any(name in os.environ for name in ("RAY_AUTH_TOKEN", "RAY_AUTH_TOKEN_PATH"))
    if address != LOCAL and (named or TOKEN.exists()):
        os.environ.setdefault("RAY_AUTH_MODE", "token")  # read at Ray's import
    try:
        import ray
    except ImportError as error:
        raise ConfigError("--address needs Ray: pip install 'lirs-wct[dist]'") from error
    if ray.is_initialized():
        yield ray
        return
    # Ray has no public switch for this: a lost machine's state (60 lines) would go to the terminal.
    ray._private.worker._worker_logs_enabled = False
    _connect(ray, address, jobs)
    try:
        yield ray
    finally:
        ray.shutdown()


def _connect(ray: Any, address: str, jobs: int | None) -> None:
    """Connect to the cluster at an address, or start one."""
    own: dict[str, Any] = {"num_cpus": jobs, "include_dashboard": False}
    host, _, port = address.rpartition("://")[2].rpartition(":")
    try:
        if port.isdigit():  # Ray itself would try for minutes
            socket.create_connection((host, int(port)), timeout=PATIENCE).close()
        ray.init(
            address=address,
            **(own if address == LOCAL else {}),
            runtime_env={"env_vars": ONE_THREAD},
            log_to_driver=False,
            logging_level=logging.ERROR,
        )
    except (OSError, ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split())
        raise ConfigError(f"--address {address}: no Ray cluster answers there: {reason}") from error
