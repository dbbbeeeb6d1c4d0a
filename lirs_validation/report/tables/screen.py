"""Tables on the screen, in one style."""

from __future__ import annotations

from typing import Literal

from rich import box
from rich.table import Table
from rich.text import Text

from lirs_validation.report.tables.table import ReportTable


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


def on_screen(table: ReportTable, style: str = "", title: str = "") -> Table:
    """Return a table of the report for the screen."""
    shown = screen_table(title, table.caption)
    for k, heading in enumerate(table.headings):
        justify: Literal["left", "right"] = "left" if table.is_text(k) else "right"
        shown.add_column(Text(heading), justify=justify, overflow="fold")
    for row in table.texts():
        shown.add_row(*map(Text, row), style=style)
    return shown
