"""Charts as SVG that takes the page's colors and letters: one drawing for light and dark."""

from __future__ import annotations

import io
import re

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from lirs_wct.drawing.style import BLUE, GREEN, VERMILLION

INK = "#123456"
"""Drawn in this color, a line or letter takes the page's own."""
NAMED = {BLUE: "var(--blue)", VERMILLION: "var(--vermillion)", GREEN: "var(--green)"}
"""Colors that the page makes lighter on a dark ground."""
MAPPER_COLORS = {"hector": BLUE, "cartographer": VERMILLION, "gmapping": GREEN}
OTHERS = ("#CC79A7", "#B8860B", "#7B6BD6", "#56B4E9")
"""Okabe and Ito's colors, those for other mappers strong enough on light and on dark."""
SMALL = 8.0
DIGITS = re.compile(r"(\.\d)\d+")
"""A path is drawn to a tenth of a point: finer is not seen, and makes the page heavy."""


def color_of(name: str, names: list[str]) -> str:
    """Return a mapper's color: always the same for those that come with the package."""
    others = [n for n in names if n not in MAPPER_COLORS]
    return MAPPER_COLORS.get(name) or OTHERS[others.index(name) % len(OTHERS)]


def plain(axes: Axes, title: str = "") -> None:
    """Draw an axes' frame and letters in the page's ink, thin and open to the right."""
    axes.set_facecolor("none")
    axes.tick_params(colors=INK, labelsize=SMALL, length=3, width=0.6)
    for side, spine in axes.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color(INK)
        spine.set_linewidth(0.6)
    axes.grid(axis="y", color=INK, alpha=0.12, linewidth=0.6)
    axes.set_title(title, fontsize=SMALL + 1, loc="left", color=INK)
    for label in (axes.xaxis.label, axes.yaxis.label):
        label.set_color(INK)
        label.set_fontsize(SMALL)


def as_svg(figure: Figure, label: str, key: str) -> str:
    """Return a figure as an SVG element for a page, with a label for those who do not see it.

    Args:
        figure: drawn in `INK` where the page's color is wanted.
        label: what it shows.
        key: tells its inner names from those of other drawings on the page.
    """
    figure.patch.set_alpha(0.0)
    text = io.StringIO()
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": key, "path.simplify_threshold": 0.5}):
        figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    svg = text.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", svg, count=1)
    svg = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", svg, count=1)
    svg = re.sub(r"font: ([\d.]+px) [^;\"]*", r"font-size: \1", svg)
    svg = re.sub(r' d="[^"]*"', lambda path: DIGITS.sub(r"\1", path.group()), svg)
    width = f"{figure.get_size_inches()[0] * 96:.0f}px"
    opening = (
        f'<svg role="img" aria-label="{label}" style="max-width: {width}; min-width: min({width}, 38rem)"'
    )
    for color, name in ({INK: "currentColor"} | NAMED).items():
        svg = svg.replace(color.lower(), name)
    return svg.replace("<svg", opening, 1)
