"""Collision verdicts as a table on the screen, as JSON and as CSV."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

from rich import box
from rich.table import Table
from rich.text import Text

from lirs_validation.collision.validation import Check, CollisionVerdict
from lirs_wct.files import atomic_write

SCHEMA = 1


def write_verdicts(folder: Path, verdicts: Sequence[CollisionVerdict]) -> tuple[Path, Path]:
    """Write `collisions.json` and `collisions.csv`; return their paths.

    Raises:
        OutputError: the folder cannot be written.
    """
    document = {"schema": SCHEMA, "collisions": [verdict.as_dict() for verdict in verdicts]}
    with atomic_write(folder / "collisions.json") as path:
        path.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    with (
        atomic_write(folder / "collisions.csv") as path,
        path.open("w", newline="", encoding="utf-8") as file,
    ):
        rows = [asdict(verdict) | {"passed": verdict.passed} for verdict in verdicts]
        writer = csv.DictWriter(file, list(rows[0]) if rows else ["world"])
        writer.writeheader()
        writer.writerows(rows)
    return folder / "collisions.json", folder / "collisions.csv"


COLUMNS: tuple[tuple[str, Callable[[CollisionVerdict], str]], ...] = (
    ("world", lambda v: v.world),
    ("robot", lambda v: v.robot),
    ("terrain", lambda v: v.terrain),
    ("seed", lambda v: str(v.seed)),
    ("", lambda v: "ok" if v.passed else "FAIL"),
    ("99.9 %\n[mm]", lambda v: f"{1e3 * v.penetration_p999:.1f}"),
    ("peak\n[mm]", lambda v: f"{1e3 * v.penetration_peak:.1f}"),
    ("legal\n[mm]", lambda v: f"{1e3 * v.penetration_limit:.0f}"),
    ("gain\n[%]", lambda v: f"{100 * v.energy_gain / v.energy_limit:.0f}"),
    ("force\n[N]", lambda v: f"{v.force_peak:.0f}"),
    ("slope\n[deg]", lambda v: "-" if v.slope is None else f"{v.slope:.0f}"),
    ("tips", lambda v: str(v.tip_overs)),
)
"""Heading and content; the energy gained stands as a share of its limit."""
COMMON = ("robot", "terrain", "seed")
"""Columns that move into the title where all verdicts have the same, so that the table fits 80 characters."""


def verdicts_table(verdicts: Sequence[CollisionVerdict]) -> Table:
    """Return the verdicts as a table, failures first; below it each figure that is over its limit."""
    ordered = sorted(verdicts, key=lambda verdict: verdict.passed)
    common = [c for c in COLUMNS if c[0] in COMMON and len({c[1](v) for v in ordered}) == 1]
    failures = "\n".join(line for verdict in ordered for line in failed(verdict))
    table = Table(
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        pad_edge=False,
        title=Text(", ".join(f"{name} {told(ordered[0])}" for name, told in common)) if common else None,
        title_justify="left",
        caption=Text(failures) if failures else None,
        caption_justify="left",
    )
    columns = [c for c in COLUMNS if c not in common]
    for heading, _ in columns:
        word = heading in ("world", "robot", "terrain")
        table.add_column(
            Text(heading), justify="left" if word else "right", overflow="fold", no_wrap=not word
        )
    for verdict in ordered:
        cells = (Text(told(verdict)) for _, told in columns)
        table.add_row(*cells, style="" if verdict.passed else "bold red")
    return table


def failed(verdict: CollisionVerdict) -> list[str]:
    """Return a line for each figure that is over its limit."""
    who = f"{verdict.world}, {verdict.robot}, {verdict.terrain}, seed {verdict.seed}"
    return [
        f"{who}: {verdict.diverged if check.name == 'diverged' else _over(check)}"
        for check in verdict.checks
        if not check.passed
    ]


def _over(check: Check) -> str:
    unit = f" {check.unit}" if check.unit else ""
    limit = "at least" if check.least else "at most"
    return f"{check.name} {check.value:.3g}{unit}, legal: {limit} {check.limit:.3g}{unit}"
