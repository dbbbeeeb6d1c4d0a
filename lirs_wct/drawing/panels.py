"""What several pictures show alike: their headline, a list of values, the ends of a path."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from lirs_wct.drawing.style import BLACK, GRAY, TEXT, TITLE
from lirs_wct.geometry.trajectory import Trajectory


def headline(figure: Figure, text: str, **place: float) -> None:
    """Set the title of the whole picture; its upper edge is `y`, a share of the height."""
    figure.suptitle(text, fontsize=TITLE + 1.5, x=0.012, ha="left", color=BLACK, **place)


def value_list(axes: Axes, lines: Sequence[tuple[str, str]]) -> None:
    """Write names to the left and values to the right, a line each."""
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
