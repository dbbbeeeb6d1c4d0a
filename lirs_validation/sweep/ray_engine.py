"""Engine of a cluster: Ray runs the experiments, and only this process writes the results.

An experiment whose worker dies is run again elsewhere (at least once); its result is written once.
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

from lirs_validation.config import RunConfig
from lirs_validation.experiment.loading import importable
from lirs_validation.experiment.scenario import Scenario, build_scenario
from lirs_validation.sweep.engines import ExperimentJob, Processes, ProgressOf
from lirs_validation.sweep.experiment import Experiment, Outcome, outcome_of
from lirs_validation.sweep.workers import ONE_THREAD
from lirs_wct.errors import ConfigError
from lirs_wct.files import atomic_folder
from lirs_wct.progress import no_progress

LOCAL = "local"
"""Address of a cluster that this program starts on this machine, and stops after the sweep."""
RETRIES = 3
"""Retries of an experiment after the death of its worker."""
AHEAD = 2
"""Experiments handed to Ray for each of its cores: enough to keep it busy, few enough to stay small."""
PATIENCE = 5.0
"""Timeout of the connection to a cluster, seconds."""
TOKEN = Path.home() / ".ray" / "auth_token"

Files = dict[str, bytes]


@dataclass(frozen=True, kw_only=True)
class RayCluster:
    """Run experiments on a Ray cluster whose machines have this package.

    Attributes:
        address: address of the cluster, or `local`.
        jobs: concurrent experiments on a local cluster; None = one per core that Ray finds.
        seconds: wall-clock time of a whole experiment; None = no limit.
    """

    address: str
    jobs: int | None = None
    seconds: float | None = None

    def run(self, experiments: Sequence[Experiment], out: Path, progress_of: ProgressOf) -> Iterator[Outcome]:
        """Run experiments into folders of `out`.

        Raises:
            ConfigError: Ray is not installed, or no cluster answers at the address.
        """
        with ray_session(self.address, self.jobs) as ray:
            before = _machines(ray)
            for experiment, outcome in self._outcomes(ray, experiments, out):
                progress_of(experiment.name)("evaluate", 1.0)
                yield outcome
            if lost := before - _machines(ray):
                warnings.warn(
                    f"{len(lost)} of {len(before)} machines of the cluster were lost; others did their runs",
                    stacklevel=2,
                )

    def _outcomes(
        self, ray: Any, experiments: Sequence[Experiment], out: Path
    ) -> Iterator[tuple[Experiment, Outcome]]:
        perform = ray.remote(num_cpus=1, max_retries=RETRIES)(perform_remotely)
        room = AHEAD * max(1, int(ray.cluster_resources().get("CPU", 1)))
        waiting, lost = deque(experiments), Counter[str]()
        running, worlds = dict[Any, Experiment](), dict[Any, Any]()
        while waiting or running:
            while waiting and len(running) < room:
                experiment = waiting.popleft()
                try:
                    scenario = _send_world(ray, experiment.world_config, worlds)
                except Exception as error:
                    yield experiment, outcome_of(error, experiment.name)
                else:
                    task = perform.remote(experiment, scenario, self.seconds, str(Path.cwd()))
                    running[task] = experiment
            for task in ray.wait(list(running), timeout=1.0)[0]:
                experiment = running.pop(task)
                outcome, is_lost = _collect(ray, task, experiment.name, out)
                lost[experiment.name] += is_lost
                if is_lost and lost[experiment.name] <= RETRIES:
                    worlds.clear()
                    waiting.append(experiment)
                else:
                    yield experiment, outcome


def _collect(ray: Any, task: Any, name: str, out: Path) -> tuple[Outcome, bool]:
    """Write a task's folder; return its outcome, and whether its data were lost.

    Ray itself repeats dead tasks, not those whose data lay on a lost machine.
    """
    try:
        outcome, files = ray.get(task)
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

    Experiments come world by world: Ray frees the one before after its last experiment.

    Raises:
        WctError: the world cannot be built.
    """
    if config is None:
        return None
    key = (config.source, config.build)
    if key not in sent:
        sent.clear()
        sent[key] = ray.put(build_scenario(config))
    return sent[key]


def perform_remotely(
    experiment: Experiment, scenario: Scenario | None, seconds: float | None, here: str
) -> tuple[Outcome, Files]:
    """Run an experiment on a machine of the cluster; return the files that it wrote."""
    with suppress(OSError):
        os.chdir(here)  # a mapper of your own lies there, where the machines share a file system
    with tempfile.TemporaryDirectory(prefix="lirs-wct-") as temporary, importable(Path(here)):
        out = Path(temporary)
        if seconds is not None:
            engine = Processes(jobs=1, seconds=seconds, scenario=scenario, concurrent=True)
            outcome = next(engine.run([experiment], out, lambda name: no_progress))
        else:
            job = ExperimentJob(experiment, out, concurrent=True, scenario=scenario)
            outcome = job(no_progress)
        folder = out / experiment.name
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
    """Connect to the cluster at an address, or start one.

    Raises:
        ConfigError: none answers there.
    """
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
    """Connect once to the address: Ray itself would try for minutes.

    Raises:
        ConfigError: nothing answers there.
    """
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
