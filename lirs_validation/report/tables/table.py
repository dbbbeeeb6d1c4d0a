"""Tables as data, and their forms: screen, HTML, Markdown and CSV."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from html import escape
from typing import Literal

from rich import box
from rich.console import Console, ConsoleOptions
from rich.table import Table
from rich.text import Text

from lirs_validation.analysis.statistics import Repeats
from lirs_validation.record.formatting import NOTHING
from lirs_validation.record.metric_catalog import Metric

UNBOUNDED = 100_000
"""Width of a screen that fits every table, characters."""
BETWEEN_WORDS = re.compile(r"(?<=[\w,.]) (?=\w)| (?=\[)")
"""Line breaks of headings: between words and before a unit, not within `99.9 %` or `b - a`."""
FEWEST = 2
"""Smallest number of shown number columns."""


@dataclass(frozen=True)
class MetricSpread:
    """A metric over the repeats of a group, or of one run.

    Attributes:
        metric: metric, with the unit of the values.
        values: statistics; None if no run has the metric.
        mark: sign that the caption explains.
        of: number of runs; if fewer have the metric, the text states their number.
    """

    metric: Metric
    values: Repeats | None
    mark: str = ""
    of: int = 0

    @property
    def partial(self) -> bool:
        """Whether only some of the runs have the metric."""
        return self.values is not None and self.values.count < self.of

    @property
    def text(self) -> str:
        """Mean, half width of its 95 % interval, and the number of values if incomplete."""
        if self.values is None:
            return NOTHING
        mean = self.metric.formatted(self.values.mean)
        reach = self.values.half_width
        held = f" ({self.values.count} of {self.of})" if self.partial else ""
        return (mean if reach is None else f"{mean} ± {self.metric.formatted(reach)}") + self.mark + held

    @property
    def without_interval(self) -> MetricSpread:
        """The mean alone."""
        return self if self.values is None else replace(self, values=replace(self.values, half_width=None))


Content = str | MetricSpread


@dataclass(frozen=True)
class ReportTable:
    """A table of the report.

    Attributes:
        key: short name, for links and files.
        title: title of the table.
        caption: explanation below the table.
        headings: headings of the columns.
        rows: contents of the cells, one per heading.
        text_columns: number of leading columns that hold text; the first is the row's heading.
        remarks: whether the last column holds text, too.
    """

    key: str
    title: str
    caption: str
    headings: tuple[str, ...]
    rows: tuple[tuple[Content, ...], ...]
    text_columns: int = 1
    remarks: bool = False

    def is_text(self, column: int) -> bool:
        """Whether a column, counted from 0, holds text."""
        return column < self.text_columns or (self.remarks and column == len(self.headings) - 1)

    def __repr__(self) -> str:
        return f"ReportTable({self.title!r}, {len(self.rows)} rows)"

    def _repr_html_(self) -> str:
        head = "".join(f"<th>{escape(heading)}</th>" for heading in self.headings)
        rows = ("".join(f"<td>{escape(text)}</td>" for text in row) for row in self.texts())
        body = "".join(f"<tr>{cells}</tr>" for cells in rows)
        return f"<b>{escape(self.title)}</b><table><tr>{head}</tr>{body}</table><p>{escape(self.caption)}</p>"

    def texts(self) -> list[list[str]]:
        """Return the rows as they are read."""
        return [[c if isinstance(c, str) else c.text for c in row] for row in self.rows]


def as_markdown(table: ReportTable) -> str:
    """Return the table as Markdown, its title above and its caption below."""
    rule = ["---" if table.is_text(k) else "---:" for k in range(len(table.headings))]
    lines = [table.headings, rule, *table.texts()]
    body = "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)
    return f"## {table.title}\n\n{body}\n\n{table.caption}\n"


def as_csv(table: ReportTable) -> str:
    """Return the table as CSV with all digits; repeated metrics get five columns."""
    columns = [_expand_column(h, [row[k] for row in table.rows]) for k, h in enumerate(table.headings)]
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow([heading for headings, _ in columns for heading in headings])
    for k in range(len(table.rows)):
        writer.writerow([value for _, rows in columns for value in rows[k]])
    return file.getvalue()


def _expand_column(heading: str, contents: Sequence[Content]) -> tuple[list[str], list[list[str]]]:
    """Return the headings of a column and its rows; several of a metric with repeats."""
    spreads = [c for c in contents if isinstance(c, MetricSpread)]
    if not any(s.values is not None and max(s.values.count, s.of) > 1 for s in spreads):
        return [heading], [
            [c if isinstance(c, str) else _digits(c.values.mean if c.values else None)] for c in contents
        ]
    headings = [heading, f"{heading} std", f"{heading} 95 % half width", f"{heading} n", f"{heading} of"]
    return headings, [[c, *[""] * 4] if isinstance(c, str) else _parts(c.values, c.of) for c in contents]


def _parts(values: Repeats | None, of: int) -> list[str]:
    if values is None:
        return ["", "", "", "0", str(of)]
    return [*map(_digits, (values.mean, values.std, values.half_width)), str(values.count), str(of)]


def _digits(value: float | None) -> str:
    return "" if value is None else repr(value)


def screen_table(title: str = "", caption: str = "") -> Table:
    """Return a table without columns: narrow, ruled below its head alone, captions to the left.

    Titles and captions are plain text: a name may hold brackets, which rich would take for its markup.
    """
    return Table(
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        pad_edge=False,
        title=Text(title) if title else None,
        title_justify="left",
        caption=Text(caption) if caption else None,
        caption_justify="left",
    )


class FittedTable:
    """A table that fits the screen without broken names, numbers or units.

    A table that is too wide loses the intervals of its means, then columns, which the caption lists: first
    those in `drop`, then metrics that the table of runs omits, then the last ones. Remarks are lines below.
    """

    def __init__(
        self,
        table: ReportTable,
        *,
        title: str = "",
        styles: Sequence[str] = (),
        drop: Sequence[str] = (),
        keep: Sequence[str] = (),
    ) -> None:
        """Store a table, its row styles, the headings to drop first and those to keep."""
        self.table = _remarks_below(table)
        self._title, self._drop, self._keep = title, tuple(drop), tuple(keep)
        self._styles = tuple(styles) or ("",) * len(table.rows)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Table]:
        """Yield the first form that fits."""
        wide = options.update(width=UNBOUNDED)
        shown = Table()
        for form in self._forms():
            shown = self._draw(form, whole=True)
            if console.measure(shown, options=wide).maximum <= options.max_width:
                yield shown
                return
        yield self._draw(form, whole=False)

    def _forms(self) -> Iterator[ReportTable]:
        """Yield the table as it is, without intervals, and with fewer and fewer columns."""
        yield self.table
        table, gone = self.table, list[str]()
        if any(isinstance(c, MetricSpread) and c != c.without_interval for row in table.rows for c in row):
            table, gone = _means_alone(table), ["intervals (±)"]
            yield _note_hidden(table, gone)
        for column in self._dropped_in_order():
            gone.append(self.table.headings[column])
            yield _note_hidden(_without(table, gone), gone)

    def _dropped_in_order(self) -> list[int]:
        """Return the columns that may be hidden, the first to hide first."""
        headings = self.table.headings
        numbers = [k for k, h in enumerate(headings) if not self.table.is_text(k) and h not in self._keep]
        return sorted(numbers, key=self._rank)[: max(0, len(numbers) - FEWEST)]

    def _rank(self, column: int) -> tuple[int, int]:
        """Return a column's rank: `drop`, metrics outside the table of runs, others."""
        heading = self.table.headings[column]
        if heading in self._drop:
            return 0, self._drop.index(heading)
        contents = [row[column] for row in self.table.rows]
        detail = any(isinstance(c, MetricSpread) and "runs" not in c.metric.selections for c in contents)
        return 1 if detail else 2, -column

    def _draw(self, table: ReportTable, *, whole: bool) -> Table:
        """Return a table for the screen; cells are plain text, since names may hold brackets."""
        shown = screen_table(self._title, table.caption)
        for k, heading in enumerate(table.headings):
            justify: Literal["left", "right"] = "left" if table.is_text(k) else "right"
            stacked = BETWEEN_WORDS.sub("\n", heading)
            shown.add_column(Text(stacked), justify=justify, no_wrap=whole, overflow="fold")
        for row, style in zip(table.texts(), self._styles, strict=True):
            shown.add_row(*map(Text, row), style=style)
        return shown


def _remarks_below(table: ReportTable) -> ReportTable:
    """Return the table with its remarks as lines of the caption."""
    if not table.remarks:
        return table
    lines = [f"{', '.join(row[: table.text_columns])}: {row[-1]}" for row in table.texts()]
    return replace(
        table,
        headings=table.headings[:-1],
        rows=tuple(row[:-1] for row in table.rows),
        caption="\n".join((*lines, table.caption)),
        remarks=False,
    )


def _means_alone(table: ReportTable) -> ReportTable:
    """Return a table of the means alone."""

    def mean(content: Content) -> Content:
        return content.without_interval if isinstance(content, MetricSpread) else content

    return replace(table, rows=tuple(tuple(map(mean, row)) for row in table.rows))


def _without(table: ReportTable, headings: Sequence[str]) -> ReportTable:
    """Return a table without some of its columns."""
    kept = [k for k, heading in enumerate(table.headings) if heading not in headings]
    return replace(
        table,
        headings=tuple(table.headings[k] for k in kept),
        rows=tuple(tuple(row[k] for k in kept) for row in table.rows),
    )


def _note_hidden(table: ReportTable, gone: Sequence[str]) -> ReportTable:
    """Return a table whose caption lists the hidden columns."""
    note = f"Columns hidden (widen the terminal): {', '.join(gone)}."
    return replace(table, caption=f"{table.caption}\n{note}".lstrip())
