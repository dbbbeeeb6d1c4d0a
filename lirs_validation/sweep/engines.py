"""Engines of a sweep: worker processes of this machine, or a Ray cluster; results do not depend on them.

On a cluster only this process writes the results. A task whose worker dies is run again elsewhere (at least
once); its result is written once.
"""

from __future__ import annotations

import logging
import os
import socket
import tempfile
import warnings
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lirs_validation.config import EngineOptions, RunConfig
from lirs_validation.experiment.scenario import Scenario, ScenarioCache, build_scenario
from lirs_validation.processes import importable
from lirs_validation.sweep.sweep import Executor, Outcome, ProgressOf, Serial, SweepTask, outcome_of
from lirs_validation.sweep.workers import ONE_THREAD, Failure, WorkerPool
from lirs_wct.errors import ConfigError
from lirs_wct.files import atomic_folder, remove_leftovers
from lirs_wct.progress import Progress, no_progress


def make_executor(options: EngineOptions) -> Executor:
    """Make a Ray cluster, processes for jobs or a time limit, or `Serial`."""
    if options.address is not None:
        return RayCluster(address=options.address, jobs=options.jobs, seconds=options.cell_timeout)
    if options.jobs in (None, 1) and options.cell_timeout is None:
        return Serial()
    return Processes(jobs=options.jobs or 1, seconds=options.cell_timeout)


_SCENARIOS = ScenarioCache()
"""Worlds of a worker process."""


@dataclass(frozen=True)
class TaskJob:
    """Job of a worker. A scenario that is already built saves its construction."""

    task: SweepTask
    out: Path
    concurrent: bool
    scenario: Scenario | None = None

    def __call__(self, progress: Progress) -> Outcome:
        """Run the task."""
        if self.scenario is not None:
            _SCENARIOS.put(self.scenario)
        return self.task.attempt(self.out, _SCENARIOS, progress, concurrent=self.concurrent)


@dataclass(frozen=True, kw_only=True)
class Processes:
    """Run tasks in separate processes, `jobs` at a time.

    A process that is killed or hangs costs only its own run.

    Attributes:
        jobs: Number of concurrent runs; with one, real-time factors are valid as in `Serial`.
        seconds: Wall-clock time of a whole task; None = no limit.
        scenario: Scenario that is already built.
        concurrent: Whether other engines run at the same time.
    """

    jobs: int
    seconds: float | None = None
    scenario: Scenario | None = None
    concurrent: bool = False

    def run(self, tasks: Sequence[SweepTask], out: Path, progress_of: ProgressOf) -> Iterator[Outcome]:
        """Run tasks into folders of `out`."""
        names = [task.name for task in tasks]
        concurrent = self.concurrent or self.jobs > 1
        jobs = [TaskJob(task, out, concurrent, self.scenario) for task in tasks]

        def report(number: int, step: str, share: float) -> None:
            progress_of(names[number])(step, share)

        try:
            with WorkerPool(self.jobs, self.seconds) as pool:
                for number, outcome in pool.run(jobs, report):
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
        """Run tasks into folders of `out`.

        Raises:
            ConfigError: Ray is not installed, or no cluster answers at the address.
        """
        with ray_session(self.address, self.jobs) as ray:
            before = _machines(ray)
            for outcome in self._outcomes(ray, tasks, out):
                progress_of(outcome.task)("evaluate", 1.0)
                yield outcome
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
            job = TaskJob(task, out, concurrent=True, scenario=scenario)
            outcome = job(no_progress)
        folder = out / task.name
        files = {p.name: p.read_bytes() for p in folder.iterdir()} if folder.is_dir() else {}
    return outcome, files


@contextmanager
def ray_session(address: str, jobs: int | None = None) -> Iterator[Any]:
    """Connect to Ray for a `with` block. An existing cluster keeps running."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    if address != LOCAL:
        _show_token()
    try:
        import ray
    except ImportError as error:
        raise ConfigError("--address needs Ray: pip install '.[dist]'") from error
    if ray.is_initialized():
        yield ray
        return
    _probe_address(address)
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
    try:
        ray.init(
            address=address,
            **(own if address == LOCAL else {}),
            runtime_env={"env_vars": ONE_THREAD},
            log_to_driver=False,
            logging_level=logging.ERROR,
        )
    except (ConnectionError, ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split())
        raise ConfigError(f"--address {address}: no Ray cluster answers there: {reason}") from error


def _probe_address(address: str) -> None:
    """Connect once to the address: Ray itself would try for minutes."""
    host, _, port = address.rpartition("://")[2].rpartition(":")
    if not port.isdigit():
        return  # `local`, `auto`
    try:
        socket.create_connection((host, int(port)), timeout=PATIENCE).close()
    except OSError as error:
        raise ConfigError(f"--address {address}: no Ray cluster answers there: {error}") from error


def _show_token() -> None:
    """Use Ray's token if this machine has one. Ray reads it at import."""
    if any(name in os.environ for name in ("RAY_AUTH_TOKEN", "RAY_AUTH_TOKEN_PATH")) or TOKEN.exists():
        os.environ.setdefault("RAY_AUTH_MODE", "token")
