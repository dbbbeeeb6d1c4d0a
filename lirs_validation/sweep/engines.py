"""Engines of a sweep: serial, or worker processes of this machine. Results do not depend on the engine."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from lirs_validation.experiment.scenario import Scenario, ScenarioCache
from lirs_validation.sweep.experiment import Experiment, Outcome, attempt
from lirs_validation.sweep.workers import Failure, WorkerPool
from lirs_wct.files import remove_leftovers
from lirs_wct.progress import Progress

ProgressOf = Callable[[str], Progress]
"""Function that returns the progress callback of an experiment by name."""


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


_SCENARIOS = ScenarioCache()
"""Worlds of a worker process."""


@dataclass(frozen=True)
class ExperimentJob:
    """Job of a worker. A scenario that is already built saves its construction."""

    experiment: Experiment
    out: Path
    concurrent: bool
    scenario: Scenario | None = None

    def __call__(self, progress: Progress) -> Outcome:
        """Run the experiment."""
        if self.scenario is not None:
            _SCENARIOS.put(self.scenario)
        return attempt(self.experiment, self.out, _SCENARIOS, progress, concurrent=self.concurrent)


@dataclass(frozen=True, kw_only=True)
class Processes:
    """Run experiments in separate processes, `jobs` at a time.

    A process that is killed or hangs costs only its own run.

    Attributes:
        jobs: number of concurrent runs; with one, real-time factors are valid as in `Serial`.
        seconds: wall-clock time of a whole experiment; None = no limit.
        scenario: world that is already built.
        concurrent: whether other engines run at the same time.
    """

    jobs: int
    seconds: float | None = None
    scenario: Scenario | None = None
    concurrent: bool = False

    def run(self, experiments: Sequence[Experiment], out: Path, progress_of: ProgressOf) -> Iterator[Outcome]:
        """Run experiments into folders of `out`."""
        names = [experiment.name for experiment in experiments]
        concurrent = self.concurrent or self.jobs > 1
        jobs = [ExperimentJob(experiment, out, concurrent, self.scenario) for experiment in experiments]

        def report(number: int, step: str, share: float) -> None:
            progress_of(names[number])(step, share)

        try:
            with WorkerPool(self.jobs, self.seconds) as pool:
                for number, outcome in pool.run(jobs, report):
                    if isinstance(outcome, Failure):
                        yield Outcome(experiment=names[number], **vars(outcome))
                    else:
                        yield outcome
        finally:
            remove_leftovers(out / name for name in names)
