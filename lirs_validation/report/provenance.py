"""Where the runs of a report come from: versions, machines, the command of every run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from lirs_validation.analysis.recorded_run import recorded_config
from lirs_validation.record.formatting import Entry
from lirs_validation.report.command_line import command_of
from lirs_validation.report.tables.table import ReportTable
from lirs_wct.errors import WctError


@dataclass(frozen=True)
class Origin:
    """Runs that the same software made on the same machine."""

    runs: int
    versions: str
    machine: str


def origins_of(entries: Sequence[Entry]) -> tuple[Origin, ...]:
    """Return with which software and on which machines the runs were made."""
    found: dict[tuple[str, str], int] = {}
    for entry in entries:
        versions = ", ".join(f"{name} {version}" for name, version in entry["versions"].items())
        machine = entry["machine"]
        text = f"{machine['processor']}, {machine['cores']} cores, {machine['system']}"
        found[(versions, text)] = found.get((versions, text), 0) + 1
    return tuple(Origin(n, versions, machine) for (versions, machine), n in found.items())


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
