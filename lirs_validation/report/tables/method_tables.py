"""One row for each world and method: as published, with attitude, odometry alone, and what follows."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from lirs_validation.analysis.as_published import (
    MOST,
    SLACK,
    SUFFIX,
    TIMES,
    UNCHECKED,
    MethodPair,
    attitude_pairs,
    conclusion,
    outcome_of,
    published_pairs,
)
from lirs_validation.analysis.groups import RunGroup, distinguishing_fields
from lirs_validation.record.formatting import Entry
from lirs_validation.record.metric_catalog import metrics_named
from lirs_validation.record.odometry import ATE, ODOMETRY_ATE, WORSE, WORSE_MARK
from lirs_validation.record.run_record import succeeded
from lirs_validation.report.tables.metric_tables import group_texts, over_runs
from lirs_validation.report.tables.table import Content, ReportTable

ERROR, ODOMETRY_ERROR = metrics_named((ATE, ODOMETRY_ATE))
CAPTION = (
    "ATE [m], mean over the runs that succeeded. A run holds where its ATE is at most "
    f"{TIMES} x the odometry's + {SLACK} m, a method where {MOST:.0%} of its runs do. Runs that tipped over, "
    f"got stuck, left the world or diverged are not counted. {WORSE_MARK} {WORSE} in at least one run."
)
KINDS: tuple[tuple[str, str, Callable[[Iterable[Entry]], tuple[MethodPair, ...]]], ...] = (
    ("as-published", "As published, with attitude, odometry alone", published_pairs),
    ("without-attitude", "Without attitude, with attitude, odometry alone", attitude_pairs),
)


def method_tables(entries: Sequence[Entry]) -> tuple[ReportTable, ...]:
    """Return the tables of methods as published and of mappers without attitude, as far as there are runs."""
    tables = (_table(key, title, pairs_of(entries)) for key, title, pairs_of in KINDS)
    return tuple(table for table in tables if table.rows)


def _table(key: str, title: str, pairs: Sequence[MethodPair]) -> ReportTable:
    fields = _fields([pair.group for pair in pairs])
    how = pairs[0].how if pairs else ""
    headings = (
        *fields,
        how,
        f"holds {how}",
        "with attitude",
        "holds with attitude",
        "odometry",
        "what follows",
    )
    rows = tuple((*group_texts(pair.group, fields), *_row(pair)) for pair in pairs)
    return ReportTable(key, title, CAPTION + _unchecked(pairs), headings, rows, len(fields), remarks=True)


def _unchecked(pairs: Sequence[MethodPair]) -> str:
    """Return which methods as published have no reference, as sentences; nothing where all have one."""
    names = dict.fromkeys(pair.group["mapper"] for pair in pairs if pair.how == "as published")
    return "".join(
        f" {name}{SUFFIX} was never compared with runs of its original."
        for name in names
        if name in UNCHECKED
    )


def _row(pair: MethodPair) -> tuple[Content, ...]:
    planar, aware = outcome_of(pair.planar), outcome_of(pair.aware)
    driven = {entry["seed"]: entry for entry in pair.runs if succeeded(entry)}
    return (
        over_runs(ERROR, [entry for entry in pair.planar if succeeded(entry)]),
        f"{planar.held} of {planar.runs}",
        over_runs(ERROR, [entry for entry in pair.aware if succeeded(entry)]),
        f"{aware.held} of {aware.runs}",
        over_runs(ODOMETRY_ERROR, list(driven.values())),
        conclusion(planar, aware, pair.how),
    )


def _fields(groups: Sequence[RunGroup]) -> tuple[str, ...]:
    """Return the fields that distinguish the rows, world and method always; attitudes are columns."""
    different = distinguishing_fields(groups) if groups else ()
    rest = (field for field in different if field not in ("world", "mapper", "attitude"))
    return ("world", "mapper", *rest)
