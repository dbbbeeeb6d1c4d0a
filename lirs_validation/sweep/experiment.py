"""An experiment: the unit of a sweep, which fills one folder."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Protocol

from lirs_validation.config import RunConfig
from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.sweep.outcome import Outcome, outcome_of
from lirs_wct.progress import Progress


class Experiment(Protocol):
    """A unit of a sweep: it gives the same folder, wherever and however often it is run."""

    @property
    def name(self) -> str:
        """Name of its folder, different from every other experiment's."""
        ...

    @property
    def world_config(self) -> RunConfig | None:
        """A config of the world that it takes place in; None = it makes its world itself."""
        ...

    def check(self) -> None:
        """Look at everything that can be looked at before the world is built.

        Raises:
            WctError: the experiment cannot be run as it was asked for.
        """
        ...

    def perform(
        self, out: Path, scenarios: ScenarioCache, progress: Progress, *, concurrent: bool
    ) -> Outcome:
        """Run, and write the folder whole or not at all.

        Raises:
            WctError: it cannot be run, or not written.
        """
        ...

    def write_failure(self, out: Path, outcome: Outcome) -> None:
        """Write the folder of an experiment that came to nothing: its record, and `error.txt`.

        Raises:
            OutputError: the folder cannot be written.
        """
        ...

    def finished(self, out: Path) -> Outcome | None:
        """Return how the experiment ended when its folder was written; None where it is to be run (again)."""
        ...

    def described(self) -> dict[str, Any]:
        """Return what the sweep's file says about the experiment."""
        ...


def attempt(
    experiment: Experiment, out: Path, scenarios: ScenarioCache, progress: Progress, *, concurrent: bool
) -> Outcome:
    """Perform an experiment; whatever it raises becomes its outcome, `SystemExit` too.

    Raises:
        KeyboardInterrupt: the user, or who waits for this process, wants it to end.
    """
    try:
        return experiment.perform(out, scenarios, progress, concurrent=concurrent)
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        return outcome_of(error, experiment.name)
