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
    bare_figure,
    bounds_shown,
    head_height,
    headline,
    legend,
    map_axes,
    page_size,
    panel_grid,
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
LEAST_PLOTS = 2
"""Smallest number of plot slots under the metrics."""


def map_overview(
    record: MapRecord,
    grid: OccupancyGrid,
    estimate: Trajectory,
    reference: Trajectory | None,
    accuracy: Accuracy,
) -> Drawing:
    """Draw a mapped log on one page.

    Args:
        record: its metrics.
        grid: the map.
        estimate: pose of every scan in the map.
        reference: in its own frame.
        accuracy: errors of each pose; missing ones are not drawn.
    """
    canvas = Canvas.over(bounds_shown(estimate, grid), round(WIDTH * PAGE_DPI))
    rows, cols = canvas.shape
    plots = _plots(record, accuracy)
    tall = max(WIDTH * min(max(rows / cols, 0.4), 1.6), 3.6)
    c, widths = record.config, (WIDTH, SIDE)
    verdict = textwrap.fill(str(record.verdict), LINE)
    text = f"{Path(c.log).name}: mapped by {c.mapper}, seed {c.seed}\n{verdict}"
    head = head_height(text)
    figure = bare_figure(*page_size((tall,), widths, head=head), PAGE_DPI)
    headline(figure, text)
    halves = panel_grid(figure, (tall,), widths, head=head)
    _map(figure.add_subplot(halves[0]), canvas, grid, estimate, _reference_in_map(reference, accuracy))
    rows = max(len(plots), LEAST_PLOTS)
    cells = halves[1].subgridspec(1 + rows, 1, height_ratios=(1.5, *[1.0] * rows), hspace=0.6)
    value_list(figure.add_subplot(cells[0]), map_lines(record))
    for k, (name, unit, stamps, errors) in enumerate(plots, start=1):
        _errors(figure.add_subplot(cells[k]), name, unit, stamps - estimate.stamps[0], errors)
    return figure


def _plots(record: MapRecord, accuracy: Accuracy) -> list[tuple[str, str, FloatArray, FloatArray]]:
    """Return name, unit, stamps and errors of each plot with data."""
    plots = []
    constraints, reference = accuracy.constraints, accuracy.reference
    if reference is not None and len(reference.stamps):
        ate = record.accuracy["reference"]["ate_rmse"]
        plots.append((f"Against the reference (RMSE {ate:.3f} m)", "m", reference.stamps, reference.position))
    if constraints is not None and len(constraints.stamps):
        errors = record.accuracy["relations"]
        mean, turn = errors["translation_mean"], errors["rotation_mean_deg"]
        plots.append(
            (
                f"Relative-pose constraints (mean {mean:.3f} m)",
                "m",
                constraints.stamps,
                constraints.translation,
            )
        )
        plots.append(
            (
                f"... their rotation (mean {turn:.2f} deg)",
                "deg",
                constraints.stamps,
                np.degrees(constraints.rotation),
            )
        )
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
