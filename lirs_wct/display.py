"""How values show themselves in Jupyter: as a picture or a table, and in one line of text."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from importlib import import_module
from typing import Any, ClassVar


class ShownAsPicture:
    """A value that Jupyter shows as a picture.

    Attributes:
        _painter: `module:function` that makes the picture's `Figure` from the value; loaded when the value is
            first shown, since a value type need not load matplotlib.
    """

    __slots__ = ()
    _painter: ClassVar[str] = "lirs_wct.drawing.pictures:figure_of"

    def _repr_png_(self) -> bytes:
        picture: bytes = _loaded(self._painter)(self)._repr_png_()
        return picture


class ShownAsTable:
    """A value that Jupyter shows as a table of two columns.

    Attributes:
        _rows: `module:function` that makes names and formatted values from the value.
    """

    __slots__ = ()
    _rows: ClassVar[str]

    def _repr_html_(self) -> str:
        return html_table(_loaded(self._rows)(self))


def html_table(rows: Sequence[tuple[str, str]]) -> str:
    """Return names and values as an HTML table."""
    cells = "".join(
        f'<tr><th style="text-align:left">{escape(name)}</th><td>{escape(value)}</td></tr>'
        for name, value in rows
    )
    return f"<table>{cells}</table>"


def _loaded(place: str) -> Any:
    module, name = place.split(":")
    return getattr(import_module(module), name)
