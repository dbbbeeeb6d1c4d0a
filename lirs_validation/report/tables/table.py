"""Tables as data: the same rows as HTML, Markdown and CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from html import escape

from lirs_validation.analysis.repeats import Repeats
from lirs_validation.record.formatting import NOTHING
from lirs_validation.record.metric_catalog import Metric


@dataclass(frozen=True)
class Spread:
    """A metric over the repeats of a group, or of one run.

    Attributes:
        metric: which, in whose unit the values are.
        values: None where no run has it.
        mark: a sign that the caption explains.
        of: how many runs were asked; where fewer have the metric, the text says how many.
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
        """Mean and, of several repeats, the half width of its 95 % interval; how many have it, if not all."""
        if self.values is None:
            return NOTHING
        mean = self.metric.formatted(self.values.mean)
        reach = self.values.half_width
        held = f" ({self.values.count} of {self.of})" if self.partial else ""
        return (mean if reach is None else f"{mean} ± {self.metric.formatted(reach)}") + self.mark + held

    @property
    def without_interval(self) -> Spread:
        """The mean alone."""
        return self if self.values is None else replace(self, values=replace(self.values, half_width=None))


Content = str | Spread


@dataclass(frozen=True)
class ReportTable:
    """A table of the report.

    Attributes:
        key: short name, for links and files.
        title: what it shows.
        caption: how to read it.
        headings: of the columns.
        rows: contents, as many a row as there are headings.
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
    """Return the table as CSV with all digits: of repeated metrics mean, std, half width, values, runs."""
    columns = [_expanded(h, [row[k] for row in table.rows]) for k, h in enumerate(table.headings)]
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow([heading for headings, _ in columns for heading in headings])
    for k in range(len(table.rows)):
        writer.writerow([value for _, rows in columns for value in rows[k]])
    return file.getvalue()


def _expanded(heading: str, contents: Sequence[Content]) -> tuple[list[str], list[list[str]]]:
    """Return the headings of a column and its rows; several of a metric with repeats."""
    spreads = [c for c in contents if isinstance(c, Spread)]
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
