"""Pictures of value types for Jupyter."""

from __future__ import annotations

from functools import singledispatch

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Wedge

from lirs_wct.drawing.canvas import (
    BLACK,
    BLUE,
    GRAY,
    VERMILLION,
    Canvas,
    Drawing,
    bounds_of,
    legend,
    length,
    map_axes,
    new_figure,
    path_ends,
    plain_axes,
    shaded_surface,
    title,
)
from lirs_wct.drawing.world_view import height_scale, view_figure
from lirs_wct.geometry import LaserScan, OccupancyGrid, Trajectory
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.world import World

EDGE = 6.0
"""Longer side of a picture, inches."""


@singledispatch
def figure_of(value: object) -> Drawing:
    """Return the picture of a value.

    Raises:
        TypeError: the type has no picture.
    """
    raise TypeError(f"a {type(value).__name__} has no picture")


figure_of.register(World, view_figure)


@figure_of.register
def surface_figure(surface: HeightField) -> Drawing:
    """Draw heights from above, tinted by height."""
    figure, axes, canvas = _map_figure(surface.bounds)
    map_axes(axes, canvas, shaded_surface(surface, canvas))
    width, depth = surface.size
    title(axes, f"{length(width)} x {length(depth)}, relief {length(surface.relief)}")
    height_scale(figure, surface, ax=axes, shrink=0.6, aspect=28, pad=0.01)
    return figure


@figure_of.register
def grid_figure(grid: OccupancyGrid) -> Drawing:
    """Draw a map: black occupied, white free, gray unknown."""
    rows, cols = grid.shape
    corners = grid.origin.apply(np.array([(c, r) for r in (0, rows) for c in (0, cols)]) * grid.resolution)
    (west, south), (east, north) = corners.min(axis=0).tolist(), corners.max(axis=0).tolist()
    figure, axes, canvas = _map_figure(bounds_of(grid) or (west, south, east, north))
    map_axes(axes, canvas, canvas.grid_picture(grid))
    title(axes, f"cells of {grid.resolution:g} m, {grid.known.mean():.0%} known")
    return figure


@figure_of.register
def scan_figure(scan: LaserScan) -> Drawing:
    """Draw the points of a scan and the field of view up to the farthest point."""
    figure = new_figure(EDGE, EDGE)
    axes = figure.subplots()
    hits = scan.hits
    ranges, angles = scan.ranges[hits], scan.angles[hits]
    reach = float(ranges.max()) if hits.any() else scan.limits[1]
    first, last = np.degrees(scan.angles[[0, -1]]).tolist()
    axes.add_patch(Wedge((0, 0), reach, first, last, facecolor="#eef3f6", edgecolor="none", zorder=0))
    axes.plot(ranges * np.cos(angles), ranges * np.sin(angles), ".", color=BLACK, markersize=2.5)
    axes.plot(0, 0, ">", color=VERMILLION, markersize=8)
    axes.set_aspect("equal")
    axes.set_xlim(-1.05 * reach, 1.05 * reach)
    axes.set_ylim(-1.05 * reach, 1.05 * reach)
    plain_axes(axes, "x of the sensor [m]", "y [m]")
    axes.grid(color=GRAY, alpha=0.2, linewidth=0.6)
    title(axes, f"{len(scan.ranges)} beams, {hits.sum()} hits, {scan.stamp:.2f} s")
    return figure


@figure_of.register
def path_figure(path: Trajectory) -> Drawing:
    """Draw a path from above."""
    figure = new_figure(EDGE, EDGE)
    axes = figure.subplots()
    axes.plot(*path.xy.T, color=BLUE, linewidth=1.4)
    plain_axes(axes, "x [m]", "y [m]")
    axes.set_aspect("equal", adjustable="datalim")
    axes.grid(color=GRAY, alpha=0.2, linewidth=0.6)
    if len(path.stamps):
        legend(axes, path_ends(axes, path))
        title(axes, f"{path.length:.1f} m in {path.stamps[-1] - path.stamps[0]:.1f} s")
    return figure


def _map_figure(bounds: tuple[float, float, float, float]) -> tuple[Drawing, Axes, Canvas]:
    canvas = Canvas.over(bounds)
    rows, cols = canvas.shape
    longer = max(rows, cols)
    figure = new_figure(max(EDGE * cols / longer, 3.0) + 0.8, max(EDGE * rows / longer, 1.5) + 0.6)
    return figure, figure.subplots(), canvas
