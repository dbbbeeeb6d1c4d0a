"""Sweep: run the experiments without a result, and keep a folder of results."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from lirs_validation.config import EngineOptions
from lirs_validation.sweep.engines import Executor, Processes, ProgressOf, Serial
from lirs_validation.sweep.experiment import Experiment, Manifest, Outcome
from lirs_validation.sweep.ray_engine import RayCluster
from lirs_wct.errors import OutputError, WctError
from lirs_wct.files import check_writable, remove_leftovers
from lirs_wct.progress import no_progress

ROUNDS = 2
"""Times that an experiment is run whose results cannot be written."""


class Sweep:
    """Experiments and the folder for their results.

    Args:
        experiments: experiments to run; of several with one name, the last.
        out: folder for the experiments' folders and `sweep.json`.
        manifest: content of `sweep.json` except the experiments.
        listed: whether `sweep.json` is written.
        retry_failed: run experiments again that failed before.

    Attributes:
        outcomes: outcome of each finished experiment, by name.
        kept: number of experiments with a result from before.
        unwritten: experiments whose results could not be written, with the reason.

    Raises:
        WctError: an experiment cannot be run as it was asked for; nothing has been run then.
    """

    def __init__(
        self,
        experiments: Sequence[Experiment],
        out: Path,
        *,
        manifest: Manifest | None = None,
        listed: bool = True,
        retry_failed: bool = False,
    ) -> None:
        for experiment in experiments:
            experiment.check()
        self.experiments = list({experiment.name: experiment for experiment in experiments}.values())
        self.out = out
        described = tuple(experiment.describe() for experiment in self.experiments)
        self._manifest = replace(manifest or Manifest(), cells=described) if listed else None
        remove_leftovers(out / experiment.name for experiment in self.experiments)
        found = {experiment.name: experiment.find_outcome(out) for experiment in self.experiments}
        self.outcomes = {
            name: outcome
            for name, outcome in found.items()
            if outcome is not None and (outcome.succeeded or not retry_failed)
        }
        self.kept = len(self.outcomes)
        self.unwritten: dict[str, str] = {}

    @property
    def pending(self) -> list[Experiment]:
        """Experiments that are still to be run, in their order."""
        return [experiment for experiment in self.experiments if experiment.name not in self.outcomes]

    @property
    def failed(self) -> bool:
        """Whether an experiment failed, or was not finished."""
        return bool(self.pending) or not all(outcome.succeeded for outcome in self.outcomes.values())

    def run(
        self, executor: Executor, progress_of: ProgressOf = lambda name: no_progress
    ) -> Iterator[Outcome]:
        """Run pending experiments; yield each outcome once its folder is written.

        Raises:
            WctError: the only experiment cannot be run as it was asked for, or `out` not be written.
        """
        if self.pending:
            check_writable(self.out)
        if self.kept:
            self._save_manifest()
        for _ in range(ROUNDS):
            experiments = {experiment.name: experiment for experiment in self.pending}
            self.unwritten.clear()
            for outcome in executor.run(list(experiments.values()), self.out, progress_of):
                settled = self._settle(experiments[outcome.experiment], outcome)
                if settled.written:
                    self.outcomes[settled.experiment] = settled
                    self._save_manifest()
                    yield settled
                else:
                    self.unwritten[settled.experiment] = settled.reason
            if not self.unwritten:
                break

    def _settle(self, experiment: Experiment, outcome: Outcome) -> Outcome:
        """Write the folder of an experiment that failed outside a run."""
        if len(self.experiments) == 1 and (outcome.bad_input or outcome.unwritable):
            raise (OutputError if outcome.unwritable else WctError)(outcome.reason)
        if outcome.written or outcome.unwritable:
            return outcome
        try:
            experiment.write_failure(self.out, outcome)
        except OutputError as error:
            return replace(outcome, unwritable=True, reason=str(error))
        return replace(outcome, written=True)

    def _save_manifest(self) -> None:
        """Write `sweep.json` beside the first result: an interrupted first run leaves nothing at all."""
        if self._manifest is None:
            return
        try:
            self._manifest.save(self.out)
        except OutputError:
            return  # no room: with the next result then
        self._manifest = None


def make_executor(options: EngineOptions) -> Executor:
    """Make a Ray cluster, processes for jobs or a time limit, or `Serial`."""
    if options.address is not None:
        return RayCluster(address=options.address, jobs=options.jobs, seconds=options.cell_timeout)
    if options.jobs in (None, 1) and options.cell_timeout is None:
        return Serial()
    return Processes(jobs=options.jobs or 1, seconds=options.cell_timeout)
