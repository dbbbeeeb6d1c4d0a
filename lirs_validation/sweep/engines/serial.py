"""The engine of one process: one experiment after the other, nothing beside it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.sweep.engines.base import ProgressOf
from lirs_validation.sweep.experiment import Experiment, attempt
from lirs_validation.sweep.outcome import Outcome


class Serial:
    """One experiment after the other in this process: nothing beside it, so its real-time factors count."""

    def run(self, experiments: Sequence[Experiment], out: Path, progress_of: ProgressOf) -> Iterator[Outcome]:
        """Run experiments into folders of `out`."""
        scenarios = ScenarioCache()
        for experiment in experiments:
            yield attempt(experiment, out, scenarios, progress_of(experiment.name), concurrent=False)
