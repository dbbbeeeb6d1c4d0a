"""Tables as data, and their forms: screen, HTML, Markdown and CSV."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import astuple, dataclass, replace
from html import escape
from itertools import chain
from typing import Literal

from rich import box
from rich.console import Console, ConsoleOptions
from rich.table import Table
from rich.text import Text

from lirs_validation.analysis.compare import Repeats
from lirs_validation.record.metric_catalog import NOTHING, Metric

BETWEEN_WORDS = re.compile(r"(?<=[\w,.]) (?=\w)| (?=\[)")
"""Line breaks of headings: between words and before a unit, not within `99.9 %` or `b - a`."""


@dataclass(frozen=True)
class MetricSpread:
    """A metric over the repeats of a group, or of one run.

    Attributes:
        values: Statistics; None if no run has the metric.
        mark: Sign that the caption explains.
        of: Number of runs; if fewer have the metric, the text states their number.
    """

    metric: Metric
    values: Repeats | None
    mark: str = ""
    of: int = 0

    @property
    def partial(self) -> bool:
        """Whether only some of the runs have the metric."""
        return self.values is not None and self.values.count < self.of

    def __str__(self) -> str:
        """Mean, half width of its 95 % interval, and the number of values if incomplete."""
        if self.values is None:
            return NOTHING
        text = self.metric.formatted(self.values.mean)
        if self.values.half_width is not None:
            text += f" ± {self.metric.formatted(self.values.half_width)}"
        return text + self.mark + (f" ({self.values.count} of {self.of})" if self.partial else "")

    def numbers(self) -> tuple[float | None, ...]:
        """Return mean, standard deviation, half width of the interval, number of values and of runs."""
        found = (None, None, None, 0) if self.values is None else astuple(self.values)
        return *found, self.of


Content = str | MetricSpread


@dataclass(frozen=True)
class ReportTable:
    """A table of results; rich folds it so that it fits the screen.

    Attributes:
        key: Short name, for links and files.
        rows: Contents of the cells, one per heading.
        text_columns: Number of leading columns that hold text; the first is the row's heading.
        remarks: Whether the last column holds text, too.
        styles: Style of each row on the screen; empty = plain.
    """

    key: str
    title: str
    caption: str
    headings: tuple[str, ...]
    rows: tuple[tuple[Content, ...], ...]
    text_columns: int = 1
    remarks: bool = False
    styles: tuple[str, ...] = ()

    def is_text(self, column: int) -> bool:
        """Whether a column, counted from 0, holds text."""
        return column < self.text_columns or (self.remarks and column == len(self.headings) - 1)

    @property
    def has_numbers(self) -> bool:
        """Whether any column holds numbers."""
        return len(self.headings) > self.text_columns

    def texts(self) -> list[list[str]]:
        """Return the rows as text."""
        return [list(map(str, row)) for row in self.rows]

    def with_common_in_title(self, names: Collection[str], unnamed: Collection[str] = ()) -> ReportTable:
        """Return the table with those named columns that hold one value moved to its title.

        The title has the values of `unnamed` columns without their names.
        """
        columns = {h: {str(row[k]) for row in self.rows} for k, h in enumerate(self.headings)}
        common = {h: texts.pop() for h, texts in columns.items() if h in names and len(texts) == 1}
        kept = [k for k, heading in enumerate(self.headings) if heading not in common]
        return replace(
            self,
            title=", ".join(text if name in unnamed else f"{name} {text}" for name, text in common.items()),
            headings=tuple(self.headings[k] for k in kept),
            rows=tuple(tuple(row[k] for k in kept) for row in self.rows),
            text_columns=self.text_columns - len(common),
        )

    def __repr__(self) -> str:
        return f"ReportTable({self.title!r}, {len(self.rows)} rows)"

    def _repr_html_(self) -> str:
        head = "".join(f"<th>{escape(heading)}</th>" for heading in self.headings)
        rows = ("".join(f"<td>{escape(text)}</td>" for text in row) for row in self.texts())
        body = "".join(f"<tr>{cells}</tr>" for cells in rows)
        return f"<b>{escape(self.title)}</b><table><tr>{head}</tr>{body}</table><p>{escape(self.caption)}</p>"

    def as_markdown(self) -> str:
        """Return the table as Markdown, its title above and its caption below."""
        rule = ["---" if self.is_text(k) else "---:" for k in range(len(self.headings))]
        escaped = (
            [cell.replace("|", "\\|") for cell in line] for line in (self.headings, rule, *self.texts())
        )
        body = "\n".join(f"| {' | '.join(cells)} |" for cells in escaped)
        return f"## {self.title}\n\n{body}\n\n{self.caption}\n"

    def as_csv(self) -> str:
        """Return the table as CSV with all digits; repeated metrics get five columns."""
        columns = [_csv_column(h, [row[k] for row in self.rows]) for k, h in enumerate(self.headings)]
        file = io.StringIO()
        csv.writer(file, lineterminator="\n").writerows(chain(*cells) for cells in zip(*columns, strict=True))
        return file.getvalue()

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Table]:
        """Yield the table for the screen.

        On a narrow screen intervals stand below their means, and the last columns of numbers are omitted,
        which the caption says. Titles, captions and cells are plain text: a name may hold brackets, which
        rich would take for its markup.
        """
        headings = [BETWEEN_WORDS.sub("\n", heading) for heading in self.headings]
        texts, columns, hidden = self.texts(), list(range(len(headings))), list[str]()
        if _width(headings, texts, columns) > options.max_width:
            texts = [[text.replace(" ± ", "\n± ") for text in row] for row in texts]
        numbers = [k for k in columns if not self.is_text(k)]
        while _width(headings, texts, columns) > options.max_width and len(numbers) > 2:
            columns.remove(numbers[-1])
            hidden.insert(0, self.headings[numbers.pop()])
        lines = [self.caption] if self.caption else []
        lines += [f"Columns hidden (widen the terminal): {', '.join(hidden)}."] if hidden else []
        table = Table(
            box=box.SIMPLE_HEAD,
            padding=(0, 1, 0, 0),
            pad_edge=False,
            title=Text(self.title) if self.title else None,
            title_justify="left",
            caption=Text("\n".join(lines)) if lines else None,
            caption_justify="left",
        )
        for k in columns:
            prose = self.is_text(k) and any(" " in row[k] for row in texts)
            justify: Literal["left", "right"] = "left" if self.is_text(k) else "right"
            table.add_column(Text(headings[k]), justify=justify, no_wrap=not prose, overflow="fold")
        for row, style in zip(texts, self.styles or ("",) * len(texts), strict=True):
            table.add_row(*(Text(row[k]) for k in columns), style=style)
        yield table


def _width(headings: Sequence[str], texts: Sequence[Sequence[str]], columns: Sequence[int]) -> int:
    """Return the width of columns whose text breaks between words, characters."""
    parts = ([headings[k], *(row[k] for row in texts)] for k in columns)
    words = (re.split(r"\n|(?<!±) (?!±)", "\n".join(column)) for column in parts)
    return sum(2 + max(map(len, column)) for column in words)


def _csv_column(heading: str, contents: Sequence[Content]) -> list[list[object]]:
    """Return heading and cells of a column; five side by side of a metric with repeats."""
    spreads = [cell for cell in contents if isinstance(cell, MetricSpread)]
    repeated = any(cell.values is not None and max(cell.values.count, cell.of) > 1 for cell in spreads)
    width = 5 if repeated else 1
    names = ("", " std", " 95 % half width", " n", " of")[:width]
    rows: list[list[object]] = [[heading + name for name in names]]
    for cell in contents:
        numbers = cell.numbers() if isinstance(cell, MetricSpread) else (cell, *[""] * 4)
        rows.append(list(numbers[:width]))
    return rows
