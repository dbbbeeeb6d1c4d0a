"""Run record: config, versions, machine and metrics, as JSON by a schema."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cache, cached_property
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from lirs_validation.config import RunConfig, run_name
from lirs_validation.record.metric_catalog import picture_lines
from lirs_validation.record.provenance import machine, versions
from lirs_validation.record.verdict import Verdict, judge
from lirs_wct.display import html_table
from lirs_wct.errors import SourceError, reason_of
from lirs_wct.files import write_json

if TYPE_CHECKING:
    from jsonschema import Draft202012Validator

SCHEMA = 3
RECORD = "record.json"
BAG = "bag"
"""Stem of the file of a run's bag, whose folder is the run's."""

Status = Literal[
    "ok", "wall limit", "tipped", "stuck", "off world", "diverged", "lost", "incomplete", "error", "timeout"
]
SUCCEEDED: tuple[Status, ...] = ("ok", "wall limit")
"""A run that ended so did not fail: it drove its time, or as much of it as it was allowed."""


def succeeded(entry: Mapping[str, Any]) -> bool:
    """Whether a run, its record as nested dicts, did not fail."""
    return entry["status"] in SUCCEEDED


@dataclass(frozen=True, kw_only=True)
class RunRecord:
    """Result of a run.

    The design's definitions apply to its metrics.

    A run that came to nothing (`error`, `timeout`) has no metrics.

    Attributes:
        world: name, kind, size, relief, contact grid, scale, window, files that it was made from.
        status: `ok`, or how it ended before its time; `reason` says why.
        rtf: mean, std, min, parts, physics_reference, timestep, series, ...
        trajectory: ate_rmse, ate_unaligned, length, final drift, scan_coverage, ...
        map: f1, f1_aligned, iou, f1_input, false_occupied, ...
        collisions: max_penetration, ...
        scans: beams, range_max, and medians of returns and of hits on walls per scan (of planar mappers);
            imu_rate, inertial readings a second of a bag or of a mapper that reads them.
        mapper: scans received, used, skipped, milliseconds a scan.
        cost: cpu_seconds of the drive, peak_memory of the process (bytes), compile_seconds, scans_dropped.
    """

    config: RunConfig
    world: dict[str, Any]
    status: Status
    reason: str = ""
    rtf: dict[str, Any] = field(default_factory=dict)
    trajectory: dict[str, Any] = field(default_factory=dict)
    map: dict[str, Any] = field(default_factory=dict)
    collisions: dict[str, Any] = field(default_factory=dict)
    scans: dict[str, Any] = field(default_factory=dict)
    mapper: dict[str, Any] = field(default_factory=dict)
    cost: dict[str, Any] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=versions)
    machine: dict[str, Any] = field(default_factory=machine)

    def __repr__(self) -> str:
        return f"RunRecord({self.name!r}, {self.status})"

    @property
    def name(self) -> str:
        """Name of the run's folder."""
        return run_name(self.config, self.world["name"])

    @cached_property
    def verdict(self) -> Verdict:
        """Class, sentence and reasons of the result."""
        return judge(asdict(self))

    def to_dict(self) -> dict[str, Any]:
        """Return the record as nested dicts, as its file holds them."""
        entry = {"schema": SCHEMA, "seed": self.config.seed, "name": self.name} | asdict(self)
        return entry | {"verdict": self.verdict.to_dict()}

    def to_json(self) -> str:
        """Return the record as JSON; values that do not exist are null."""
        return json.dumps(self.to_dict(), indent=1, default=plain, allow_nan=False) + "\n"

    def save(self, folder: Path) -> None:
        """Write `record.json`.

        Raises:
            OutputError: the folder cannot be written.
        """
        write_json(folder / RECORD, self.to_dict(), plain)

    def _repr_html_(self) -> str:
        return html_table(picture_lines(self.to_dict()))


def read_record(folder: Path) -> dict[str, Any]:
    """Read a run's `record.json` as nested dicts.

    Raises:
        SourceError: missing, damaged or of another schema.
    """
    path = folder / "record.json"
    try:
        entry: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        schema = entry["schema"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise SourceError(f"{path}: not a run's record, or damaged: {reason_of(error)}") from error
    if schema != SCHEMA:
        raise SourceError(f"{path}: schema {schema} is not the one this version reads ({SCHEMA})")
    return entry


def record_schema() -> dict[str, Any]:
    """Return the JSON schema of `record.json`."""
    text = files(__package__).joinpath("record.schema.json").read_text(encoding="utf-8")
    schema: dict[str, Any] = json.loads(text)
    return schema


def schema_error(entry: Mapping[str, Any]) -> str | None:
    """Return the first schema violation in one line; None if valid."""
    from jsonschema.exceptions import best_match  # imported here: a new run has no record to be checked

    error = best_match(_validator().iter_errors(entry))
    if error is not None:
        place = ".".join(str(part) for part in error.absolute_path) or "record"
        return " ".join(f"{place}: {error.message}".split())[:200]
    try:
        json.dumps(entry, allow_nan=False)
    except ValueError:
        return "record: a number is not finite"
    return None


@cache
def _validator() -> Draft202012Validator:
    from jsonschema import Draft202012Validator

    return Draft202012Validator(record_schema())


def read_whole_record(folder: Path) -> dict[str, Any]:
    """Read a run's `record.json`.

    Raises:
        SourceError: missing, damaged, of another schema, or something in it does not fit the schema.
    """
    entry = read_record(folder)
    problem = schema_error(entry)
    if problem is not None:
        raise SourceError(f"{folder / 'record.json'}: damaged: {problem}")
    return entry


def plain(value: Any) -> Any:
    """Return the JSON value of a NumPy number or a path."""
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"a record holds numbers, text and lists, got {type(value).__name__}")


def maps_clouds(entry: Mapping[str, Any]) -> bool:
    """Whether a run's mapper read point clouds: it has no occupancy map, but an elevation."""
    return "elevation_rmse" in entry["map"]
