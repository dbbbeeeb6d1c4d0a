"""Common style of all pictures: fonts, colors for color-blind readers, axes in meters."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from lirs_wct.arrays import FloatArray
from lirs_wct.drawing.canvas import BAND, Canvas

DPI, SCREEN_DPI = 150, 72
"""Resolution of files and in Jupyter, dots per inch."""
COMPRESSION = 3
"""zlib level of PNG files; the usual level 6 takes twice the time for 4 % fewer bytes."""
TITLE, TEXT, SMALL = 10.5, 9.0, 8.0
"""Font sizes, points."""

BLUE, VERMILLION, GREEN, BLACK, GRAY = "#0072B2", "#D55E00", "#009E73", "#1a1a1a", "#6b6b6b"
"""Okabe and Ito's colors: distinct with every kind of color blindness and in gray."""


def rgb(color: str) -> tuple[float, float, float]:
    """Return red, green and blue in [0, 1] of `#rrggbb`."""
    red, green, blue = (int(color[k : k + 2], 16) / 255 for k in (1, 3, 5))
    return red, green, blue


def title(axes: Axes, text: str, *, above_legend: bool = False) -> None:
    """Set a panel's title, left-aligned; above a legend it takes a separate line."""
    pad = 5 + (SMALL + 8 if above_legend else 0)
    axes.set_title(text, fontsize=TITLE, loc="left", color=BLACK, pad=pad)


def length(meters: float) -> str:
    """Format a length for a title, with three or four significant digits."""
    return f"{meters:,.0f} m" if meters >= 1000 else f"{meters:.4g} m" if meters >= 100 else f"{meters:.3g} m"


def plain_axes(axes: Axes, x: str, y: str) -> None:
    """Label axes, shrink ticks, hide the frame's upper and right side."""
    axes.set_xlabel(x, fontsize=TEXT, color=BLACK)
    axes.set_ylabel(y, fontsize=TEXT, color=BLACK)
    axes.tick_params(labelsize=SMALL, length=3, width=0.6, colors=BLACK)
    for side, spine in axes.spines.items():
        spine.set_linewidth(0.6)
        spine.set_visible(side in ("left", "bottom"))


def map_axes(axes: Axes, canvas: Canvas, picture: FloatArray) -> None:
    """Show a picture (rows, cols, 3) in [0, 1] with equal axes in meters."""
    # matplotlib converts bytes with alpha to float32, without alpha to float64.
    levels = np.full((*picture.shape[:2], 4), 255, np.uint8)
    for first in range(0, len(picture), BAND):
        levels[first : first + BAND, :, :3] = np.rint(picture[first : first + BAND] * 255)
    axes.imshow(levels, extent=canvas.extent, interpolation="antialiased", zorder=0)
    plain_axes(axes, "x [m]", "y [m]")
    for spine in axes.spines.values():
        spine.set_visible(True)
        spine.set_color(GRAY)
    axes.set_aspect("equal")
    axes.set_xlim(canvas.bounds[0], canvas.bounds[2])
    axes.set_ylim(canvas.bounds[1], canvas.bounds[3])
    axes.locator_params(nbins=7)


def legend(axes: Axes, handles: Sequence[Any], *, side: Literal["left", "right"] = "right") -> None:
    """Put a small legend above the left or right end of a panel."""
    axes.legend(
        handles=handles,
        loc="lower left" if side == "left" else "lower right",
        bbox_to_anchor=(float(side == "right"), 1.0),
        ncols=len(handles),
        fontsize=SMALL,
        frameon=False,
        borderpad=0.1,
        borderaxespad=0.15,
        handlelength=1.6,
        handletextpad=0.4,
        columnspacing=1.0,
    )


class Drawing(Figure):
    """A figure that is drawn once and has a Jupyter picture without pyplot."""

    def savefig(self, fname: Any, *, dpi: float | None = None, **options: Any) -> None:
        """Lay out the panels, then draw them once; Matplotlib would also draw them for the layout."""
        kind = options.get("format") or (Path(fname).suffix[1:] if isinstance(fname, (str, Path)) else "png")
        if kind == "png":
            options = {"pil_kwargs": {"compress_level": COMPRESSION}} | options
        engine, own = self.get_layout_engine(), self.dpi
        self.dpi = own if dpi is None else dpi
        try:
            if engine is not None:
                engine.execute(self)
                self.set_layout_engine(None)
            super().savefig(fname, dpi=self.dpi, **options)
        finally:
            self.dpi = own
            self.set_layout_engine(engine)

    def _repr_png_(self) -> bytes:
        drawn, small = BytesIO(), BytesIO()
        self.savefig(drawn, dpi=SCREEN_DPI)
        # With 256 colors a notebook is a third as large, without a visible difference.
        Image.open(drawn).convert("RGB").quantize(256).save(small, "png", optimize=True)
        return small.getvalue()


def bare_figure(width: float, height: float) -> Drawing:
    """Return a white figure in inches without a layout engine."""
    return Drawing(figsize=(width, height), dpi=DPI, facecolor="white")


def new_figure(width: float, height: float) -> Drawing:
    """Return a white figure in inches with a constrained layout."""
    figure = bare_figure(width, height)
    figure.set_layout_engine("constrained")
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.set(w_pad=0.06, h_pad=0.06, wspace=0.02, hspace=0.02)  # type: ignore[call-arg]
    return figure
