"""Panels placed by the inch, for pictures whose panels have any aspect ratio.

Matplotlib's constrained layout gives axes of equal aspect a box first and shrinks them in it afterwards: what
stands below them may then leave the figure.
"""

from __future__ import annotations

from typing import NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

LINE = 0.19
"""Inches of a line of a panel's title."""
LETTERS = 11.0
"""Letters of a panel's title an inch."""
LEFT, BELOW, GAP, RIM = 0.9, 0.6, 0.35, 0.12
"""Inches left of a map and below it for its ticks and labels, between panels, and at the figure's rim."""
SCALE = 0.95
"""Inches right of a panel for the color scale of its heights."""
NARROW = 2.6
"""Inches of a panel's width below which its legend does not fit above its right end."""


class Size(NamedTuple):
    """Width and height, inches."""

    width: float
    height: float


def fitted(ratio: float, most: Size) -> Size:
    """Return the largest size of a ratio of width to height that fits."""
    width = min(most.width, most.height * ratio)
    return Size(width, width / ratio)


def placed(figure: Figure, left: float, top: float, size: Size) -> Axes:
    """Add axes of a size whose left upper corner lies so far from the figure's, inches."""
    width, height = figure.get_size_inches()
    return figure.add_axes(
        (left / width, 1 - (top + size.height) / height, size.width / width, size.height / height)
    )


def fewer_ticks(axes: Axes, size: Size) -> None:
    """Keep no more ticks of a map than have room along its sides."""
    for axis, room in ((axes.xaxis, size.width / 0.7), (axes.yaxis, size.height / 0.4)):
        if room < 1:
            axis.set_ticks([axis.get_view_interval()[0]])
        else:
            axis.set_major_locator(MaxNLocator(min(7, int(room))))
