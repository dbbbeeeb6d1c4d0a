"""Pictures of value types for Jupyter and files: worlds, surfaces, maps, scans, paths."""

from __future__ import annotations

import math
import textwrap
from dataclasses import replace
from functools import singledispatch
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Wedge
from matplotlib.patheffects import withStroke

from lirs_wct.drawing.canvas import (
    BLACK,
    BLUE,
    DPI,
    FLOOR,
    GRAY,
    MIN_LEGEND_WIDTH,
    SMALL_SIZE,
    SPACE_LEFT,
    TEXT_SIZE,
    VERMILLION,
    WALL,
    Canvas,
    Drawing,
    bounds_of,
    fewer_ticks,
    height_colors,
    legend,
    length,
    map_axes,
    new_figure,
    page_of_panels,
    path_ends,
    plain_axes,
    shaded_heights,
    shaded_surface,
    title,
)
from lirs_wct.geometry import FloatArray, HeightField, LaserScan, OccupancyGrid, Trajectory, fewer_nodes
from lirs_wct.geometry.mesh import TriangleMesh, rasterize_heights
from lirs_wct.geometry.pose import AZIMUTH, ELEVATION, camera_axes
from lirs_wct.meshing.solid import solid_mesh
from lirs_wct.world import World

WIDTH, HALF, TALL, NARROWEST = 10.0, 4.7, 9.0, 1.8
"""Limits in inches: width of a panel, of each of two panels side by side, height of a panel, least width."""
BAR = 0.13
"""Width of the color scale, inches."""
LETTERS = 8.5
"""Letters per inch of the headline."""
MAX_ASPECT = 2.5
"""Ratio of width to depth above which the panels are stacked vertically."""
BLOCK_NODES = 700
"""Limit of nodes along each side of the terrain in the oblique view."""
WALL_TOP, WALL_SIDE = (0.53, 0.56, 0.62), (0.44, 0.46, 0.53)
MAP_TILT = math.radians(50)
"""Angle by which the viewer looks down on a laser map, radians."""
LIGHT = np.array((-0.62, -0.34, 0.71))
"""Unit vector towards the light, which comes from the viewer's left."""
MOST_ROWS = 1600
"""Limit of a picture's height, pixels; the picture of a taller mesh is narrower."""


def view_figure(world: World) -> Drawing:
    """Draw a world from above with start poses, and at an angle."""
    canvas, block = Canvas.over(world.surface.bounds), block_picture(world)
    ratios = [cols / rows for rows, cols in (canvas.shape, block.shape[:2])]
    stacked = ratios[0] > MAX_ASPECT
    fitting = [min(WIDTH if stacked else HALF, TALL * ratio) for ratio in ratios]
    heights = [width / ratio for width, ratio in zip(fitting, ratios, strict=True)]
    widths = [max(width, NARROWEST) for width in fitting]
    if stacked:
        widths = [max(widths)]
    else:
        heights = [max(heights)]
    letters = int(LETTERS * (sum(widths) + len(widths) * SPACE_LEFT))
    text = f"{world.name}, {' x '.join(map(length, world.surface.size))}"
    if world.walls is None:
        text += f", relief {length(world.surface.relief)}"
    text += f"; {'below' if stacked else 'right'}: from the south-south-west"
    if (stretch := _exaggeration(world)) != 1:
        text += f", heights stretched {stretch:g} times"
    page, grid = page_of_panels(textwrap.fill(text, letters), heights, [*widths, BAR], DPI)
    above = page.add_subplot(grid[0, 0], anchor="N")
    map_axes(above, canvas, shaded_heights(world, canvas))
    fewer_ticks(above, fitting[0], fitting[0] / ratios[0])
    _starts(above, world, fitting[0])
    oblique = page.add_subplot(grid[-1, -2], anchor="N")
    oblique.imshow(block, interpolation="antialiased")
    oblique.set_axis_off()
    if world.surface.relief > 0:
        height_scale(page, world.surface, cax=page.add_subplot(grid[-1, -1]), ticklocation="left")
    return page


def block_picture(world: World, width: int = 1100) -> FloatArray:
    """Return a (rows, cols, 4) oblique view of the world as a block, transparent outside.

    A mesh is drawn with its overhangs and in its own proportions, a laser map with its walls, a terrain on a
    grid of pixel resolution with exaggerated heights.
    """
    if world.walls is not None:
        return mesh_view(world.mesh, world.walls.height, tilt=MAP_TILT, width=width)
    if world.solid is not None:
        return mesh_view(world.solid, width=width)
    surface = fewer_nodes(world.surface, BLOCK_NODES)
    surface = replace(surface, z=surface.z * np.float32(_exaggeration(world)))
    return mesh_view(solid_mesh(surface), width=width)


def _starts(axes: Axes, world: World, width: float) -> None:
    """Draw an arrow at each spawn pose, numbered as in `World.spawn_poses`, with a legend.

    The width is that of the panel, inches.
    """
    west, _, east, _ = world.surface.bounds
    length = 0.035 * (east - west)
    for number, pose in enumerate(world.spawn_poses, start=1):
        tip = (pose.x + length * math.cos(pose.yaw), pose.y + length * math.sin(pose.yaw))
        arrow = {"arrowstyle": "-|>", "color": VERMILLION, "linewidth": 1.5, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", tip, (pose.x, pose.y), arrowprops=arrow, zorder=6)
        axes.plot(pose.x, pose.y, "o", color=VERMILLION, markersize=4.5, markeredgecolor="white", zorder=7)
        # Next to the arrow: behind it, the border of the panel would hide the number of a start in a corner.
        beside = (-9 * math.sin(pose.yaw), 9 * math.cos(pose.yaw))
        label = axes.annotate(str(number), (pose.x, pose.y), beside, textcoords="offset points", zorder=7)
        label.set(fontsize=SMALL_SIZE, color=BLACK, ha="center", va="center")
        label.set_path_effects([withStroke(linewidth=2, foreground="white")])
    handles: list[Line2D | Patch] = []
    if world.spawn_poses:
        handles.append(Line2D([], [], color=VERMILLION, marker="o", markersize=4.5, label="start pose"))
    if world.walls is not None:
        handles.append(Patch(color=WALL, label=f"wall, {world.walls.height:g} m"))
    if handles:
        legend(axes, handles, side="left" if width < MIN_LEGEND_WIDTH else "right")


def _exaggeration(world: World) -> float:
    """Return a factor of heights, 1 to 3, for a relief near a tenth of the width."""
    relief = world.surface.relief
    if world.walls is not None or world.solid is not None or relief <= 0:
        return 1.0
    return float(np.clip(round(0.2 * max(world.surface.size) / relief) / 2, 1.0, 3.0))


def height_scale(figure: Figure, surface: HeightField, **where: Any) -> None:
    """Add the color scale of heights unless the ground is flat; see `Figure.colorbar`."""
    if surface.relief <= 0:
        return
    limits = Normalize(float(surface.z.min()), float(surface.z.max()))
    bar = figure.colorbar(ScalarMappable(limits, height_colors()), **where)
    plain_axes(bar.ax, "", "")
    bar.set_label("height [m]", fontsize=TEXT_SIZE)
    bar.outline.set_visible(False)


def mesh_view(
    mesh: TriangleMesh, wall_height: float | None = None, *, tilt: float = -ELEVATION, width: int = 1100
) -> FloatArray:
    """Return a (rows, <= width, 4) orthographic view in true proportions, transparent outside.

    Terrain (no `wall_height`) is colored by height. The tilt is the angle by which the viewer looks down,
    radians; the width is the picture's largest, pixels.
    """
    forward, right_axis, up_axis = camera_axes(AZIMUTH, tilt)
    axes = np.stack((right_axis, up_axis, -forward))
    seen = TriangleMesh(mesh.vertices @ axes.T, mesh.faces)
    (left, low, _), (right, high, _) = seen.bounds
    unit = max((right - left) / (width - 1), (high - low) / MOST_ROWS)
    cols, rows = math.ceil((right - left) / unit) + 1, math.ceil((high - low) / unit) + 1
    nearest = rasterize_heights(seen, (left, low, unit, unit), (rows, cols))
    up, across = np.gradient(nearest, unit)
    normals = np.dstack((-across, -up, np.ones_like(nearest))) @ axes
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    z = (low + unit * np.arange(rows))[:, None] * axes[1, 2] + nearest * axes[2, 2]
    if wall_height is None:
        (_, _, bottom), (_, _, top) = mesh.bounds
        colors = height_colors()((z - bottom) / max(top - bottom, 1e-9))[..., :3]
    else:
        side = np.where(normals[..., 2] > 0.5, z > wall_height / 2, 2)
        colors = np.array((FLOOR, WALL_TOP, WALL_SIDE))[side]
    light = 0.5 + 0.55 * np.clip(np.nan_to_num(normals) @ LIGHT, 0, 1)
    picture = np.dstack((colors * light[..., None], np.ones_like(nearest)))
    picture[np.isnan(nearest)] = 0.0
    shown: FloatArray = np.clip(picture[::-1], 0, 1)
    return shown


EDGE = 6.0
"""Longer side of a picture, inches."""


@singledispatch
def figure_of(value: object) -> Drawing:
    """Return the picture of a value."""
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
    """Draw the points of a scan, and its field of view."""
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
