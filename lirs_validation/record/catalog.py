"""The figures of a record: what each is called, where it stands, in which unit it is told."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from lirs_validation.record.formatting import NOTHING, figure_at
from lirs_wct.errors import unknown_name

Better = Literal["more", "less"] | None
MS, MM, DEGREES, MEGABYTE = 1e3, 1e3, math.degrees(1.0), 1e-6


@dataclass(frozen=True)
class Figure:
    """A figure of a record.

    Attributes:
        place: dotted place in the record.
        name: what tables call it.
        unit: empty for a pure number.
        digits: behind the point; None = three that count.
        scale: from the record's unit to this one.
        better: which way is good, if any.
    """

    place: str
    name: str
    unit: str = ""
    digits: int | None = 3
    scale: float = 1.0
    better: Better = None

    @property
    def heading(self) -> str:
        """Name with unit."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    def of(self, entry: Mapping[str, Any]) -> float | None:
        """Return the figure in its unit; None where the record has none."""
        value = figure_at(entry, self.place)
        return None if value is None else float(value) * self.scale

    def told(self, value: float | None) -> str:
        """Return a value in this figure's unit with this figure's digits."""
        if value is None:
            return NOTHING
        return f"{value:.{self.digits}f}" if self.digits is not None else significant(value)


def significant(value: float, digits: int = 3) -> str:
    """Return a number with so many digits that count, and no exponent.

    >>> significant(0.01094), significant(41.27), significant(1234.5)
    ('0.0109', '41.3', '1234')
    """
    if value == 0 or not math.isfinite(value):
        return f"{value:g}"
    return f"{value:.{max(0, digits - 1 - math.floor(math.log10(abs(value))))}f}"


def span(values: Sequence[float]) -> str:
    """Return the smallest and the largest of numbers, or the one number."""
    low, high = significant(min(values)), significant(max(values))
    return low if low == high else f"{low} to {high}"


RTF = (
    Figure("rtf.mean", "RTF", digits=None, better="more"),
    Figure("rtf.std", "std over time", digits=None),
    Figure("rtf.min", "least", digits=None, better="more"),
    Figure("rtf.parts.physics", "physics", "ms/s", None, MS, "less"),
    Figure("rtf.parts.sensors", "sensors", "ms/s", None, MS, "less"),
    Figure("rtf.parts.mapper", "mapper", "ms/s", None, MS, "less"),
    Figure("rtf.parts.rest", "rest", "ms/s", None, MS, "less"),
    Figure("rtf.physics_only", "physics only", digits=None, better="more"),
)
TRAJECTORY = (
    Figure("trajectory.length", "driven", "m", 1),
    Figure("trajectory.ate_rmse", "ATE", "m", better="less"),
    Figure("trajectory.ate_rmse_unaligned", "ATE unaligned", "m", better="less"),
    Figure("trajectory.odometry_ate_rmse", "ATE of odometry", "m", better="less"),
    Figure("trajectory.rpe_metre.translation_rmse", "RPE per m", "mm", 1, MM, "less"),
    Figure("trajectory.rpe_metre.rotation_rmse", "RPE per m", "deg", 3, DEGREES, "less"),
    Figure("trajectory.rpe_second.translation_rmse", "RPE per s", "mm", 1, MM, "less"),
    Figure("trajectory.rpe_second.rotation_rmse", "RPE per s", "deg", 3, DEGREES, "less"),
    Figure("trajectory.relations.translation_mean", "relations", "mm", 1, MM, "less"),
    Figure("trajectory.relations.rotation_mean", "relations", "deg", 3, DEGREES, "less"),
    Figure("trajectory.final_drift", "final drift", "m", better="less"),
)
MAP = (
    Figure("map.f1", "F1", better="more"),
    Figure("map.precision", "precision", better="more"),
    Figure("map.recall", "recall", better="more"),
    Figure("map.iou", "IoU", better="more"),
    Figure("map.ssim", "SSIM", better="more"),
    Figure("map.f1_input", "F1 input map", better="more"),
    Figure("map.false_occupied", "false occupied", better="less"),
    Figure("map.to_reference.mean", "to true, mean", "mm", 1, MM, "less"),
    Figure("map.to_reference.p95", "to true, 95 %", "mm", 1, MM, "less"),
    Figure("map.from_reference.mean", "from true, mean", "mm", 1, MM, "less"),
    Figure("map.from_reference.p95", "from true, 95 %", "mm", 1, MM, "less"),
    Figure("map.unknown", "unknown", better="less"),
)
CONTACTS = (
    Figure("collisions.max_penetration", "deepest", "mm", 2, MM, "less"),
    Figure("collisions.penetration_p999", "99.9 %", "mm", 2, MM, "less"),
    Figure("collisions.body_contacts", "body contacts", digits=0, better="less"),
    Figure("collisions.body_contact_seconds", "for", "s", 2, better="less"),
)
COST = (
    Figure("cost.cpu_seconds", "CPU time", "s", 1, better="less"),
    Figure("cost.peak_memory", "peak memory", "MB", 0, MEGABYTE, "less"),
    Figure("cost.compile_seconds", "JIT", "s", 1, better="less"),
    Figure("cost.scans_dropped", "scans dropped", digits=0, better="less"),
    Figure("mapper.ms_p50", "scan, median", "ms", 2, better="less"),
    Figure("mapper.ms_p95", "scan, 95 %", "ms", 2, better="less"),
)
ALL = (*RTF, *TRAJECTORY, *MAP, *CONTACTS, *COST)
COMPARED = tuple(
    figure
    for figure in ALL
    if figure.place
    in {
        "rtf.mean", "trajectory.ate_rmse", "trajectory.rpe_metre.translation_rmse",
        "trajectory.relations.translation_mean", "trajectory.final_drift", "map.f1", "map.iou",
        "map.ssim", "map.false_occupied", "collisions.max_penetration", "cost.cpu_seconds",
        "cost.peak_memory",
    }
)  # fmt: skip
"""What two results are compared by, unless told otherwise."""


def figures_named(places: Sequence[str]) -> tuple[Figure, ...]:
    """Return figures by their places in the record.

    Raises:
        ConfigError: there is no such figure.
    """
    known = {figure.place: figure for figure in ALL}
    for place in places:
        if place not in known:
            raise unknown_name("figure", place, known)
    return tuple(known[place] for place in places)


def rtf_counts(entry: Mapping[str, Any]) -> bool:
    """Whether a run's RTF is one: with anything running beside it, it tells of the other runs."""
    return bool(entry["rtf"]) and not entry["rtf"]["concurrent"]
