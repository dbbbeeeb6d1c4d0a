"""Figures in words: one name, one unit and one number of digits for each, in every table and picture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, is_dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lirs_validation.record.run_record import RunRecord

NOTHING = "-"
"""What stands where a figure does not exist."""

Entry = Mapping[str, Any]

FIGURES: tuple[tuple[str, str, str], ...] = (
    ("distance driven", "trajectory.length", "{:.1f} m"),
    ("ATE (RMSE, aligned)", "trajectory.ate_rmse", "{:.3f} m"),
    ("ATE (RMSE, unaligned)", "trajectory.ate_rmse_unaligned", "{:.3f} m"),
    ("ATE of the odometry", "trajectory.odometry_ate_rmse", "{:.3f} m"),
    ("F1 against the true-pose map", "map.f1", "{:.3f}"),
    ("F1 against the input map", "map.f1_input", "{:.3f}"),
    ("IoU", "map.iou", "{:.3f}"),
    ("false occupied", "map.false_occupied", "{:.3f}"),
    ("unknown of what could be seen", "map.unknown", "{:.3f}"),
    ("deepest penetration", "collisions.max_penetration", "{:.4f} m"),
)
"""Name, place in the record, format."""


def as_entry(record: RunRecord | Entry) -> Entry:
    """Return a record as nested dicts, whether it comes from a run or from a file."""
    if isinstance(record, Mapping):
        return record
    if not is_dataclass(record):
        raise TypeError(f"a record must be a RunRecord or nested dicts, got {type(record).__name__}")
    return asdict(record)


def figure_at(entry: Entry, place: str) -> Any:
    """Return the figure at a dotted place; None where it does not exist."""
    found: Any = entry
    for part in place.split("."):
        found = found.get(part) if isinstance(found, Mapping) else None
    return found


def told(entry: Entry, place: str, form: str) -> str:
    """Return the figure at a dotted place in its format."""
    value = figure_at(entry, place)
    return NOTHING if value is None else form.format(value)


def key_figures(record: RunRecord | Entry) -> list[tuple[str, str]]:
    """Return names and values of the figures that exist, the status first."""
    entry = as_entry(record)
    lines = [("status", status_of(entry))]
    lines += [(name, told(entry, place, form)) for name, place, form in FIGURES]
    return [line for line in lines if line[1] != NOTHING]


def status_of(entry: Entry) -> str:
    """Return `ok`, or how the run failed."""
    return str(entry["status"])
