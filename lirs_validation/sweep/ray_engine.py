"""Engine of a cluster: Ray runs the experiments, and only this process writes the results.

An experiment whose worker dies is run again elsewhere (at least once); its result is written once.
"""

from __future__ import annotations

import logging
import os
import socket
import tempfile
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lirs_validation.config import RunConfig
from lirs_validation.experiment.own_code import importable
from lirs_validation.experiment.scenario import Scenario, ScenarioCache, build_scenario
from lirs_validation.sweep.engines import ONE_THREAD, Limits, Processes, ProgressOf, cores
from lirs_validation.sweep.experiment import Experiment, Outcome, attempt, outcome_of
from lirs_wct.errors import ConfigError, OutputError
from lirs_wct.files import atomic_folder
from lirs_wct.progress import no_progress

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
        address: of the cluster; None = start one on this machine, and stop it after the sweep.
        jobs: concurrent experiments on a local cluster; None = one per core.
        limits: of an experiment.
    """

    address: str | None = None
    jobs: int | None = None
    limits: Limits = field(default_factory=Limits)

    def run(self, experiments: Sequence[Experiment], out: Path, progress_of: ProgressOf) -> Iterator[Outcome]:
        """Run experiments into folders of `out`.

        Raises:
            ConfigError: Ray is not installed, or no cluster answers at the address.
        """
        with ray_session(self.address, self.jobs) as ray:
            before = _machines(ray)
            yield from _Flight(ray, self.limits).outcomes(experiments, out, progress_of)
            if lost := before - _machines(ray):
                warnings.warn(
                    f"{len(lost)} of {len(before)} machines of the cluster were lost; others did their runs",
                    stacklevel=2,
                )


def _machines(ray: Any) -> set[str]:
    """Return the ids of the machines that are alive."""
    return {node["NodeID"] for node in ray.nodes() if node["Alive"]}


class _Flight:
    """Experiments that Ray is running or holds in its queue."""

    def __init__(self, ray: Any, limits: Limits) -> None:
        self._ray, self._limits = ray, limits
        self._perform = ray.remote(num_cpus=1, max_retries=RETRIES)(perform_remotely)
        self._room = AHEAD * max(1, int(ray.cluster_resources().get("CPU", 1)))
        self._scenarios: dict[Any, Any] = {}
        self._flying: dict[Any, Experiment] = {}
        self._lost: Counter[str] = Counter()

    def outcomes(
        self, experiments: Sequence[Experiment], out: Path, progress_of: ProgressOf
    ) -> Iterator[Outcome]:
        waiting = list(reversed(experiments))
        while waiting or self._flying:
            while waiting and len(self._flying) < self._room:
                experiment = waiting.pop()
                try:
                    self._start(experiment)
                except Exception as error:
                    yield outcome_of(error, experiment.name)
            for done in self._ray.wait(list(self._flying), timeout=1.0)[0]:
                experiment = self._flying.pop(done)
                try:
                    outcome = self._collect(done, experiment, out)
                except self._ray.exceptions.ObjectLostError as error:
                    # Its world or its result was lost with a machine: Ray itself repeats dead tasks only.
                    self._lost[experiment.name] += 1
                    if self._lost[experiment.name] <= RETRIES:
                        self._scenarios.clear()
                        waiting.append(experiment)
                        continue
                    outcome = outcome_of(error, experiment.name)
                progress_of(experiment.name)("evaluate", 1.0)
                yield outcome

    def _start(self, experiment: Experiment) -> None:
        scenario = self._scenario(experiment.world_config)
        task = self._perform.remote(experiment, scenario, self._limits, str(Path.cwd()))
        self._flying[task] = experiment

    def _scenario(self, config: RunConfig | None) -> Any:
        """Return Ray's reference to the scenario of a config; None without a config."""
        if config is None:
            return None
        key = (config.source, config.build)
        if key not in self._scenarios:
            # Experiments come world by world: Ray frees the one before after its last experiment.
            self._scenarios = {key: self._ray.put(build_scenario(config))}
        return self._scenarios[key]

    def _collect(self, done: Any, experiment: Experiment, out: Path) -> Outcome:
        """Write a returned folder. An experiment that ran twice is written once.

        Raises:
            ObjectLostError: Ray lost the world or the result.
        """
        try:
            outcome, files = self._ray.get(done)
        except self._ray.exceptions.ObjectLostError:
            raise
        except Exception as error:
            return outcome_of(error, experiment.name)
        if not outcome.written:
            return outcome  # type: ignore[no-any-return]
        try:
            with atomic_folder(out / experiment.name) as folder:
                for name, data in files.items():
                    (folder / name).write_bytes(data)
        except OutputError as error:
            return outcome_of(error, experiment.name)
        return outcome  # type: ignore[no-any-return]


def perform_remotely(
    experiment: Experiment, scenario: Scenario | None, limits: Limits, here: str
) -> tuple[Outcome, Files]:
    """Run an experiment on a machine of the cluster; return the files that it wrote."""
    with suppress(OSError):
        os.chdir(here)  # a mapper of your own lies there, where the machines share a file system
    with tempfile.TemporaryDirectory(prefix="lirs-wct-") as temporary, importable(Path(here)):
        out = Path(temporary)
        if limits.any:
            engine = Processes(jobs=1, limits=limits, scenario=scenario, concurrent=True)
            outcome = next(engine.run([experiment], out, lambda name: no_progress))
        else:
            scenarios = ScenarioCache()
            if scenario is not None:
                scenarios.put(scenario)
            outcome = attempt(experiment, out, scenarios, no_progress, concurrent=True)
        folder = out / experiment.name
        files = {p.name: p.read_bytes() for p in folder.iterdir()} if folder.is_dir() else {}
    return outcome, files


@contextmanager
def ray_session(address: str | None, jobs: int | None) -> Iterator[Any]:
    """Connect to Ray for a `with` block. An existing cluster keeps running."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    if address is not None:
        _show_token()
    try:
        import ray
    except ImportError as error:
        raise ConfigError("--engine ray needs Ray: pip install '.[dist]'") from error
    if ray.is_initialized():
        yield ray
        return
    if address is not None:
        _probe_address(address)
    # Ray has no public switch for this: a lost machine's state (60 lines) would go to the terminal.
    ray._private.worker._worker_logs_enabled = False
    _connect(ray, address, jobs)
    try:
        yield ray
    finally:
        ray.shutdown()


def _connect(ray: Any, address: str | None, jobs: int | None) -> None:
    """Connect to the cluster at an address, or start one.

    Raises:
        ConfigError: none answers there.
    """
    own: dict[str, Any] = {"address": "local", "num_cpus": jobs or cores(), "include_dashboard": False}
    try:
        ray.init(
            **({"address": address} if address else own),
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
        return  # `auto` and the like
    try:
        socket.create_connection((host, int(port)), timeout=PATIENCE).close()
    except OSError as error:
        raise ConfigError(f"--address {address}: no Ray cluster answers there: {error}") from error


def _show_token() -> None:
    """Use Ray's token if this machine has one. Ray reads it at import."""
    if any(name in os.environ for name in ("RAY_AUTH_TOKEN", "RAY_AUTH_TOKEN_PATH")) or TOKEN.exists():
        os.environ.setdefault("RAY_AUTH_MODE", "token")
