"""Experiments, their outcomes, and the manifest of a sweep."""

from __future__ import annotations

import json
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
from lirs_wct.files import atomic_write
from lirs_wct.progress import Progress

MANIFEST = "sweep.json"
MANIFEST_SCHEMA = 1


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """How an experiment ended.

    Attributes:
        experiment: its name.
        status: that of its record.
        reason: one line.
        trace: where it failed, several lines; empty where it did not.
        bad_input: whether something that the user gave cannot be used.
        written: whether its folder is written.
        unwritable: whether its results could not be written: it is worth running again.
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


@dataclass(frozen=True, kw_only=True)
class Manifest:
    """What was asked for.

    Attributes:
        command: the command line.
        suite: name of the suite; None = the experiments were asked for one by one.
        cells: of each experiment its name, world and config, and the suite's tables that it belongs to.
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
        with atomic_write(folder / MANIFEST) as path:
            text = json.dumps({"schema": MANIFEST_SCHEMA} | vars(self), indent=1, default=plain)
            path.write_text(text + "\n", encoding="utf-8")
