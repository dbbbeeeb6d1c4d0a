"""Pictures of a report: charts of metrics as SVG, and paths and maps of runs."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.lib.stride_tricks import sliding_window_view

from lirs_validation.analysis.results import RunFolder, recorded_world_config
from lirs_validation.drawing import error_picture, shown_bounds
from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.metrics.elevation import ELEVATION, read_elevation
from lirs_validation.metrics.map import contradicted
from lirs_validation.record.metric_catalog import Entry, Metric, rtf_counts, value_at
from lirs_validation.record.run_record import (
    RunGroup,
    by_group,
    distinguishing_fields,
    maps_clouds,
    succeeded,
)
from lirs_validation.report.page import PageFigure, data_url
from lirs_wct import ByteArray, FloatArray, WctError
from lirs_wct.drawing.canvas import BLUE, GREEN, VERMILLION, Canvas, Drawing, bounds_shown, shaded_heights
from lirs_wct.formats import drive_files, map_server

INK = "#123456"
"""Placeholder that the SVG replaces by the page's text color."""
PAGE_COLORS = {
    INK: "currentColor",
    BLUE: "var(--blue)",
    VERMILLION: "var(--vermillion)",
    GREEN: "var(--green)",
}
"""Colors of the page, which are lighter on a dark ground."""
MAPPER_COLORS = {"hector": BLUE, "cartographer": VERMILLION, "gmapping": GREEN}
OTHER_COLORS = ("#CC79A7", "#B8860B", "#7B6BD6", "#56B4E9")
"""Okabe and Ito's colors, those for other mappers strong enough on light and on dark."""
FONT_SIZE = 8.0
COLUMNS = 3
WINDOW = 4
"""Half width of the averaging window for a single run's RTF, seconds."""
LOG_SCALE_RATIO = 20.0
"""Ratio of largest and smallest RTF above which the scale is logarithmic."""

PANEL_PIXELS = 280
"""Longer edge of a panel of a run's picture, pixels."""
WEBP_QUALITY = 62
GAP = 8
"""Pixels between two panels."""
FRACTION_BITS = 4
"""Bits of a pixel's fraction in `cv2.polylines`."""


def rtf_chart(entries: Sequence[Entry]) -> PageFigure | None:
    """Return RTF over time as a figure of a page; None without RTF."""
    figure = rtf_figure(entries)
    if figure is None:
        return None
    caption = (
        "RTF over simulated time, as in the paper's Fig. 13: mean and a band of one standard deviation, over "
        f"seeds; where a method has one seed, over {2 * WINDOW + 1} s of its run."
    )
    label = "Real-time factor over simulated time, one panel a world and representation, one line a mapper"
    return PageFigure(as_svg(figure, label, "rtf"), caption=caption)


def rtf_figure(entries: Sequence[Entry]) -> Drawing | None:
    """Draw RTF over time; return None without RTF.

    A panel for each world, robot and representation; in it the methods, each with mean and a band of one
    standard deviation (see `series_band`).
    """
    panels: dict[RunGroup, dict[str, list[Entry]]] = {}
    for group, runs in by_group([e for e in entries if succeeded(e) and rtf_counts(e)]).items():
        panels.setdefault(group.replaced(mapper=""), {})[group["mapper"]] = runs
    if not panels:
        return None
    worlds = list(dict.fromkeys(group["world"] for group in panels))
    robots = list(dict.fromkeys(group["robot"] for group in panels))
    shown = sorted(panels, key=lambda group: (worlds.index(group["world"]), robots.index(group["robot"])))
    columns = min(COLUMNS, len(shown))
    rows = math.ceil(len(shown) / columns)
    figure = Drawing(figsize=(3.4 * columns + 0.3, 2.1 * rows + 0.5), layout="constrained")
    mappers = sorted({mapper for group in shown for mapper in panels[group]})
    for k, group in enumerate(shown):
        axes = figure.add_subplot(rows, columns, k + 1)
        _draw_rtf(axes, panels[group], mappers)
        _style(axes, group.label({"world", *distinguishing_fields(shown)}))
        if k % columns == 0:
            axes.set_ylabel("RTF")
        if k + columns >= len(shown):
            axes.set_xlabel("simulated time [s]")
    lines = [Line2D([], [], color=_color_of(name, mappers), linewidth=2, label=name) for name in mappers]
    place: dict[str, Any] = {"loc": "outside upper left", "ncols": len(lines), "frameon": False}
    figure.legend(handles=lines, fontsize=FONT_SIZE, labelcolor=INK, **place)
    return figure


def _draw_rtf(axes: Axes, methods: Mapping[str, Sequence[Entry]], mappers: list[str]) -> None:
    low, high = math.inf, 0.0
    for mapper, runs in methods.items():
        mean, std = series_band(runs)
        seconds = np.arange(1, len(mean) + 1)
        color = _color_of(mapper, mappers)
        bottom = np.maximum(mean - std, mean * 0.05)
        axes.fill_between(seconds, bottom, mean + std, color=color, alpha=0.18, linewidth=0)
        axes.plot(seconds, mean, color=color, linewidth=1.2, marker="." if len(mean) < 4 else "")
        low, high = min(low, float(mean.min())), max(high, float((mean + std).max()))
    if low > 0 and high / low > LOG_SCALE_RATIO:
        axes.set_yscale("log")
    else:
        axes.set_ylim(0, 1.1 * high)
    axes.set_xlim(left=0)


def series_band(runs: Sequence[Entry]) -> tuple[FloatArray, FloatArray]:
    """Return (n,) mean and (n,) standard deviation of the RTF at each simulated second.

    Over the runs that drove so long; of one run, over the seconds up to `WINDOW` before and after.
    """
    longest = max(len(run["rtf"]["series"]) for run in runs)
    table = np.full((len(runs), longest), np.nan)
    for row, run in zip(table, runs, strict=True):
        row[: len(run["rtf"]["series"])] = run["rtf"]["series"]
    if len(runs) == 1:
        table = sliding_window_view(np.pad(table[0], WINDOW, constant_values=np.nan), 2 * WINDOW + 1).T
    return np.nanmean(table, axis=0), np.nanstd(table, axis=0)


def distribution_chart(entries: Sequence[Entry], metrics: Sequence[Metric]) -> PageFigure | None:
    """Return dots of all runs by group and metric; None without successful runs.

    A bar is the median, a dotted bar the median of the metric's baseline.
    """
    shown = by_group(filter(succeeded, entries))
    kept = [m for m in metrics if any(_values(m, runs) for runs in shown.values())]
    if not shown or not kept:
        return None
    mappers = sorted({group["mapper"] for group in shown})
    fields = distinguishing_fields(shown)
    figure = Figure(figsize=(10.5, 0.9 + 0.2 * len(shown)), layout="constrained")
    columns = figure.subplots(1, len(kept), sharey=True, squeeze=False)[0]
    for axes, metric in zip(columns, kept, strict=True):
        _style(axes, metric.heading)
        _draw_dots(axes, metric, shown, mappers)
    columns[0].set_yticks(range(len(shown)), [group.label(fields) for group in shown])
    columns[0].set_ylim(len(shown) - 0.5, -0.5)
    caption = (
        "Every run that finished is a dot, the bar their median, the dotted bar their odometry's median; "
        "one row a group."
    )
    label = "Metrics of every run as dots, one row a group, medians as bars; the numbers stand in the tables"
    return PageFigure(as_svg(figure, label, "spread"), caption=caption)


def _draw_dots(
    axes: Axes, metric: Metric, groups: Mapping[RunGroup, Sequence[Entry]], mappers: list[str]
) -> None:
    everything: list[float] = []
    for row, (group, runs) in enumerate(groups.items()):
        values = _values(metric, runs)
        everything += values
        color, rows = _color_of(group["mapper"], mappers), [row] * len(values)
        axes.plot(values, rows, "o", markersize=3.5, color=color, alpha=0.75, markeredgewidth=0)
        baseline = [metric.scale * float(v) for r in runs if (v := value_at(r, metric.baseline)) is not None]
        for numbers, line, width in ((values, "-", 1.1), (baseline if values else [], ":", 1.4)):
            if numbers:
                middle = [float(np.median(numbers))] * 2
                axes.plot(middle, (row - 0.33, row + 0.33), line, color=INK, linewidth=width)
    axes.grid(axis="x", color=INK, alpha=0.12, linewidth=0.6)
    if metric.section == "rtf" and 0 < min(everything) * LOG_SCALE_RATIO < max(everything):
        axes.set_xscale("log")
    else:
        axes.locator_params(axis="x", nbins=4)


def _values(metric: Metric, runs: Sequence[Entry]) -> list[float]:
    return [v for run in runs if (v := metric.comparable(run)) is not None]


def _color_of(name: str, names: list[str]) -> str:
    """Return a mapper's color: always the same for those that come with the package."""
    others = [n for n in names if n not in MAPPER_COLORS]
    return MAPPER_COLORS.get(name) or OTHER_COLORS[others.index(name) % len(OTHER_COLORS)]


def _style(axes: Axes, title: str) -> None:
    """Style axes in the page's ink: thin, without top and right border."""
    axes.set_facecolor("none")
    axes.tick_params(colors=INK, labelsize=FONT_SIZE, length=3, width=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set(color=INK, linewidth=0.6)
    axes.grid(axis="y", color=INK, alpha=0.12, linewidth=0.6)
    axes.set_title(title, fontsize=FONT_SIZE + 1, loc="left", color=INK)
    for label in (axes.xaxis.label, axes.yaxis.label):
        label.set(color=INK, fontsize=FONT_SIZE)


def as_svg(figure: Figure, label: str, key: str) -> str:
    """Return a figure as an SVG element with a label for screen readers.

    Its colors follow the page's; its inner names begin with `key`, which is unique on the page.
    """
    figure.patch.set_alpha(0.0)
    text = io.StringIO()
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": key, "path.simplify_threshold": 0.5}):
        figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    svg = text.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(r' (width|height)="[^"]*pt"', "", svg, count=2)
    svg = re.sub(r"font: ([\d.]+px) [^;\"]*", r"font-size: \1", svg)  # the page's own font
    svg = re.sub(
        r' d="[^"]*"', lambda path: re.sub(r"(\.\d)\d+", r"\1", path.group()), svg
    )  # a third as long
    for color, name in PAGE_COLORS.items():
        svg = svg.replace(color.lower(), name)
    width = f"{figure.get_size_inches()[0] * 96:.0f}px"
    style = f"max-width: {width}; min-width: min({width}, 38rem)"
    return svg.replace("<svg", f'<svg role="img" aria-label="{label}" style="{style}"', 1)


def run_figure(run: RunFolder, scenarios: ScenarioCache) -> PageFigure:
    """Return a run's picture; its note lists missing parts."""
    try:
        picture, note = _draw_run(run, scenarios)
    except WctError as error:
        return PageFigure("", note=str(error))
    pixels: ByteArray = np.round(picture[..., ::-1] * 255).astype(np.uint8)
    _, encoded = cv2.imencode(".webp", pixels, (cv2.IMWRITE_WEBP_QUALITY, WEBP_QUALITY))
    alt = f"Paths and maps of {run.entry['name']}"
    return PageFigure(data_url(encoded.tobytes(), "webp"), alt, note=note)


def _draw_run(run: RunFolder, scenarios: ScenarioCache) -> tuple[FloatArray, str]:
    """Return the panels side by side, the truth first, and a note on missing parts."""
    truth, estimate = (drive_files.read_tum(run.folder / f"{name}.tum") for name in ("truth", "estimate"))
    true_pose = map_server.read_map(run.folder / "map_true_pose.yaml")
    world, note = None, ""
    try:
        world = scenarios.scenario(recorded_world_config(run.entry)).world
        canvas = Canvas.over(shown_bounds(world, truth, true_pose), PANEL_PIXELS)
        ground = shaded_heights(world, canvas)
    except WctError as error:
        canvas = Canvas.over(bounds_shown(truth, true_pose), PANEL_PIXELS)
        note = f"without its terrain: {error}"
        ground = canvas.grid_picture(true_pose)
    panels = [with_paths(ground, canvas, truth.xy, estimate.xy) / 255.0, canvas.grid_picture(true_pose)]
    if not maps_clouds(run.entry):
        built = map_server.read_map(run.folder / "map.yaml")
        panels.append(canvas.grid_picture(built))
        wrong = contradicted(built, true_pose)
        panels[-1][canvas.mark_pixels(wrong, built)] = to_rgb(VERMILLION)
    elif world is not None and (run.folder / ELEVATION).is_file():  # none in worlds with overhangs
        panels.append(error_picture(canvas, world, read_elevation(run.folder / ELEVATION)[0]))
    padded = [np.pad(panel, ((0, 0), (0, GAP), (0, 0)), constant_values=1.0) for panel in panels]
    return np.concatenate(padded, axis=1)[:, :-GAP], note


def with_paths(picture: FloatArray, canvas: Canvas, truth: FloatArray, estimate: FloatArray) -> ByteArray:
    """Return a picture of levels in [0, 1] with both paths (n, 2), as bytes."""
    painted: ByteArray = np.ascontiguousarray(picture * 255, dtype=np.uint8)
    for track, color, width in ((truth, BLUE, 7), (estimate, VERMILLION, 2)):
        xy = (track - (canvas.bounds[0], canvas.bounds[3])) / (canvas.pixel, -canvas.pixel) - 0.5
        points = np.round(xy * 2**FRACTION_BITS).astype(np.int32)
        shade = tuple(round(255 * c) for c in to_rgb(color))
        cv2.polylines(painted, [points], False, shade, width, cv2.LINE_AA, FRACTION_BITS)
    return painted
