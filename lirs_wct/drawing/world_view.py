"""The picture of a world: from above with its start poses, and at an angle."""

from __future__ import annotations

import math

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke

from lirs_wct.arrays import FloatArray
from lirs_wct.drawing.canvas import Canvas
from lirs_wct.drawing.hillshade import WALL, height_colors, shaded_heights
from lirs_wct.drawing.oblique import oblique_view
from lirs_wct.drawing.style import (
    BLACK,
    SMALL,
    TEXT,
    VERMILLION,
    Drawing,
    legend,
    map_axes,
    new_figure,
    plain_axes,
    title,
)
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.world import World

WALL_TOP, WALL_SIDE = (0.47, 0.50, 0.56), (0.30, 0.32, 0.38)


def view_figure(world: World) -> Drawing:
    """Draw a world from above and at an angle, with its start poses; no OpenGL, no pyplot."""
    canvas = Canvas.over(world.surface.bounds)
    shaded = shaded_heights(world, canvas)
    exaggeration = _exaggeration(world)
    block = block_picture(world, canvas)
    rows, cols = canvas.shape
    taller = max(5.1 * rows / cols, 5.6 * block.shape[0] / block.shape[1])
    figure = new_figure(12.0, 0.9 + min(taller, 9.0))
    above, oblique = figure.subplots(1, 2, gridspec_kw={"width_ratios": (1, 1.1)})
    map_axes(above, canvas, shaded)
    _starts(above, world)
    width, depth = world.surface.size
    above_title = f"{world.name}, {width:g} m x {depth:g} m"
    title(
        above,
        above_title if world.walls is not None else f"{above_title}, relief {world.surface.relief:.3g} m",
    )
    oblique.imshow(block, interpolation="antialiased")
    oblique.set_axis_off()
    stretched = "" if exaggeration == 1 else f", heights stretched {exaggeration:g} times"
    title(oblique, f"from the south-south-west{stretched}")
    for axes in (above, oblique):
        axes.set_anchor("N")
    height_scale(figure, oblique, world.surface)
    return figure


def block_picture(world: World, canvas: Canvas) -> FloatArray:
    """Return (rows, cols, 4) the world as a block seen at an angle; transparent around it."""
    tilt = math.radians(35 if world.walls is None else 50)
    tops, sides = _block_colors(world, canvas, shaded_heights(world, canvas))
    return oblique_view(
        _standing(world, canvas), tops, sides, canvas, exaggeration=_exaggeration(world), tilt=tilt
    )


def _block_colors(world: World, canvas: Canvas, shaded: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (rows, cols, 3) colors of what lies level and of faces that rise, for the oblique view."""
    tops = shaded.copy()
    if world.walls is not None:
        tops[canvas.walls(world.walls)] = WALL_TOP
        return tops, np.broadcast_to(np.array(WALL_SIDE), tops.shape)
    z = np.nan_to_num(canvas.heights(world.surface)).astype(np.float32)
    north, east = np.gradient(cv2.blur(z, (5, 5)), -canvas.pixel, canvas.pixel)
    steepness = np.hypot(north, east)
    low = float(world.surface.z.min())
    summit = cv2.dilate(z, np.ones((7, 7)))
    tint = height_colors()((summit - low) / max(world.surface.relief, 1e-9))[..., :3]
    # Faces that fall to the west are lit, those that fall to the south lie in shade.
    facing_west = east / np.maximum(steepness, 1e-6)
    # Under the rim of a face the hillshade is dark, which would fray its upper edge.
    rim = (steepness > 1.0) & (z > summit - 0.3)
    tops[rim] = tint[rim]
    return tops, tint * (0.60 + 0.12 * facing_west[..., None])


def _starts(axes: Axes, world: World) -> None:
    """Draw an arrow at each spawn pose, numbered as in `World.spawn_poses`."""
    west, _, east, _ = world.surface.bounds
    length = 0.035 * (east - west)
    for number, pose in enumerate(world.spawn_poses, start=1):
        tip = (pose.x + length * math.cos(pose.yaw), pose.y + length * math.sin(pose.yaw))
        arrow = {"arrowstyle": "-|>", "color": VERMILLION, "linewidth": 1.5, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", tip, (pose.x, pose.y), arrowprops=arrow, zorder=6)
        axes.plot(pose.x, pose.y, "o", color=VERMILLION, markersize=4.5, markeredgecolor="white", zorder=7)
        # Beside the arrow: behind it lies the border where a start is in a corner.
        beside = (-9 * math.sin(pose.yaw), 9 * math.cos(pose.yaw))
        label = axes.annotate(str(number), (pose.x, pose.y), beside, textcoords="offset points", zorder=7)
        label.set(fontsize=SMALL, color=BLACK, ha="center", va="center")
        label.set_path_effects([withStroke(linewidth=2, foreground="white")])
    handles: list[Line2D | Patch] = []
    if world.spawn_poses:
        handles.append(Line2D([], [], color=VERMILLION, marker="o", markersize=4.5, label="start pose"))
    if world.walls is not None:
        handles.append(Patch(color=WALL, label=f"wall, {world.walls.height:g} m"))
    if handles:
        legend(axes, handles)


def _standing(world: World, canvas: Canvas) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """Return (rows, cols) metres of the ground and of the walls' tops."""
    z = canvas.heights(world.surface)
    if world.walls is not None:
        z = np.where(canvas.walls(world.walls), np.fmax(z, world.walls.height), z)
    return z


def _exaggeration(world: World) -> float:
    """Return how much to stretch heights so that the relief is a tenth of the width, at most 3 times."""
    relief = world.surface.relief
    if world.walls is not None or relief <= 0:
        return 1.0
    return float(np.clip(round(0.2 * max(world.surface.size) / relief) / 2, 1.0, 3.0))


def height_scale(figure: Figure, axes: Axes, surface: HeightField) -> None:
    """Add the color scale of the heights, where there are heights."""
    if surface.relief <= 0:
        return
    limits = Normalize(float(surface.z.min()), float(surface.z.max()))
    bar = figure.colorbar(ScalarMappable(limits, height_colors()), ax=axes, shrink=0.6, aspect=28, pad=0.01)
    plain_axes(bar.ax, "", "")
    bar.set_label("height [m]", fontsize=TEXT)
    bar.outline.set_visible(False)
