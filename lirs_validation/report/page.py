"""A result as one self-contained HTML page: no network, no scripts, no other files."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO

from jinja2 import Environment, PackageLoader, StrictUndefined

from lirs_validation.record.metric_catalog import WORSE_MARK
from lirs_validation.report.table import ReportTable
from lirs_wct.drawing.canvas import Drawing


@dataclass(frozen=True)
class PageFigure:
    """A picture on a page: SVG or address, description, caption, and a note on missing parts.

    `width` is the largest one, in CSS.
    """

    picture: str
    alt: str = ""
    caption: str = ""
    note: str = ""
    width: str = "100%"


@dataclass(frozen=True)
class PageSection:
    """A section of a page; a click opens `folded` tables, an empty table shows its caption alone."""

    key: str
    title: str
    text: str = ""
    tables: tuple[ReportTable, ...] = ()
    folded: tuple[ReportTable, ...] = ()
    figures: tuple[PageFigure, ...] = ()
    commands: tuple[str, ...] = ()


@dataclass(frozen=True)
class Tile:
    """A figure in large type on top of a page."""

    value: str
    name: str
    bad: bool = False


def page_html(
    title: str, sentences: Sequence[str], sections: Sequence[PageSection], tiles: Sequence[Tile] = ()
) -> str:
    """Return a page as HTML."""
    loader = PackageLoader(__package__)
    environment = Environment(
        loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=StrictUndefined
    )
    style, _, _ = loader.get_source(environment, "page.css")
    return environment.get_template("page.html.j2").render(
        title=title, sentences=sentences, sections=sections, tiles=tiles, style=style, worse_mark=WORSE_MARK
    )


def png(drawing: Drawing) -> bytes:
    """Return a drawing as a PNG file."""
    picture = BytesIO()
    drawing.savefig(picture, dpi=110, format="png")
    return picture.getvalue()


def data_url(picture: bytes, kind: str = "png") -> str:
    """Return the address of a picture that a page holds itself."""
    return f"data:image/{kind};base64,{base64.b64encode(picture).decode()}"
