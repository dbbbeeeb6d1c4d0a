"""Common style of all pictures: fonts, colors for color-blind readers, axes in meters, panels.

Panels of any aspect ratio are placed by the inch. Matplotlib's constrained layout first gives axes of equal
aspect a box and then shrinks them in it, so that text below them may leave the figure.
"""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from PIL import Image

from lirs_wct.arrays import FloatArray
from lirs_wct.drawing.canvas import BAND, Canvas
from lirs_wct.geometry.pose import Trajectory

DPI, SCREEN_DPI = 150, 72
"""Resolution of files and in Jupyter, dots per inch."""
COMPRESSION = 3
"""zlib level of PNG files; the usual level 6 takes twice the time for 4 % fewer bytes."""
TITLE, TEXT, SMALL = 10.5, 9.0, 8.0
"""Font sizes, points."""

BLUE, VERMILLION, GREEN, BLACK, GRAY = "#0072B2", "#D55E00", "#009E73", "#1a1a1a", "#6b6b6b"
"""Okabe and Ito's colors: distinct with every kind of color blindness and in gray."""

LINE = 0.19
"""Height of a line of a panel's title, inches."""
LETTERS = 11.0
"""Letters per inch of a panel's title."""
LEFT, BELOW, GAP, RIM = 0.9, 0.6, 0.35, 0.12
"""Space left of a map and below it (ticks and labels), between panels, and at the figure's rim, inches."""
SCALE = 0.95
"""Space right of a panel for its color scale of heights, inches."""
NARROW = 2.6
"""Panel width below which the legend does not fit above the right end, inches."""


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


def headline(figure: Figure, text: str, **place: float) -> None:
    """Set the title of the figure; keyword `y` is its upper edge, a share of the height."""
    figure.suptitle(text, fontsize=TITLE + 1.5, x=0.012, ha="left", color=BLACK, **place)


def value_list(axes: Axes, lines: Sequence[tuple[str, str]]) -> None:
    """Write a table with names on the left and values on the right."""
    axes.set_axis_off()
    axes.set_xlim(0, 1)
    axes.set_ylim(0, 1)
    step = 1.0 / max(len(lines), 10)
    for k, (name, value) in enumerate(lines):
        y = 0.94 - k * step
        axes.text(0.0, y, name, fontsize=TEXT, color=BLACK, va="center")
        axes.text(1.0, y, value, fontsize=TEXT, color=BLACK, va="center", ha="right")
        axes.plot((0.0, 1.0), (y - step / 2,) * 2, color=GRAY, linewidth=0.4, alpha=0.5)


def path_ends(axes: Axes, path: Trajectory) -> list[Line2D]:
    """Mark where a path starts and ends; return the marks for the legend."""
    handles = []
    for shape, label, xy in (("o", "start", path.xy[0]), ("s", "end", path.xy[-1])):
        axes.plot(*xy, shape, color="white", markeredgecolor=BLACK, markersize=5.5, zorder=6)
        (mark,) = axes.plot([], [], shape, color="white", markeredgecolor=BLACK, markersize=5, label=label)
        handles.append(mark)
    return handles


class Size(NamedTuple):
    """Width and height, inches."""

    width: float
    height: float


def fit_size(ratio: float, most: Size) -> Size:
    """Return the largest size with a ratio of width to height that fits into another size."""
    width = min(most.width, most.height * ratio)
    return Size(width, width / ratio)


def add_axes(figure: Figure, left: float, top: float, size: Size) -> Axes:
    """Add axes of a size; `left` and `top` are distances from the figure's upper left corner, inches."""
    width, height = figure.get_size_inches()
    return figure.add_axes(
        (left / width, 1 - (top + size.height) / height, size.width / width, size.height / height)
    )


def fewer_ticks(axes: Axes, size: Size) -> None:
    """Limit the ticks of a map to those that fit along its sides."""
    for axis, room in ((axes.xaxis, size.width / 0.7), (axes.yaxis, size.height / 0.4)):
        if room < 1:
            axis.set_ticks([axis.get_view_interval()[0]])
        else:
            axis.set_major_locator(MaxNLocator(min(7, int(room))))


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
