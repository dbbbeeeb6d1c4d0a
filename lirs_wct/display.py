"""Jupyter display of values: as a picture or as a table of two columns."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pkgutil import resolve_name
from typing import ClassVar


class ShownAsPicture:
    """Base of value types that Jupyter shows as a picture.

    Attributes:
        _painter: `module:function` that draws the value as a `Figure`; loaded when the value is first shown,
            so that a value type does not load matplotlib.
    """

    __slots__ = ()
    _painter: ClassVar[str] = "lirs_wct.drawing.pictures:figure_of"

    def _repr_png_(self) -> bytes:
        picture: bytes = resolve_name(self._painter)(self)._repr_png_()
        return picture


def html_table(rows: Sequence[tuple[str, str]]) -> str:
    """Return names and values as an HTML table."""
    cells = "".join(
        f'<tr><th style="text-align:left">{escape(name)}</th><td>{escape(value)}</td></tr>'
        for name, value in rows
    )
    return f"<table>{cells}</table>"
