"""Overview picture of a mapped log: map, path, errors and metrics."""

from __future__ import annotations

import textwrap
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from lirs_validation.metrics.log_accuracy import Accuracy
from lirs_validation.record.map_record import MapRecord, map_lines
from lirs_wct.arrays import FloatArray
from lirs_wct.drawing.canvas import (
    BLACK,
    BLUE,
    GRAY,
    GREEN,
    PAGE_DPI,
    VERMILLION,
    Canvas,
    Drawing,
    bounds_shown,
    legend,
    map_axes,
    page_of_panels,
    path_ends,
    plain_axes,
    title,
    value_list,
)
from lirs_wct.geometry import OccupancyGrid, Trajectory

WIDTH, SIDE = 6.4, 4.0
"""Widths of the map, and of metrics and plots beside it, inches."""
LINE = 110
"""Characters in a line of the verdict."""
EMPTY_SLOTS = 2
"""Plot slots under the metrics of a log without errors to plot."""
ROW, LEAST_PLOT, GAP = 0.21, 1.2, 0.8
"""Heights of a row of the metrics, of the smallest plot, and above a plot, inches."""


def map_overview(
    record: MapRecord,
    grid: OccupancyGrid,
    estimate: Trajectory,
    reference: Trajectory | None,
    accuracy: Accuracy,
) -> Drawing:
    """Draw a mapped log on one page.

    The estimate has the pose of every scan in the map, the reference is in its own frame; missing errors are
    not drawn.
    """
    canvas = Canvas.over(bounds_shown(estimate, grid), round(WIDTH * PAGE_DPI))
    rows, cols = canvas.shape
    plots, lines = _plots(record, accuracy), map_lines(record)
    listed = ROW * len(lines)
    tall = max(WIDTH * min(max(rows / cols, 0.4), 1.6), 3.6, listed + len(plots) * (LEAST_PLOT + GAP))
    c = record.config
    verdict = textwrap.fill(str(record.verdict), LINE)
    text = f"{Path(c.log).name}: mapped by {c.mapper}, seed {c.seed}\n{verdict}"
    figure, halves = page_of_panels(text, (tall,), (WIDTH, SIDE))
    _map(figure.add_subplot(halves[0]), canvas, grid, estimate, _reference_in_map(reference, accuracy))
    slots = len(plots) or EMPTY_SLOTS
    heights = (listed, *[(tall - listed) / slots - GAP] * slots)
    cells = halves[1].subgridspec(
        len(heights), 1, height_ratios=heights, hspace=GAP * len(heights) / sum(heights)
    )
    value_list(figure.add_subplot(cells[0]), lines)
    for k, (name, unit, stamps, errors) in enumerate(plots, start=1):
        _errors(figure.add_subplot(cells[k]), name, unit, stamps - estimate.stamps[0], errors)
    return figure


def _plots(record: MapRecord, accuracy: Accuracy) -> list[tuple[str, str, FloatArray, FloatArray]]:
    """Return name, unit, stamps and errors of each plot with data."""
    plots = []
    constraints, reference = accuracy.constraints, accuracy.reference
    if reference is not None and len(reference.stamps):
        name = f"Against the reference (RMSE {record.accuracy['reference']['ate_rmse']:.3f} m)"
        plots.append((name, "m", reference.stamps, reference.position))
    if constraints is not None and len(constraints.stamps):
        errors, stamps = record.accuracy["relations"], constraints.stamps
        name = f"Relative-pose constraints (mean {errors['translation_mean']:.3f} m)"
        plots.append((name, "m", stamps, constraints.translation))
        name = f"... their rotation (mean {errors['rotation_mean_deg']:.2f} deg)"
        plots.append((name, "deg", stamps, np.degrees(constraints.rotation)))
    return plots


def _reference_in_map(reference: Trajectory | None, accuracy: Accuracy) -> Trajectory | None:
    """Return the reference in the map frame; None if it was not compared."""
    if reference is None or accuracy.reference is None or not len(accuracy.reference.stamps):
        return None
    return reference.moved(accuracy.reference.T_map_reference)


def _map(
    axes: Axes, canvas: Canvas, grid: OccupancyGrid, estimate: Trajectory, reference: Trajectory | None
) -> None:
    map_axes(axes, canvas, canvas.grid_picture(grid))
    axes.set_anchor("N")
    handles = []
    if reference is not None:
        axes.plot(*reference.xy.T, color=BLUE, linewidth=2.0, alpha=0.6, zorder=3)
        handles.append(Line2D([], [], color=BLUE, linewidth=2.0, alpha=0.6, label="reference"))
    axes.plot(*estimate.xy.T, color=VERMILLION, linewidth=0.8, zorder=4)
    handles.append(Line2D([], [], color=VERMILLION, linewidth=0.8, label="path"))
    handles += path_ends(axes, estimate)
    title(axes, "Map and path")
    legend(axes, handles)


def _errors(axes: Axes, name: str, unit: str, seconds: FloatArray, errors: FloatArray) -> None:
    """Draw errors over time, each a dot, with their mean."""
    axes.plot(seconds, errors, ".", color=BLACK, markersize=1.6, rasterized=True)
    axes.axhline(float(errors.mean()), color=GREEN, linewidth=1.2)
    plain_axes(axes, "time [s]", f"error [{unit}]")
    axes.set_ylim(0.0, max(1e-6, 1.05 * float(np.percentile(errors, 99.5))))
    axes.grid(axis="y", color=GRAY, alpha=0.2, linewidth=0.6)
    title(axes, name)
