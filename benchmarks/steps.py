"""Steps that benchmarks share: options of the command line, tables, limits."""

from __future__ import annotations

import argparse
import gc
import resource
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
"""Folder in which logs, maps and pictures may lie beside a checkout."""
Limits = Mapping[str, tuple[str, str, float]]
"""Limit of each figure: in words, `<=` or `>=`, and how much."""


def arguments(
    doc: str | None, *positional: str, words: Sequence[str] | None = None, **defaults: Any
) -> argparse.Namespace:
    """Return the values of options; each has the type of its default, and a type stands for no default."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawTextHelpFormatter)
    for name, default in defaults.items():
        flag = name if name in positional else f"--{name.replace('_', '-')}"
        if default is False:
            parser.add_argument(flag, action="store_true")
        elif isinstance(default, Sequence) and not isinstance(default, str):
            parser.add_argument(flag, nargs="*", default=default)
        elif isinstance(default, type):
            parser.add_argument(flag, type=default)
        else:
            parser.add_argument(flag, type=type(default), default=default, **_optional(flag))
    return parser.parse_args(words)


def _optional(flag: str) -> dict[str, Any]:
    return {} if flag.startswith("--") else {"nargs": "?"}


def print_rows(rows: Iterable[Mapping[str, Any]], title: str = "", width: int | None = None) -> None:
    """Print rows as a table with a column for each key of the first; one row alone as a list."""
    shown = list(rows)
    table = Table(title=title or None)
    if len(shown) == 1:
        table.add_column("figure")
        table.add_column("value")
        for key, value in shown[0].items():
            table.add_row(key, cell(value))
    else:
        columns = list(shown[0]) if shown else []
        for key in columns:
            table.add_column(key, overflow="fold")
        for row in shown:
            table.add_row(*(cell(row.get(key)) for key in columns))
    Console(width=width).print(table)


def cell(value: Any) -> str:
    """Return a value of a table as text."""
    if isinstance(value, list):
        return ", ".join(map(str, value))
    return "-" if value is None else f"{value:.3g}" if isinstance(value, float) else str(value)


def print_limits(figures: Mapping[str, float], limits: Limits) -> bool:
    """Print the figures beside their limits; return whether all are kept."""
    table, kept = Table("figure", "measured", "limit", "kept"), True
    for key, (words, sign, limit) in limits.items():
        holds = figures[key] <= limit if sign == "<=" else figures[key] >= limit
        table.add_row(words, f"{figures[key]:.4g}", f"{sign} {limit:g}", "yes" if holds else "no")
        kept &= holds
    Console().print(table)
    return kept


def resident_mb() -> float:
    """Return the resident memory of this process, MB; Linux only."""
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 1e6
