"""The engines by name; nobody else knows which there are."""

from __future__ import annotations

from lirs_validation.sweep.engines.base import Executor, Limits
from lirs_validation.sweep.engines.processes import Processes, cores
from lirs_validation.sweep.engines.ray import RayCluster
from lirs_validation.sweep.engines.serial import Serial
from lirs_wct.errors import ConfigError, unknown_name

ENGINES = ("serial", "processes", "ray")


def make_executor(
    engine: str | None,
    *,
    jobs: int | None = None,
    address: str | None = None,
    limits: Limits | None = None,
) -> Executor:
    """Make an engine.

    Args:
        engine: one of ENGINES; None = `serial`, or `processes` where more than one job is asked for.
        jobs: experiments at a time; None = one, or with `processes` one a core.
        address: of a Ray cluster; None = one is started on this machine.
        limits: of an experiment.

    Raises:
        ConfigError: the options contradict, or Ray is not installed.
    """
    limits = limits or Limits()
    chosen = engine or ("processes" if jobs is not None and jobs > 1 else "serial")
    if chosen not in ENGINES:
        raise unknown_name("engine", chosen, ENGINES)
    if jobs is not None and jobs < 1:
        raise ConfigError(f"--jobs must be 1 or more, got {jobs}")
    if address is not None and chosen != "ray":
        raise ConfigError(f"--address is of a Ray cluster; the engine is {chosen}")
    if chosen == "ray":
        return RayCluster(address=address, jobs=jobs, limits=limits)
    if chosen == "serial" and jobs not in (None, 1):
        raise ConfigError(f"--engine serial runs one experiment at a time, got --jobs {jobs}")
    if chosen == "serial" and not limits.any:
        return Serial()
    return Processes(jobs=1 if chosen == "serial" else jobs or cores(), limits=limits)
