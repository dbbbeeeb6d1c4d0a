"""Tables as data, and their forms: screen, HTML, Markdown and CSV."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from html import escape
from typing import Literal

from rich import box
from rich.console import Console, ConsoleOptions
from rich.table import Table
from rich.text import Text

from lirs_validation.analysis.groups import Repeats
from lirs_validation.record.metric_catalog import NOTHING, Metric

UNBOUNDED = 100_000
"""Width of a screen that fits every table, characters."""
BETWEEN_WORDS = re.compile(r"(?<=[\w,.]) (?=\w)| (?=\[)")
"""Line breaks of headings: between words and before a unit, not within `99.9 %` or `b - a`."""
INTERVALS = "intervals (±)"
"""Name of the intervals of means among the hidden columns."""


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

    def text(self, *, interval: bool = True) -> str:
        """Return mean, half width of its 95 % interval, and the number of values if incomplete."""
        if self.values is None:
            return NOTHING
        mean = self.metric.formatted(self.values.mean)
        reach = self.values.half_width
        held = f" ({self.values.count} of {self.of})" if self.partial else ""
        if interval and reach is not None:
            mean = f"{mean} ± {self.metric.formatted(reach)}"
        return mean + self.mark + held


Content = str | MetricSpread


@dataclass(frozen=True)
class ReportTable:
    """A table of results; rich prints it so that it fits the screen.

    A table that is too wide loses the intervals of its means, then its last columns, which the caption lists.
    Remarks are lines below.

    Attributes:
        key: short name, for links and files.
        title: title of the table.
        caption: explanation below the table.
        headings: headings of the columns.
        rows: contents of the cells, one per heading.
        text_columns: number of leading columns that hold text; the first is the row's heading.
        remarks: whether the last column holds text, too.
        styles: style of each row on the screen; empty = plain.
        keep: headings that a narrow screen never hides.
    """

    key: str
    title: str
    caption: str
    headings: tuple[str, ...]
    rows: tuple[tuple[Content, ...], ...]
    text_columns: int = 1
    remarks: bool = False
    styles: tuple[str, ...] = ()
    keep: tuple[str, ...] = ()

    def is_text(self, column: int) -> bool:
        """Whether a column, counted from 0, holds text."""
        return column < self.text_columns or (self.remarks and column == len(self.headings) - 1)

    def texts(self, *, intervals: bool = True) -> list[list[str]]:
        """Return the rows as text, with or without the intervals of means."""
        return [[c if isinstance(c, str) else c.text(interval=intervals) for c in r] for r in self.rows]

    def with_common_in_title(self, names: Collection[str], unnamed: Collection[str] = ()) -> ReportTable:
        """Return the table whose columns in `names` with one value for all rows are in its title.

        Args:
            names: headings of columns of text.
            unnamed: headings that the title leaves out.
        """
        texts = self.texts()
        columns = range(len(self.headings))
        common = [k for k in columns if self.headings[k] in names and len({row[k] for row in texts}) == 1]
        kept = [k for k in columns if k not in common]
        values = [(self.headings[k], texts[0][k]) for k in common]
        return replace(
            self,
            title=", ".join(text if name in unnamed else f"{name} {text}" for name, text in values),
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
        columns = [_expand_column(h, [row[k] for row in self.rows]) for k, h in enumerate(self.headings)]
        file = io.StringIO()
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([heading for headings, _ in columns for heading in headings])
        for k in range(len(self.rows)):
            writer.writerow([value for _, rows in columns for value in rows[k]])
        return file.getvalue()

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Table]:
        """Yield the first form that fits."""
        wide = options.update(width=UNBOUNDED)
        names = self._hidden_in_order()
        for count in range(len(names) + 1):
            shown = self._draw(names[:count], whole=True)
            if console.measure(shown, options=wide).maximum <= options.max_width:
                yield shown
                return
        yield self._draw(names, whole=False)

    def _hidden_in_order(self) -> list[str]:
        """Return what a narrow screen hides: intervals, then columns of numbers, the last one first."""
        intervals = [INTERVALS] if self.texts() != self.texts(intervals=False) else []
        numbers = [h for k, h in enumerate(self.headings) if not self.is_text(k) and h not in self.keep]
        return intervals + numbers[::-1][: len(numbers) if self.keep else max(0, len(numbers) - 2)]

    def _draw(self, hidden: Sequence[str], *, whole: bool) -> Table:
        """Return a table for the screen without the hidden parts.

        Titles, captions and cells are plain text: a name may hold brackets, which rich would take for its
        markup. Unless the cells are `whole`, long words are broken.
        """
        caption = self._screen_caption(hidden)
        shown = Table(
            box=box.SIMPLE_HEAD,
            padding=(0, 1, 0, 0),
            pad_edge=False,
            title=Text(self.title) if self.title else None,
            title_justify="left",
            caption=Text(caption) if caption else None,
            caption_justify="left",
        )
        columns = [k for k in range(len(self.headings) - self.remarks) if self.headings[k] not in hidden]
        for k in columns:
            justify: Literal["left", "right"] = "left" if self.is_text(k) else "right"
            stacked = BETWEEN_WORDS.sub("\n", self.headings[k])
            shown.add_column(Text(stacked), justify=justify, no_wrap=whole, overflow="fold")
        texts = self.texts(intervals=INTERVALS not in hidden)
        for row, style in zip(texts, self.styles or ("",) * len(texts), strict=True):
            shown.add_row(*(Text(row[k]) for k in columns), style=style)
        return shown

    def _screen_caption(self, hidden: Sequence[str]) -> str:
        """Return the remarks, each with the name of its row, the caption, and a note on hidden columns."""
        remarks = self.texts() if self.remarks else []
        lines = [f"{', '.join(row[: self.text_columns])}: {row[-1]}" for row in remarks]
        lines += [self.caption] if self.caption else []
        lines += [f"Columns hidden (widen the terminal): {', '.join(hidden)}."] if hidden else []
        return "\n".join(lines)


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
