"""Experiments, their outcomes, and the manifest of a sweep."""

from __future__ import annotations

import traceback
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from lirs_validation.config import RunConfig
from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.interrupts import is_interrupt
from lirs_validation.record.provenance import machine, versions
from lirs_validation.record.run_record import SUCCEEDED, Status, plain
from lirs_wct.errors import MapperError, OutputError, WctError
from lirs_wct.files import write_json
from lirs_wct.progress import Progress

MANIFEST = "sweep.json"
MANIFEST_SCHEMA = 1


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Outcome of an experiment; small enough to keep thousands of them.

    Attributes:
        experiment: its name.
        status: that of its record.
        reason: one line.
        trace: traceback of the failure; empty without a failure.
        bad_input: whether the user's input cannot be used.
        written: whether its folder is written.
        unwritable: whether its results could not be written; it is run again.
    """

    experiment: str
    status: Status
    reason: str = ""
    trace: str = ""
    bad_input: bool = False
    written: bool = False
    unwritable: bool = False

    @property
    def succeeded(self) -> bool:
        """Whether nothing failed."""
        return self.status in SUCCEEDED


def outcome_of(error: BaseException, experiment: str) -> Outcome:
    """Return the outcome of an experiment that raised.

    Raises:
        KeyboardInterrupt: the error is a Ctrl-C that a compiled kernel wrapped.
    """
    if is_interrupt(error):
        raise KeyboardInterrupt from error
    ours = isinstance(error, WctError)
    message = str(error) if ours else ": ".join(filter(None, (type(error).__name__, str(error))))
    return Outcome(
        experiment=experiment,
        status="error",
        reason=" ".join(message.split()),
        trace="".join(traceback.format_exception(error)),
        bad_input=ours and not isinstance(error, (MapperError, OutputError)),
        unwritable=isinstance(error, OutputError),
    )


class Experiment(Protocol):
    """Unit of a sweep. Every repetition on any machine gives the same folder."""

    @property
    def name(self) -> str:
        """Name of its folder, different from every other experiment's."""
        ...

    @property
    def world_config(self) -> RunConfig | None:
        """Config of its world; None = the experiment makes its world itself."""
        ...

    def check(self) -> None:
        """Check everything that can be checked before the world is built.

        Raises:
            WctError: the experiment cannot be run as it was asked for.
        """
        ...

    def perform(
        self, out: Path, scenarios: ScenarioCache, progress: Progress, *, concurrent: bool
    ) -> Outcome:
        """Run the experiment and write its folder atomically.

        Raises:
            WctError: it cannot be run, or not written.
        """
        ...

    def write_failure(self, out: Path, outcome: Outcome) -> None:
        """Write the folder of a failed experiment: its record, and `error.txt`.

        Raises:
            OutputError: the folder cannot be written.
        """
        ...

    def find_outcome(self, out: Path) -> Outcome | None:
        """Return the outcome in an existing folder; None = the experiment must run."""
        ...

    def describe(self) -> dict[str, Any]:
        """Return the experiment's entry in `sweep.json`."""
        ...


def attempt(
    experiment: Experiment, out: Path, scenarios: ScenarioCache, progress: Progress, *, concurrent: bool
) -> Outcome:
    """Perform an experiment. All exceptions, also `SystemExit`, become outcomes.

    Raises:
        KeyboardInterrupt: the user or the parent process ends this process.
    """
    try:
        return experiment.perform(out, scenarios, progress, concurrent=concurrent)
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        return outcome_of(error, experiment.name)


@dataclass(frozen=True, kw_only=True)
class Manifest:
    """Content of `sweep.json`: the requested experiments.

    Attributes:
        command: the command line.
        suite: name of the suite; None = the experiments were given one by one.
        cells: name, world, config and the suite's tables of each experiment.
    """

    command: str = ""
    suite: str | None = None
    cells: tuple[dict[str, Any], ...] = ()
    versions: dict[str, str] = field(default_factory=versions)
    machine: dict[str, Any] = field(default_factory=machine)

    def save(self, folder: Path) -> None:
        """Write `sweep.json`.

        Raises:
            OutputError: the folder cannot be written.
        """
        write_json(folder / MANIFEST, {"schema": MANIFEST_SCHEMA} | vars(self), plain)
