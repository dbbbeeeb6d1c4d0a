"""Provenance of a report's runs: versions, machines, and the command that repeats each run."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lirs_validation.analysis.results import recorded_config
from lirs_validation.config import WORLD_FLAGS, RunConfig
from lirs_validation.record.metric_catalog import Entry
from lirs_validation.report.table import ReportTable
from lirs_wct import Pose2, WctError
from lirs_wct.option import Options, changed, declared


@dataclass(frozen=True)
class Origin:
    """Software and machine of a number of runs."""

    runs: int
    versions: str
    machine: str


def origins_of(entries: Sequence[Entry]) -> tuple[Origin, ...]:
    """Return the software and machines of the runs."""
    runs = Counter[tuple[str, str]]()
    for entry in entries:
        versions = ", ".join(f"{name} {version}" for name, version in entry["versions"].items())
        machine = "{processor}, {cores} cores, {system}".format(**entry["machine"])
        runs[versions, machine] += 1
    return tuple(Origin(n, versions, machine) for (versions, machine), n in runs.items())


def commands_table(entries: Sequence[Entry]) -> ReportTable:
    """Return the command that repeats each run."""
    rows = []
    for entry in entries:
        try:
            command = command_of(recorded_config(entry))
        except WctError as error:
            command = f"not known: {error}"
        rows.append((str(entry["name"]), command))
    return ReportTable("commands", "The command of every run", "", ("run", "command"), tuple(rows), 2)


def command_of(config: RunConfig) -> str:
    """Return the command line that repeats a run; defaults are left out."""
    always = ["--robot", config.robot, "--mapper", config.mapper, "--seed", str(config.seed)]
    stated = ("robot", "mapper", "seed")
    given = [*always, *_arguments(config, stated), *_arguments(config.build, flags=WORLD_FLAGS)]
    return shlex.join(["lirs-wct", "validate", config.source, *given])


def _arguments(
    options: Options, stated: tuple[str, ...] = (), flags: tuple[str, ...] | None = None
) -> Iterator[str]:
    """Yield the changed options as a command line takes them, by `--option` those without a flag."""
    for name, value in changed(options).items():
        if name not in stated:
            has_flag = None if flags is None else name in flags
            yield from declared(type(options))[name].arguments(_option_text(value), has_flag)


def _option_text(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, Pose2):
        value = tuple(value.as_array().tolist())
    if isinstance(value, tuple):
        return ",".join(map(_option_text, value))
    if isinstance(value, (str, Path)):
        return str(value)
    short = f"{value:.12g}"
    return short if float(short) == value else repr(value)
