"""Sweep: run the tasks without a result, and keep a folder of results."""

from __future__ import annotations

import json
import math
import time
import traceback
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Protocol, get_args

from lirs_validation.config import RunConfig
from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.processes import is_interrupt
from lirs_validation.record.run_record import (
    SUCCEEDED,
    Status,
    damaged_files,
    is_stale,
    machine,
    plain,
    versions,
)
from lirs_wct.errors import MapperError, OutputError, SourceError, WctError, reason_of
from lirs_wct.files import atomic_folder, check_writable, remove_leftovers, write_json
from lirs_wct.progress import Progress, no_progress

MANIFEST = "sweep.json"
MANIFEST_SCHEMA = 1
ROUNDS = 2
"""Times that a task is run whose results cannot be written."""
TYPICAL_COST = {"hfield builtin": (2.0, 16.0), "mesh mujoco": (6.0, 4.0), "hfield mujoco": (2.0, 0.025)}
"""Wall seconds beside the drive, and real-time factor, of an idle machine; a first guess of the time left."""
ProgressOf = Callable[[str], Progress]
"""Function that returns the progress callback of a task by name."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Outcome of a task; small enough to keep thousands of them.

    Attributes:
        reason: Cause of the status in one line.
        trace: Traceback of the failure; empty without a failure.
        bad_input: Whether the user's input cannot be used.
        compile_seconds: Wall seconds that the compiler took, the first time alone.
        written: Whether its folder is written.
        unwritable: Whether its results could not be written; it is run again.
    """

    task: str
    status: Status
    reason: str = ""
    trace: str = ""
    bad_input: bool = False
    compile_seconds: float = 0.0
    written: bool = False
    unwritable: bool = False

    @property
    def succeeded(self) -> bool:
        """Whether nothing failed."""
        return self.status in SUCCEEDED


def outcome_of(error: BaseException, task: str) -> Outcome:
    """Return the outcome of a task that raised."""
    if is_interrupt(error):
        raise KeyboardInterrupt from error
    ours = isinstance(error, WctError)
    message = str(error) if ours else ": ".join(filter(None, (type(error).__name__, str(error))))
    return Outcome(
        task=task,
        status="error",
        reason=" ".join(message.split()),
        trace="".join(traceback.format_exception(error)),
        bad_input=ours and not isinstance(error, (MapperError, OutputError)),
        unwritable=isinstance(error, OutputError),
    )


class SweepTask(ABC):
    """Unit of a sweep. Every repetition on any machine gives the same folder.

    Attributes:
        marker: File with `status`, `reason` and `versions`; a folder without it is incomplete.
    """

    marker: ClassVar[str]

    @property
    @abstractmethod
    def name(self) -> str:
        """Name of its folder, different from every other task's."""

    @property
    def world_config(self) -> RunConfig | None:
        """Config of its world; None = the task makes its world itself."""
        return None

    @abstractmethod
    def check(self) -> None:
        """Check everything that can be checked before the world is built."""

    @abstractmethod
    def run(self, out: Path, scenarios: ScenarioCache, progress: Progress, *, concurrent: bool) -> Outcome:
        """Do the work and write its folder."""

    @abstractmethod
    def describe(self) -> dict[str, Any]:
        """Return the task's entry in `sweep.json`."""

    @abstractmethod
    def failure(self, outcome: Outcome) -> str:
        """Return the marker's text for a failed task."""

    @abstractmethod
    def inputs(self) -> list[Path | None]:
        """Return the files that decide its result, where they are known."""

    def is_result(self, folder: Path, entry: Mapping[str, Any]) -> bool:
        """Whether a folder, whose marker holds the entry, is of this very task."""
        return True

    def attempt(
        self, out: Path, scenarios: ScenarioCache, progress: Progress, *, concurrent: bool
    ) -> Outcome:
        """Run the task. All exceptions but Ctrl-C, also `SystemExit`, become outcomes."""
        try:
            return self.run(out, scenarios, progress, concurrent=concurrent)
        except KeyboardInterrupt:  # and its subclasses, as they are
            raise
        except BaseException as error:
            return outcome_of(error, self.name)

    def write_failure(self, out: Path, outcome: Outcome) -> None:
        """Write the folder of a failed task: its marker, and `error.txt`."""
        with atomic_folder(out / self.name) as folder:
            (folder / "error.txt").write_text(outcome.trace or outcome.reason, encoding="utf-8")
            (folder / self.marker).write_text(self.failure(outcome), encoding="utf-8")

    def find_outcome(self, out: Path) -> Outcome | None:
        """Return the outcome in a whole and current folder; None = run it."""
        folder = out / self.name
        try:
            entry = read_status(folder / self.marker)
        except SourceError:
            return None
        stale = is_stale(folder / self.marker, entry.get("versions"), self.inputs())
        if stale or damaged_files(folder, self.marker) or not self.is_result(folder, entry):
            return None
        return Outcome(task=self.name, status=entry["status"], reason=entry["reason"], written=True)


def read_status(path: Path) -> dict[str, Any]:
    """Read a JSON file with the `status`, the `reason` and the `versions` of a task."""
    try:
        entry: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        legal = entry["status"] in get_args(Status) and isinstance(entry["reason"], str)
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise SourceError(f"{path}: not an experiment's result, or damaged: {reason_of(error)}") from error
    if not legal:
        raise SourceError(f"{path}: damaged: status {entry['status']!r}, reason {entry['reason']!r}")
    return entry


class Executor(Protocol):
    """Interface of an engine: run each task at least once, yield one outcome each."""

    def run(self, tasks: Sequence[SweepTask], out: Path, progress_of: ProgressOf) -> Iterator[Outcome]:
        """Run tasks into folders of `out`. The caller writes the outcomes of failures."""


class Serial:
    """Run one task after the other in this process; real-time factors are valid."""

    def __init__(self, scenarios: ScenarioCache | None = None) -> None:
        self._scenarios = scenarios or ScenarioCache()

    def run(self, tasks: Sequence[SweepTask], out: Path, progress_of: ProgressOf) -> Iterator[Outcome]:
        """Run tasks into folders of `out`."""
        for task in tasks:
            yield task.attempt(out, self._scenarios, progress_of(task.name), concurrent=False)


class Sweep:
    """Tasks and the folder for their results.

    Args:
        tasks: Tasks to run; of several with one name, the last.
        command: Command line, for `sweep.json`.
        suite: Name of the suite; None = the tasks were given one by one.
        listed: Whether `sweep.json` is written.

    Attributes:
        outcomes: Outcome of each finished task, by name.
        kept: Number of tasks with a result from before.
        unwritten: Reasons of the tasks whose results could not be written, by name.
        time_left: Estimate of the time for the pending tasks.
    """

    def __init__(
        self,
        tasks: Sequence[SweepTask],
        out: Path,
        *,
        command: str = "",
        suite: str | None = None,
        listed: bool = True,
        retry_failed: bool = False,
    ) -> None:
        if len(tasks) > 1:  # a single one fails as soon when it is run
            for task in tasks:
                task.check()
        self.tasks = list({task.name: task for task in tasks}.values())
        self.out, self.suite = out, suite
        cells = [task.describe() for task in self.tasks]
        entry = {"schema": MANIFEST_SCHEMA, "command": command, "suite": suite, "cells": cells}
        self._manifest = entry | {"versions": versions(), "machine": machine()} if listed else None
        remove_leftovers(out / task.name for task in self.tasks)
        self.outcomes: dict[str, Outcome] = {}
        for task in self.tasks:
            outcome = task.find_outcome(out)
            if outcome is not None and (outcome.succeeded or not retry_failed):
                self.outcomes[task.name] = outcome
        self.kept = len(self.outcomes)
        self.unwritten: dict[str, str] = {}
        self.time_left = TimeLeft(self.pending)

    @property
    def pending(self) -> list[SweepTask]:
        """Tasks that are still to be run, in their order."""
        return [task for task in self.tasks if task.name not in self.outcomes]

    @property
    def failed(self) -> bool:
        """Whether a task failed, or was not finished."""
        return bool(self.pending) or not all(outcome.succeeded for outcome in self.outcomes.values())

    def run(
        self, executor: Executor, progress_of: ProgressOf = lambda name: no_progress
    ) -> Iterator[Outcome]:
        """Run pending tasks; yield each outcome once its folder is written."""
        if self.pending:
            check_writable(self.out)
        if self.kept:
            self._save_manifest()
        for _ in range(ROUNDS):
            tasks = {task.name: task for task in self.pending}
            self.unwritten.clear()
            for outcome in executor.run(list(tasks.values()), self.out, progress_of):
                settled = self._settle(tasks[outcome.task], outcome)
                if settled.written:
                    self.outcomes[settled.task] = settled
                    self._save_manifest()
                    yield settled
                else:
                    self.unwritten[settled.task] = settled.reason
            if not self.unwritten:
                break

    def _settle(self, task: SweepTask, outcome: Outcome) -> Outcome:
        """Write the folder of a task that failed outside a run."""
        if len(self.tasks) == 1 and (outcome.bad_input or outcome.unwritable):
            raise (OutputError if outcome.unwritable else WctError)(outcome.reason)
        if outcome.written or outcome.unwritable:
            return outcome
        try:
            task.write_failure(self.out, outcome)
        except OutputError as error:
            return replace(outcome, unwritable=True, reason=str(error))
        return replace(outcome, written=True)

    def _save_manifest(self) -> None:
        """Write `sweep.json` beside the first result: an interrupted first run leaves nothing at all."""
        if self._manifest is None:
            return
        try:
            write_json(self.out / MANIFEST, self._manifest, plain)
        except OutputError:
            return  # the disk is full: with the next result then
        self._manifest = None


class TimeLeft:
    """Wall time that the tasks of a sweep still need.

    A task takes its typical time, times the ratio of actual to typical time of the ended tasks most like it.
    """

    def __init__(self, tasks: Sequence[SweepTask], clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._last_end = clock, clock()
        self._costs = {task.name: _typical_cost(task.world_config) for task in tasks}
        self._begun: dict[str, float] = {}
        self._sums: dict[tuple[str, ...], tuple[float, float]] = {}

    def begin(self, name: str) -> None:
        """Take in that a task has begun, or goes on."""
        self._begun.setdefault(name, self._clock())

    def end(self, name: str, compile_seconds: float) -> None:
        """Take in a task's end; one whose begin was not told began with the end of the last."""
        now, (kinds, typical) = self._clock(), self._costs.pop(name)
        seconds = now - self._begun.pop(name, self._last_end) - compile_seconds
        for kind in kinds:
            actual, usual = self._sums.get(kind, (0.0, 0.0))
            self._sums[kind] = actual + seconds, usual + (typical or 1.0)
        self._last_end = now

    def seconds(self, jobs: int = 1) -> float | None:
        """Return the seconds for all tasks left, `jobs` at a time if none has begun; None = not known yet."""
        now, left = self._clock(), 0.0
        for name, (kinds, typical) in self._costs.items():
            actual, usual = next(filter(None, map(self._sums.get, kinds)), (1.0, 1.0))
            if typical is None and not self._sums:
                return None
            left += max(0.0, (typical or 1.0) * actual / usual - now + self._begun.get(name, now))
        return left / (len(self._begun) or jobs)


def _typical_cost(config: RunConfig | None) -> tuple[list[tuple[str, ...]], float | None]:
    """Return a task's kinds, the narrowest first, and its typical seconds, if known."""
    if config is None:
        return [()], None
    view = f"{config.terrain} {config.rays}"
    features = view, config.robot, config.mapper, config.source
    kinds = [features[:count] for count in range(len(features), -1, -1)]
    if view not in TYPICAL_COST or ":" in config.mapper or config.lidar is not None:
        return kinds, None  # a mapper of your own, or one of clouds
    beside, rtf = TYPICAL_COST[view]
    return kinds, beside + min(config.seconds / rtf, config.wall_limit or math.inf)
