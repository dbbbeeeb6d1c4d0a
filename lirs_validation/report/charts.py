"""Charts of a report as SVG: RTF over time as in the paper's Fig. 13, and distributions of metrics."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.lib.stride_tricks import sliding_window_view

from lirs_validation.analysis.groups import RunGroup, by_group, distinguishing_fields
from lirs_validation.record.metric_catalog import Entry, Metric, rtf_counts, value_at
from lirs_validation.record.run_record import succeeded
from lirs_wct.arrays import FloatArray
from lirs_wct.drawing.canvas import BLUE, GREEN, VERMILLION, Drawing

INK = "#123456"
"""Placeholder that the SVG replaces by the page's text color."""
NAMED = {BLUE: "var(--blue)", VERMILLION: "var(--vermillion)", GREEN: "var(--green)"}
"""Colors that the page makes lighter on a dark ground."""
MAPPER_COLORS = {"hector": BLUE, "cartographer": VERMILLION, "gmapping": GREEN}
OTHERS = ("#CC79A7", "#B8860B", "#7B6BD6", "#56B4E9")
"""Okabe and Ito's colors, those for other mappers strong enough on light and on dark."""
SMALL = 8.0
DIGITS = re.compile(r"(\.\d)\d+")
"""Digits beyond a tenth of a point, which are removed to save space."""
ACROSS = 3
AROUND = 4
"""Half width of the averaging window for a single run's RTF, seconds."""
MOST_PANELS, MOST_ROWS = 36, 72
WIDE = 20.0
"""Ratio of largest and smallest RTF above which the scale is logarithmic."""


def color_of(name: str, names: list[str]) -> str:
    """Return a mapper's color: always the same for those that come with the package."""
    others = [n for n in names if n not in MAPPER_COLORS]
    return MAPPER_COLORS.get(name) or OTHERS[others.index(name) % len(OTHERS)]


def plain(axes: Axes, title: str = "") -> None:
    """Style axes in the page's ink: thin, without top and right border."""
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
    """Return a figure as an SVG element with a label for screen readers.

    `INK` stands for the page's text color; the inner names begin with `key`, which is unique on the page.
    """
    figure.patch.set_alpha(0.0)
    text = io.StringIO()
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": key, "path.simplify_threshold": 0.5}):
        figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    svg = text.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(r' (width|height)="[^"]*pt"', "", svg, count=2)
    svg = re.sub(r"font: ([\d.]+px) [^;\"]*", r"font-size: \1", svg)
    svg = re.sub(r' d="[^"]*"', lambda path: DIGITS.sub(r"\1", path.group()), svg)
    width = f"{figure.get_size_inches()[0] * 96:.0f}px"
    opening = (
        f'<svg role="img" aria-label="{label}" style="max-width: {width}; min-width: min({width}, 38rem)"'
    )
    for color, name in ({INK: "currentColor"} | NAMED).items():
        svg = svg.replace(color.lower(), name)
    return svg.replace("<svg", opening, 1)


def rtf_chart(entries: Sequence[Entry]) -> tuple[str, int] | None:
    """Return RTF over time as SVG, and the number of omitted panels; None without RTF."""
    drawn = rtf_figure(entries)
    label = "Real-time factor over simulated time, one panel a world and representation, one line a mapper"
    return None if drawn is None else (as_svg(drawn[0], label, "rtf"), drawn[1])


def rtf_figure(entries: Sequence[Entry]) -> tuple[Drawing, int] | None:
    """Draw RTF over time; return the figure and the number of omitted panels, None without RTF.

    A panel for each world, robot and representation; in it the methods, each with mean and a band of one
    standard deviation (see `series_band`).
    """
    runs = [e for e in entries if succeeded(e) and rtf_counts(e)]
    panels: dict[RunGroup, dict[str, list[Entry]]] = {}
    for group, held in by_group(runs).items():
        panels.setdefault(group.replaced(mapper=""), {})[group["mapper"]] = held
    if not panels:
        return None
    shown = dict(_ordered(panels)[:MOST_PANELS])
    across = min(ACROSS, len(shown))
    rows = math.ceil(len(shown) / across)
    figure = Drawing(figsize=(3.4 * across + 0.3, 2.1 * rows + 0.5), layout="constrained")
    mappers = sorted({mapper for held in shown.values() for mapper in held})
    for k, (group, methods) in enumerate(shown.items()):
        axes = figure.add_subplot(rows, across, k + 1)
        _rtf_panel(axes, methods, mappers)
        plain(axes, group.label({"world", *distinguishing_fields(shown)}))
        if k % across == 0:
            axes.set_ylabel("RTF")
        if k + across >= len(shown):
            axes.set_xlabel("simulated time [s]")
    lines = [Line2D([], [], color=color_of(name, mappers), linewidth=2, label=name) for name in mappers]
    figure.legend(
        handles=lines,
        loc="outside upper left",
        ncols=len(lines),
        frameon=False,
        fontsize=SMALL,
        labelcolor=INK,
    )
    return figure, len(panels) - len(shown)


def series_band(runs: Sequence[Entry]) -> tuple[FloatArray, FloatArray]:
    """Return (n,) mean and (n,) standard deviation of the RTF at each simulated second.

    Over the runs that drove so long; of one run, over the seconds up to `AROUND` before and after.
    """
    longest = max(len(run["rtf"]["series"]) for run in runs)
    table = np.full((len(runs), longest), np.nan)
    for row, run in zip(table, runs, strict=True):
        row[: len(run["rtf"]["series"])] = run["rtf"]["series"]
    if len(runs) == 1:
        table = sliding_window_view(np.pad(table[0], AROUND, constant_values=np.nan), 2 * AROUND + 1).T
    return np.nanmean(table, axis=0), np.nanstd(table, axis=0)


def distribution_chart(entries: Sequence[Entry], metrics: Sequence[Metric]) -> tuple[str, int] | None:
    """Return dots of all runs by group and metric as SVG; None without successful runs.

    A bar is the median, a dotted bar the median of the metric's baseline. The second value is the number of
    omitted groups.
    """
    groups = by_group([e for e in entries if succeeded(e)])
    shown = dict(list(groups.items())[:MOST_ROWS])
    kept = [m for m in metrics if any(_values(m, runs) for runs in shown.values())]
    if not shown or not kept:
        return None
    mappers = sorted({group["mapper"] for group in shown})
    fields = distinguishing_fields(shown)
    figure = Figure(figsize=(10.5, 0.9 + 0.2 * len(shown)), layout="constrained")
    columns = figure.subplots(1, len(kept), sharey=True, squeeze=False)[0]
    for axes, metric in zip(columns, kept, strict=True):
        plain(axes, metric.heading)
        _strip(axes, metric, shown, mappers)
    columns[0].set_yticks(range(len(shown)), [group.label(fields) for group in shown])
    columns[0].set_ylim(len(shown) - 0.5, -0.5)
    label = "Metrics of every run as dots, one row a group, medians as bars; the numbers stand in the tables"
    return as_svg(figure, label, "spread"), len(groups) - len(shown)


def _strip(
    axes: Axes, metric: Metric, groups: Mapping[RunGroup, Sequence[Entry]], mappers: list[str]
) -> None:
    for row, (group, runs) in enumerate(groups.items()):
        values = _values(metric, runs)
        if not values:
            continue
        color = color_of(group["mapper"], mappers)
        axes.plot(
            values, [row] * len(values), "o", color=color, markersize=3.5, alpha=0.75, markeredgewidth=0
        )
        baseline = [
            metric.scale * float(v) for run in runs if (v := value_at(run, metric.baseline)) is not None
        ]
        for numbers, style, width in ((values, "-", 1.1), (baseline, ":", 1.4)):
            if numbers:
                middle = [float(np.median(numbers))] * 2
                axes.plot(middle, (row - 0.33, row + 0.33), style, color=INK, linewidth=width)
    if metric.section == "rtf":
        values = [v for runs in groups.values() for v in _values(metric, runs)]
        if min(values) > 0 and max(values) / min(values) > WIDE:
            axes.set_xscale("log")
    axes.grid(axis="x", color=INK, alpha=0.12, linewidth=0.6)
    if axes.get_xscale() == "linear":
        axes.locator_params(axis="x", nbins=4)


def _values(metric: Metric, runs: Sequence[Entry]) -> list[float]:
    return [v for run in runs if (v := metric.comparable(run)) is not None]


def _rtf_panel(axes: Axes, held: Mapping[str, Sequence[Entry]], mappers: list[str]) -> None:
    low, high = math.inf, 0.0
    for mapper, runs in held.items():
        mean, std = series_band(runs)
        seconds = np.arange(1, len(mean) + 1)
        color = color_of(mapper, mappers)
        bottom = np.maximum(mean - std, mean * 0.05)
        axes.fill_between(seconds, bottom, mean + std, color=color, alpha=0.18, linewidth=0)
        axes.plot(seconds, mean, color=color, linewidth=1.2, marker="." if len(mean) < 4 else "")
        low, high = min(low, float(mean.min())), max(high, float((mean + std).max()))
    if low > 0 and high / low > WIDE:
        axes.set_yscale("log")
    else:
        axes.set_ylim(0, 1.1 * high)
    axes.set_xlim(left=0)


def _ordered(panels: dict[RunGroup, Any]) -> list[tuple[RunGroup, Any]]:
    """Return the panels by world, then by robot, each in the order of appearance."""
    worlds = list(dict.fromkeys(group["world"] for group in panels))
    robots = list(dict.fromkeys((group["world"], group["robot"]) for group in panels))
    place = {pair: (worlds.index(pair[0]), robots.index(pair)) for pair in robots}
    return sorted(panels.items(), key=lambda panel: place[panel[0]["world"], panel[0]["robot"]])
