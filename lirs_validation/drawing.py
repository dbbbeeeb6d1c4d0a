"""Overview pictures of a run and of a mapped log, one page each."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import scipy  # its modules load on first use
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from lirs_validation.config import TOUR, driver_parts
from lirs_validation.metrics.elevation import ElevationMap
from lirs_validation.metrics.map import contradicted
from lirs_validation.metrics.mapped_log import Accuracy
from lirs_validation.record.map_record import MapRecord, map_lines
from lirs_validation.record.metric_catalog import WORSE, picture_lines, worse_than_odometry
from lirs_validation.record.run_record import SUCCEEDED, RunRecord
from lirs_wct import FloatArray, OccupancyGrid, Trajectory, World
from lirs_wct.drawing.canvas import (
    BLACK,
    BLUE,
    GRAY,
    GREEN,
    MAP_MARGIN,
    PAGE_DPI,
    UNKNOWN_SHADE,
    VERMILLION,
    WALL,
    Canvas,
    Drawing,
    bounds_shown,
    height_colors,
    legend,
    map_axes,
    page_of_panels,
    path_ends,
    plain_axes,
    shaded_heights,
    title,
    value_list,
)

FULL_COLOR_ERROR = 0.20
"""Height error at full color, meters."""
PANEL = 4.4
"""Width of a panel, inches."""
HEADLINE_LETTERS = 150
"""Characters of a line of the headline."""
TRUE_PATH: dict[str, Any] = {"color": BLUE, "linewidth": 2.6, "zorder": 4, "label": "true"}
ESTIMATED_PATH: dict[str, Any] = {"color": VERMILLION, "linewidth": 1.1, "zorder": 5, "label": "estimated"}
MAP_WIDTH, SIDE_WIDTH = 6.4, 4.0
"""Widths of the map, and of metrics and plots beside it, inches."""
VERDICT_LETTERS = 110
"""Characters in a line of the verdict."""
EMPTY_SLOTS = 2
"""Plot slots under the metrics of a log without errors to plot."""
ROW_HEIGHT, MIN_PLOT, PLOT_GAP = 0.21, 1.2, 0.8
"""Heights of a row of the metrics, of the smallest plot, and above a plot, inches."""
REFERENCE: dict[str, Any] = {"color": BLUE, "linewidth": 2.0, "alpha": 0.6, "label": "reference"}
MAPPED_PATH: dict[str, Any] = {"color": VERMILLION, "linewidth": 0.8, "zorder": 4, "label": "path"}


def overview_figure(
    world: World,
    record: RunRecord,
    paths: tuple[Trajectory, Trajectory],
    true_pose: OccupancyGrid,
    built: OccupancyGrid | None,
    aligned: OccupancyGrid | None = None,
    elevation: ElevationMap | None = None,
) -> Drawing:
    """Draw a run on one page; true and estimated path and maps are in the world frame."""
    truth, estimate = paths
    canvas = Canvas.over(shown_bounds(world, truth, true_pose), round(PANEL * PAGE_DPI))
    rows, cols = canvas.shape
    tall = PANEL * min(max(rows / cols, 0.35), 1.5)
    heights, widths = (max(tall, 4.2), tall), (PANEL,) * 3
    figure, grid = page_of_panels(
        f"{_headline(record)}\n{textwrap.fill(str(record.verdict), HEADLINE_LETTERS)}", heights, widths
    )
    name = "Terrain and paths" if world.walls is None else "Input map and paths"
    styled = ((truth, TRUE_PATH), (estimate, ESTIMATED_PATH))
    axes = figure.add_subplot(grid[0, 0])
    _draw_map_with_paths(axes, canvas, shaded_heights(world, canvas), name, truth, *styled)
    _draw_rtf(figure.add_subplot(grid[0, 1]), record.rtf)
    value_list(figure.add_subplot(grid[0, 2]), picture_lines(record.to_dict()))
    axes = figure.add_subplot(grid[1, 0])
    map_axes(axes, canvas, canvas.grid_picture(true_pose))
    title(axes, "Map at the true poses")
    if elevation is not None:
        panels = figure.add_subplot(grid[1, 1]), figure.add_subplot(grid[1, 2])
        _draw_elevation(panels, canvas, world, elevation)
    for k, name, drawn in ((1, "Built map", built), (2, "Built map, aligned", aligned)):
        if drawn is not None:
            axes = figure.add_subplot(grid[1, k])
            title(axes, name)
            _draw_built_map(axes, canvas, drawn, true_pose)
    return figure


def shown_bounds(
    world: World, truth: Trajectory, true_pose: OccupancyGrid
) -> tuple[float, float, float, float]:
    """Return west, south, east, north bounds of the seen part of the world, meters."""
    seen = np.array(bounds_shown(truth, true_pose))
    low = np.maximum(seen[:2], world.surface.bounds[:2])
    high = np.minimum(seen[2:], world.surface.bounds[2:])
    middle, half = (low + high) / 2, np.maximum((high - low) / 2, MAP_MARGIN)
    west, south = (middle - half).tolist()
    east, north = (middle + half).tolist()
    return west, south, east, north


def _headline(record: RunRecord) -> str:
    c = record.config
    method = c.mapper + (" without attitude" if c.attitude == "none" else "")
    driver = "" if c.driver == TOUR else f", driver {driver_parts(c.driver)[0]}"
    actors = f", {c.actors} walkers" if c.actors else ""
    text = f"{record.world['name']}: {c.robot} maps with {method}{driver}{actors}, seed {c.seed}"
    if worse_than_odometry(asdict(record)):
        text += f" ({WORSE})"
    if record.status == "ok":
        return text
    return f"{text} ({'' if record.status in SUCCEEDED else 'failed: '}{record.reason or record.status})"


def _draw_map_with_paths(
    axes: Axes,
    canvas: Canvas,
    picture: FloatArray,
    name: str,
    ends: Trajectory,
    *paths: tuple[Trajectory, dict[str, Any]],
) -> None:
    map_axes(axes, canvas, picture)
    axes.set_anchor("N")
    title(axes, name)
    lines = [line for path, style in paths for line in axes.plot(*path.xy.T, **style)]
    legend(axes, [*lines, *path_ends(axes, ends)])


def _draw_built_map(axes: Axes, canvas: Canvas, built: OccupancyGrid, true_pose: OccupancyGrid) -> None:
    """Show a built map; mark walls missing or over 0.10 m off the true-pose map."""
    picture = canvas.grid_picture(built)
    for asked, other, color in ((true_pose, built, BLUE), (built, true_pose, VERMILLION)):
        wrong = contradicted(asked, other)
        marked = canvas.mark_pixels(wrong, asked)
        picture[scipy.ndimage.binary_dilation(marked)] = to_rgb(color)  # a wall is a pixel wide
    map_axes(axes, canvas, picture)
    handles = [
        Patch(color="black", label="occupied"),
        Patch(color=VERMILLION, label="> 0.10 m off"),
        Patch(color=BLUE, label="missing"),
    ]
    legend(axes, handles)


def _draw_rtf(axes: Axes, rtf: Mapping[str, Any]) -> None:
    """Draw simulated seconds per wall second over time, with mean and standard deviation."""
    series = np.asarray(rtf["series"], dtype=np.float64)
    mean, std = float(rtf["mean"]), float(rtf["std"])
    axes.axhspan(mean - std, mean + std, color=GREEN, alpha=0.13, linewidth=0)
    marker = "." if len(series) < 4 else ""
    axes.plot(np.arange(1, len(series) + 1), series, color=BLACK, linewidth=0.9, marker=marker)
    _style_plot(axes, "Real-time factor", "simulated time [s]", "real-time factor", mean)
    axes.set_ylim(0.0, max(1.0, 1.15 * float(series.max(initial=mean))))
    axes.set_xlim(0.0, max(1.0, float(len(series))))
    legend(axes, [Line2D([], [], color=GREEN, linewidth=1.2, label=f"mean {mean:.1f}, std {std:.1f}")])


def _style_plot(axes: Axes, name: str, x: str, y: str, mean: float) -> None:
    """Draw the mean of a plot over time, its grid, labels and title."""
    axes.axhline(mean, color=GREEN, linewidth=1.2)
    plain_axes(axes, x, y)
    axes.grid(axis="y", color=GRAY, alpha=0.2, linewidth=0.6)
    title(axes, name)


def _draw_elevation(axes: tuple[Axes, Axes], canvas: Canvas, world: World, built: ElevationMap) -> None:
    """Show the mapper's heights in the terrain's colors, and their difference from the true surface."""
    low, high = float(world.surface.z.min()), float(world.surface.z.max())
    z = _sample(canvas, built, built.mean)
    picture = height_colors()((np.nan_to_num(z, nan=low) - low) / max(high - low, 1.0))[..., :3]
    map_axes(axes[0], canvas, _with_unknown(picture, z, canvas, world))
    title(axes[0], "Elevation by the mapper's poses")
    map_axes(axes[1], canvas, error_picture(canvas, world, built))
    title(axes[1], "Less the surface")
    handles = [
        Patch(color=BLUE, label=f"{FULL_COLOR_ERROR:.1f} m too low"),
        Patch(color=VERMILLION, label="too high"),
    ]
    legend(axes[1], handles)


def error_picture(canvas: Canvas, world: World, built: ElevationMap) -> FloatArray:
    """Return (rows, cols, 3) height errors as colors.

    White = exact, blue = too low, vermillion = too high, gray = not seen.
    """
    error = _sample(canvas, built, built.error(world.surface, world.walls))
    share = np.clip(np.nan_to_num(error) / FULL_COLOR_ERROR, -1, 1)[..., None]
    color = np.where(share > 0, to_rgb(VERMILLION), to_rgb(BLUE))
    return _with_unknown(1 - np.abs(share) * (1 - color), error, canvas, world)


def _with_unknown(picture: FloatArray, values: FloatArray, canvas: Canvas, world: World) -> FloatArray:
    picture[np.isnan(values)] = UNKNOWN_SHADE
    if world.walls is not None:
        picture[canvas.mark_pixels(world.walls.solid, world.walls)] = WALL
    return picture


def _sample(canvas: Canvas, grid: ElevationMap, values: FloatArray) -> FloatArray:
    """Return (rows, cols) cell values at the canvas' pixels; NaN off the grid."""
    index = np.floor((canvas.centers - grid.origin) / grid.cell).astype(np.int64)
    col, row = index[..., 0], index[..., 1]
    inside = (row >= 0) & (row < values.shape[0]) & (col >= 0) & (col < values.shape[1])
    return np.where(inside, values[np.where(inside, row, 0), np.where(inside, col, 0)], np.nan)


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
    canvas = Canvas.over(bounds_shown(estimate, grid), round(MAP_WIDTH * PAGE_DPI))
    rows, cols = canvas.shape
    plots, lines = _error_plots(record, accuracy), map_lines(record)
    listed = ROW_HEIGHT * len(lines)
    tall = max(MAP_WIDTH * min(max(rows / cols, 0.4), 1.6), 3.6, listed + len(plots) * (MIN_PLOT + PLOT_GAP))
    c = record.config
    verdict = textwrap.fill(str(record.verdict), VERDICT_LETTERS)
    text = f"{Path(c.log).name}: mapped by {c.mapper}, seed {c.seed}\n{verdict}"
    figure, halves = page_of_panels(text, (tall,), (MAP_WIDTH, SIDE_WIDTH))
    if accuracy.reference is None or not len(accuracy.reference.stamps):
        reference = None
    elif reference is not None:
        reference = reference.moved(accuracy.reference.T_map_reference)
    paths = [(estimate, MAPPED_PATH)]
    paths += [] if reference is None else [(reference, REFERENCE)]
    axes = figure.add_subplot(halves[0])
    _draw_map_with_paths(axes, canvas, canvas.grid_picture(grid), "Map and path", estimate, *reversed(paths))
    slots = len(plots) or EMPTY_SLOTS
    heights = (listed, *[(tall - listed) / slots - PLOT_GAP] * slots)
    cells = halves[1].subgridspec(
        len(heights), 1, height_ratios=heights, hspace=PLOT_GAP * len(heights) / sum(heights)
    )
    value_list(figure.add_subplot(cells[0]), lines)
    for k, (name, unit, stamps, errors) in enumerate(plots, start=1):
        axes = figure.add_subplot(cells[k])
        axes.plot(stamps - estimate.stamps[0], errors, ".", color=BLACK, markersize=1.6, rasterized=True)
        _style_plot(axes, name, "time [s]", f"error [{unit}]", float(errors.mean()))
        axes.set_ylim(0.0, max(1e-6, 1.05 * float(np.percentile(errors, 99.5))))
    return figure


def _error_plots(record: MapRecord, accuracy: Accuracy) -> list[tuple[str, str, FloatArray, FloatArray]]:
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
