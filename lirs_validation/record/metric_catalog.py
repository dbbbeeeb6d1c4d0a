"""Catalog of metrics: key in a record, name, unit, digits, better direction.

Tables on the screen, pictures, the report, comparisons and CSV select from it: a metric is added here, and
in the JSON schema of records.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from lirs_wct.errors import require_known

NOTHING = "-"
"""Text of a value that does not exist."""
Entry = Mapping[str, Any]
"""A record as nested dicts."""
Better = Literal["more", "less"] | None
Section = Literal["rtf", "trajectory", "map", "contacts", "cost"]
Selection = Literal["picture", "runs", "summary", "compared", "distribution", "headline"]
"""Where metrics are shown beside their section of the report: a run's picture, the table of runs on the
screen, the summary of groups, comparisons unless others are named, the report's distributions, its medians
on top."""
ATE, ODOMETRY_ATE = "trajectory.ate_rmse", "trajectory.odometry_ate_rmse"
ODOMETRY_ATE_3D = "trajectory.odometry_ate_rmse_3d"
"""Places of the mapper's and of the odometry's error in a record."""
ALL_PLACES: tuple[Selection, ...] = ("picture", "runs", "summary", "compared", "distribution", "headline")
VISIBLE_ERROR = 0.0005
"""Meters by which an ATE must exceed the odometry's to be visibly worse."""
WORSE = "worse than its odometry"
WORSE_MARK = "‡"
"""Marks an ATE that is worse than the odometry's, in tables that have no room for the words."""
MS, MM, PERCENT, DEGREES, MEGABYTE = 1e3, 1e3, 1e2, math.degrees(1.0), 1e-6


@dataclass(frozen=True)
class Metric:
    """A metric of a run.

    Attributes:
        key: dotted place in the record.
        name: heading in tables, without the unit.
        section: section of the report.
        unit: empty for a pure number.
        digits: behind the point; None = three significant digits.
        scale: factor from the record's unit to this one.
        better: direction that is good, if any.
        selections: further tables and pictures that show it.
        short: heading of a narrow column, with the unit; empty = the same.
        tested: whether comparisons test it; the odometry's error belongs to the drive, not to the mapper.
        baseline: key of the comparison value in the report's distributions, in the same unit of the record.
        detail: whether the report's tables leave it out; comparisons take it by its key.
        rare: whether 0 counts as no value.
    """

    key: str
    name: str
    section: Section
    unit: str = ""
    digits: int | None = 3
    scale: float = 1.0
    better: Better = None
    selections: tuple[Selection, ...] = ()
    short: str = ""
    tested: bool = True
    baseline: str = ""
    detail: bool = False
    rare: bool = False

    @property
    def heading(self) -> str:
        """Name with unit."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    def of(self, entry: Entry) -> float | None:
        """Return the value in this unit; None where the record has none."""
        value = value_at(entry, self.key)
        return None if value is None or (self.rare and not value) else float(value) * self.scale

    def comparable(self, entry: Entry) -> float | None:
        """Return the comparable value in this unit.

        None also for the RTF of a run that shared the processor.
        """
        return self.of(entry) if self.section != "rtf" or rtf_counts(entry) else None

    def formatted(self, value: float | None) -> str:
        """Return a value in this unit with this metric's digits."""
        if value is None:
            return NOTHING
        fixed = self.digits == 0 or (self.digits is not None and abs(value) < 1e6)
        return f"{value:.{self.digits}f}" if fixed else significant(value)

    def text(self, value: float) -> str:
        """Return a record's value with digits and unit, as in a sentence."""
        return f"{self.formatted(value * self.scale)} {self.unit}".rstrip()


def _alarm_metrics(source: str, who: str, *shown: Selection) -> tuple[Metric, ...]:
    """Return the metrics of a source of alarms."""
    key, name, hidden = f"trajectory.failure.{source}", f"false alarms, {who}", not shown
    return (
        Metric(f"{key}.noticed", f"losses noticed, {who}", "trajectory", "%", 0, PERCENT, detail=True),
        Metric(f"{key}.delay", f"delay, {who}", "trajectory", "s", 1, 1.0, "less", shown, detail=hidden),
        Metric(f"{key}.false", name, "trajectory", "", 0, 1.0, "less", shown, detail=hidden, rare=True),
        Metric(f"{key}.false_per_hour", name, "trajectory", "per h", 1, better="less", detail=True),
    )


METRICS: tuple[Metric, ...] = (
    Metric("rtf.mean", "RTF", "rtf", digits=None, better="more",
           selections=("runs", "summary", "compared", "distribution")),
    Metric("rtf.std", "std over time", "rtf", digits=None),
    Metric("rtf.min", "least", "rtf", digits=None, better="more"),
    Metric("rtf.parts.physics", "physics", "rtf", "ms/s", None, MS, "less"),
    Metric("rtf.parts.sensors", "sensors", "rtf", "ms/s", None, MS, "less"),
    Metric("rtf.parts.mapper", "mapper", "rtf", "ms/s", None, MS, "less"),
    Metric("rtf.parts.rest", "rest", "rtf", "ms/s", None, MS, "less"),
    Metric("rtf.physics_reference", "reference physics", "rtf", digits=None, better="more"),
    Metric("rtf.load_average", "system load", "rtf", digits=2, detail=True),
    Metric("trajectory.length", "driven", "trajectory", "m", 1, selections=("picture", "runs", "summary")),
    Metric(ATE, "ATE", "trajectory", "m", 3, 1.0, "less", ALL_PLACES, baseline=ODOMETRY_ATE),
    Metric("trajectory.ate_rmse_unaligned", "ATE unaligned", "trajectory", "m", better="less",
           selections=("picture",)),
    Metric(ODOMETRY_ATE, "ATE of odometry", "trajectory", "m", better="less",
           selections=("picture", "runs", "summary", "compared", "headline"), short="odom. ATE [m]",
           tested=False),
    Metric("trajectory.scan_coverage", "scans covered", "trajectory", "%", 1, PERCENT, "more",
           selections=("picture",)),
    Metric("trajectory.rpe_metre.translation_rmse", "RPE per m", "trajectory", "mm", 1, MM, "less",
           selections=("compared",)),
    Metric("trajectory.rpe_metre.rotation_rmse", "RPE per m", "trajectory", "deg", 3, DEGREES, "less"),
    Metric("trajectory.rpe_second.translation_rmse", "RPE per s", "trajectory", "mm", 1, MM, "less"),
    Metric("trajectory.rpe_second.rotation_rmse", "RPE per s", "trajectory", "deg", 3, DEGREES, "less"),
    Metric("trajectory.relations.translation_mean", "relations", "trajectory", "mm", 1, MM, "less",
           selections=("compared",)),
    Metric("trajectory.relations.rotation_mean", "relations", "trajectory", "deg", 3, DEGREES, "less"),
    Metric("trajectory.final_drift", "final drift", "trajectory", "m", better="less",
           selections=("compared",)),
    Metric("trajectory.ate_max", "ATE, largest", "trajectory", "m", better="less", detail=True),
    Metric("trajectory.ate_max_3d", "ATE in space, largest", "trajectory", "m", better="less", detail=True),
    Metric("trajectory.rotation_rmse_3d", "attitude error", "trajectory", "deg", 3, DEGREES, "less",
           detail=True),
    Metric("trajectory.ate_rmse_online", "ATE online", "trajectory", "m", better="less", detail=True),
    *_alarm_metrics("mapper", "own", "runs"),
    *_alarm_metrics("watch", "watch"),
    Metric("trajectory.inside_95", "errors in 95 % ellipse", "trajectory", "%", 0, PERCENT, tested=False),
    Metric("trajectory.yaw_rmse", "yaw error", "trajectory", "deg", 3, DEGREES, "less", detail=True),
    Metric("trajectory.final_yaw_drift", "final yaw drift", "trajectory", "deg", 3, DEGREES, "less",
           detail=True),
    Metric("trajectory.relations.translation_std", "relations, std", "trajectory", "mm", 1, MM, detail=True),
    Metric("trajectory.relations.rotation_std", "relations, std", "trajectory", "deg", 3, DEGREES,
           detail=True),
    Metric("map.f1_aligned", "walls agree", "map", "%", 0, PERCENT, "more", ALL_PLACES),
    Metric("map.false_occupied_aligned", "walls false", "map", "%", 0, PERCENT, "less", ALL_PLACES),
    Metric("map.start_shift", "start shift", "map", "m", better="less", selections=("picture",)),
    Metric("map.start_turn", "start turn", "map", "deg", 2, DEGREES, "less", selections=("picture",)),
    Metric("map.f1", "F1 unaligned", "map", better="more"),
    Metric("map.precision", "precision", "map", better="more"),
    Metric("map.recall", "recall", "map", better="more"),
    Metric("map.iou", "IoU", "map", better="more"),
    Metric("map.ssim", "SSIM", "map", better="more"),
    Metric("map.f1_input", "F1 input map", "map", better="more"),
    Metric("map.precision_input", "precision input map", "map", better="more", detail=True),
    Metric("map.recall_input", "recall input map", "map", better="more", detail=True),
    Metric("map.false_occupied", "false unaligned", "map", better="less"),
    Metric("map.reference_false_occupied", "false at true poses", "map", better="less"),
    Metric("map.to_reference.mean", "to true, mean", "map", "mm", 1, MM, "less"),
    Metric("map.to_reference.p95", "to true, 95 %", "map", "mm", 1, MM, "less"),
    Metric("map.from_reference.mean", "from true, mean", "map", "mm", 1, MM, "less"),
    Metric("map.from_reference.p95", "from true, 95 %", "map", "mm", 1, MM, "less"),
    Metric("map.unknown", "unknown", "map", better="less", selections=("picture",)),
    Metric("map.elevation_rmse_aligned", "elevation error", "map", "m", 3, 1.0, "less", ALL_PLACES),
    Metric("map.elevation_seen", "ground seen", "map", "%", 0, PERCENT, "more", ALL_PLACES),
    Metric("map.elevation_rmse", "elevation error, unaligned", "map", "m", better="less"),
    Metric("map.reference_elevation_rmse", "elevation error of the true poses", "map", "m", better="less",
           tested=False),
    Metric("trajectory.ate_rmse_3d", "ATE in space", "trajectory", "m", better="less", short="ATE 3D [m]",
           selections=("picture", "runs", "summary", "compared", "distribution"), baseline=ODOMETRY_ATE_3D),
    Metric(ODOMETRY_ATE_3D, "ATE in space of odometry", "trajectory", "m", better="less", tested=False,
           selections=("picture", "runs", "summary"), short="odom. ATE 3D [m]"),
    Metric("trajectory.ate_rmse_3d_unaligned", "ATE in space, unaligned", "trajectory", "m", better="less",
           selections=("picture",)),
    Metric("collisions.max_penetration", "deepest contact", "contacts", "mm", 2, MM, "less",
           selections=("picture", "compared")),
    Metric("collisions.penetration_p999", "99.9 %", "contacts", "mm", 2, MM, "less"),
    Metric("collisions.body_contacts", "body contacts", "contacts", digits=0, better="less"),
    Metric("collisions.body_contact_seconds", "for", "contacts", "s", 2, better="less"),
    Metric("cost.cpu_seconds", "CPU time", "cost", "s", 1, better="less", selections=("compared",)),
    Metric("cost.peak_memory", "peak memory", "cost", "MB", 0, MEGABYTE, "less", selections=("compared",)),
    Metric("cost.compile_seconds", "JIT", "cost", "s", 1, better="less"),
    Metric("cost.scans_dropped", "scans dropped", "cost", digits=0, better="less"),
    Metric("mapper.ms_p50", "scan, median", "cost", "ms", 2, better="less"),
    Metric("mapper.ms_p95", "scan, 95 %", "cost", "ms", 2, better="less"),
)  # fmt: skip
"""Every metric of a run, in the order of its tables."""


def value_at(entry: Entry, key: str) -> Any:
    """Return the value at a dotted key; None where it does not exist."""
    found: Any = entry
    for part in key.split("."):
        found = found.get(part) if isinstance(found, Mapping) else None
    return found


def text_at(entry: Entry, key: str) -> str:
    """Return the text at a dotted key."""
    value = value_at(entry, key)
    return NOTHING if value is None else str(value)


def significant(value: float) -> str:
    """Return a number with three significant digits, and no exponent below a million.

    >>> significant(0.01094), significant(41.27), significant(1234.5), significant(6.1077e12)
    ('0.0109', '41.3', '1234', '6.11e+12')
    """
    if value == 0 or not abs(value) < 1e6:
        return f"{value:.3g}"
    return f"{value:.{max(0, 2 - math.floor(math.log10(abs(value))))}f}"


def span(values: Sequence[float]) -> str:
    """Return the smallest and the largest of numbers, or the one number."""
    low, high = significant(min(values)), significant(max(values))
    return low if low == high else f"{low} to {high}"


def metrics_in(*sections: Section) -> tuple[Metric, ...]:
    """Return the metrics of sections of the report, details left out."""
    return tuple(metric for metric in METRICS if metric.section in sections and not metric.detail)


def metrics_selected(selection: Selection) -> tuple[Metric, ...]:
    """Return the metrics of a selection, the RTF last: narrow screens hide it first."""
    selected = (metric for metric in METRICS if selection in metric.selections)
    return tuple(sorted(selected, key=lambda metric: metric.section == "rtf"))


def metrics_named(keys: Sequence[str]) -> tuple[Metric, ...]:
    """Return metrics by their keys."""
    known = {metric.key: metric for metric in METRICS}
    for key in keys:
        require_known("metric", key, known)
    return tuple(known[key] for key in keys)


def rtf_counts(entry: Entry) -> bool:
    """Return whether a run's RTF counts: it had the processor to itself."""
    return value_at(entry, "rtf.mean") is not None and not other_load(entry)


def other_load(entry: Entry) -> str:
    """Return what else used the processor during a run; empty without."""
    load, cores = value_at(entry, "rtf.load_average"), value_at(entry, "machine.cores")
    if value_at(entry, "rtf.concurrent"):
        return "other programs" if load is None else "other runs"
    return "other programs" if load is not None and cores is not None and load > cores else ""


def picture_lines(entry: Entry) -> list[tuple[str, str]]:
    """Return names and values for a run's picture, verdict and status first."""
    lines = [("verdict", entry["verdict"]["class"]), ("status", str(entry["status"]))]
    return lines + metric_lines(entry, "picture")


def metric_lines(entry: Entry, selection: Selection) -> list[tuple[str, str]]:
    """Return names and values of a selection; those that do not exist are left out."""
    lines = list[tuple[str, str]]()
    for metric in metrics_selected(selection):
        if (value := value_at(entry, metric.key)) is not None:
            lines.append((metric.name, metric.text(value)))
            if metric.key == ODOMETRY_ATE and worse_than_odometry(entry):
                lines.append(("", WORSE))
    return lines


def is_worse(ate: float | None, odometry: float | None) -> bool:
    """Return whether an ATE is visibly larger than the odometry's; False if one is None."""
    return ate is not None and odometry is not None and ate > odometry + VISIBLE_ERROR


def worse_than_odometry(entry: Entry) -> bool:
    """Return whether an ATE is larger than the odometry's.

    The entry is a run's, a score's or a mapped log's record.
    """
    return is_worse(value_at(entry, ATE), value_at(entry, ODOMETRY_ATE))


def worse_lines(entries: Sequence[Entry]) -> list[str]:
    """Return a line for each run whose mapper is worse than its odometry."""
    lines = []
    for entry in filter(worse_than_odometry, entries):
        keys = ("world.name", "config.robot", "config.mapper")
        run = f"{', '.join(text_at(entry, key) for key in keys)}, seed {text_at(entry, 'config.seed')}"
        ate, odometry = value_at(entry, ATE), value_at(entry, ODOMETRY_ATE)
        lines.append(f"{run}: {WORSE} (ATE {ate:.3f} m, odometry {odometry:.3f} m)")
    return lines
