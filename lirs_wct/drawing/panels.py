"""Panels of a figure: headline, value list, path ends, axes of a given size.

Panels of any aspect ratio are placed by the inch. Matplotlib's constrained layout first gives axes of equal
aspect a box and then shrinks them in it, so that text below them may leave the figure.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from lirs_wct.drawing.style import BLACK, GRAY, TEXT, TITLE
from lirs_wct.geometry.trajectory import Trajectory

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
