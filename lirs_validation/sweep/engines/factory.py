"""Engines by name."""

from __future__ import annotations

from lirs_validation.config import EngineOptions
from lirs_validation.sweep.engines.base import Executor, Limits
from lirs_validation.sweep.engines.processes import Processes, cores
from lirs_validation.sweep.engines.ray import RayCluster
from lirs_validation.sweep.engines.serial import Serial


def make_executor(options: EngineOptions) -> Executor:
    """Make an engine: `serial`, or `processes` for several jobs, unless the options name one.

    Raises:
        ConfigError: Ray is not installed.
    """
    memory = None if options.cell_memory is None else options.cell_memory * 1e9
    limits = Limits(seconds=options.cell_timeout, memory=memory)
    jobs = options.jobs
    engine = options.engine or ("processes" if jobs is not None and jobs > 1 else "serial")
    if engine == "ray":
        return RayCluster(address=options.address, jobs=jobs, limits=limits)
    if engine == "serial" and not limits.any:
        return Serial()
    return Processes(jobs=1 if engine == "serial" else jobs or cores(), limits=limits)
