"""The differences of two results: on the screen, as CSV and as JSON."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich import box
from rich.table import Table
from rich.text import Text

from lirs_validation.analysis.compare import LEVEL, Comparison, Difference
from lirs_validation.analysis.groups import FIELDS, Cell, telling
from lirs_validation.record.formatting import NOTHING
from lirs_wct.files import atomic_write


def compare_table(comparison: Comparison, names: tuple[str, str]) -> Table:
    """Return the differences cell by cell, real ones bold; below, how to read them."""
    differences = comparison.differences
    shown = telling(d.cell for d in differences)
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False, caption_justify="left")
    table.title, table.title_justify = Text(f"a = {names[0]}, b = {names[1]}"), "left"
    for heading in ("cell", "figure"):
        table.add_column(heading, overflow="fold")
    for heading in ("a", "b", "b - a", "95 %", "n", "p", ""):
        table.add_column(heading, justify="left" if heading == "" else "right", no_wrap=True)
    before: Cell | None = None
    for d in differences:
        named = "" if d.cell == before else d.cell.named(shown)
        before = d.cell
        table.add_row(*map(Text, (named, *told(d))), style="bold" if d.real else "")
    table.caption = Text(reading(comparison))
    return table


def told(d: Difference) -> tuple[str, ...]:
    """Return figure, means, difference, interval, pairs, corrected p and the verdict, as text."""
    say = d.figure.told
    interval = NOTHING if d.low is None else f"{say(d.low)} .. {say(d.high)}"
    p = NOTHING if d.p_corrected is None else f"{d.p_corrected:.3f}" if d.p_corrected >= 0.001 else "<0.001"
    return (d.figure.heading, say(d.a), say(d.b), say(d.difference), interval, str(d.pairs), p, verdict(d))


def verdict(d: Difference) -> str:
    """Say in a word or two what the difference is."""
    if d.real is None:
        return "one seed"
    if not d.real:
        return "not shown"
    if d.figure.better is None:
        return "real"
    return "b better" if (d.difference > 0) == (d.figure.better == "more") else "b worse"


def reading(comparison: Comparison) -> str:
    """Say how the table is to be read, what could not be compared, and what failed."""
    tests = sum(d.p is not None for d in comparison.differences)
    lines = []
    if any(d.pairs == 1 for d in comparison.differences):
        lines.append("One seed in common: of its differences nothing can be said. Run more: --seeds 1-5.")
    if tests:
        real = sum(d.real is True for d in comparison.differences)
        lines.append(
            f"{real} of {tests} tested differences are real: paired by seed, 95 % intervals of the mean "
            f"difference, two-sided p below {LEVEL} after Holm's correction for {tests} tests."
        )
    used = sorted({d.test for d in comparison.differences if d.test in ("Wilcoxon", "sign")})
    if used:
        lines.append(f"Tests beside the paired t: {', '.join(used)}.")
    for name, cells in (("a", comparison.only_a), ("b", comparison.only_b)):
        if cells:
            lines.append(f"Only in {name}: {'; '.join(cell.named() for cell in cells)}.")
    lines += _failures(comparison)
    return "\n".join(lines)


def write_compare_csv(path: Path, comparison: Comparison) -> None:
    """Write the differences as CSV.

    Raises:
        OutputError: the file cannot be written.
    """
    with atomic_write(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        rows = [as_dict(d) for d in comparison.differences]
        writer = csv.DictWriter(file, list(rows[0]) if rows else [*FIELDS])
        writer.writeheader()
        writer.writerows(rows)


def write_compare_json(path: Path, comparison: Comparison, names: tuple[str, str]) -> None:
    """Write the differences as JSON.

    Raises:
        OutputError: the file cannot be written.
    """
    document = {
        "a": names[0],
        "b": names[1],
        "differences": [as_dict(d) for d in comparison.differences],
        "only_a": _cells(comparison.only_a),
        "only_b": _cells(comparison.only_b),
    }
    with atomic_write(path) as temporary:
        temporary.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def as_dict(d: Difference) -> dict[str, Any]:
    """Return a difference as one flat row."""
    return {
        **asdict(d.cell),
        "figure": d.figure.place,
        "unit": d.figure.unit,
        **{key: getattr(d, key) for key in ("a", "b", "difference", "low", "high", "pairs", "test", "p")},
        "p_corrected": d.p_corrected,
        "real": d.real,
        "verdict": verdict(d),
    }


def _cells(cells: Sequence[Cell]) -> list[dict[str, Any]]:
    return [asdict(cell) for cell in cells]


def _failures(comparison: Comparison) -> list[str]:
    """Say of which cells runs failed: they are in no mean."""
    lines = []
    for cell, (sound_a, failed_a) in comparison.failed_a.items():
        sound_b, failed_b = comparison.failed_b[cell]
        if failed_a or failed_b:
            lines.append(
                f"{cell.named()}: {failed_a} of {sound_a + failed_a} runs failed in a, "
                f"{failed_b} of {sound_b + failed_b} in b; their seeds are left out."
            )
    return lines
