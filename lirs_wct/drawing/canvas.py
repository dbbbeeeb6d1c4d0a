"""Style of all pictures, and canvas of top views: hillshade, maps, paths.

Fonts, colors for color-blind readers, axes in meters. Panels of any aspect ratio are placed by the inch.
Matplotlib's constrained layout first gives axes of equal aspect a box and then shrinks them in it, so that
text below them may leave the figure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Colormap, LightSource, LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from PIL import Image

from lirs_wct.geometry import BoolArray, FloatArray, HeightField, OccupancyGrid, Trajectory, WallGrid, mask_at
from lirs_wct.world import World

DPI, PAGE_DPI, SCREEN_DPI = 150, 100, 72
"""Resolution of files, of the overviews of runs and mapped logs, and in Jupyter, dots per inch."""
COMPRESSION = 3
"""zlib level of PNG files; the usual level 6 takes twice the time for 4 % fewer bytes."""
TITLE_SIZE, TEXT_SIZE, SMALL_SIZE = 10.5, 9.0, 8.0
"""Font sizes, points."""

BLUE, VERMILLION, GREEN, BLACK, GRAY = "#0072B2", "#D55E00", "#009E73", "#1a1a1a", "#6b6b6b"
"""Okabe and Ito's colors: distinct with every kind of color blindness and in gray."""

SPACE_LEFT, SPACE_BELOW, GAP, RIM = 0.9, 0.6, 0.35, 0.12
"""Space left of a map and below it (ticks and labels), between panels, and at the figure's rim, inches."""
MIN_LEGEND_WIDTH = 2.6
"""Panel width below which the legend does not fit above the right end, inches."""


def title(axes: Axes, text: str, *, above_legend: bool = False) -> None:
    """Set a panel's title, left-aligned; above a legend it takes a separate line."""
    pad = 5 + (SMALL_SIZE + 8 if above_legend else 0)
    axes.set_title(text, fontsize=TITLE_SIZE, loc="left", color=BLACK, pad=pad)


def length(meters: float) -> str:
    """Format a length for a title, with three or four significant digits."""
    return f"{meters:,.0f} m" if meters >= 1000 else f"{meters:.4g} m" if meters >= 100 else f"{meters:.3g} m"


def plain_axes(axes: Axes, x: str, y: str) -> None:
    """Label axes, shrink ticks, hide the frame's upper and right side."""
    axes.set_xlabel(x, fontsize=TEXT_SIZE, color=BLACK)
    axes.set_ylabel(y, fontsize=TEXT_SIZE, color=BLACK)
    axes.tick_params(labelsize=SMALL_SIZE, length=3, width=0.6, colors=BLACK)
    for side, spine in axes.spines.items():
        spine.set_linewidth(0.6)
        spine.set_visible(side in ("left", "bottom"))


def map_axes(axes: Axes, canvas: Canvas, picture: FloatArray) -> None:
    """Show a picture (rows, cols, 3) in [0, 1] with equal axes in meters."""
    levels = np.rint(picture * 255).astype(np.uint8)
    axes.imshow(levels, extent=canvas.extent, interpolation="antialiased", zorder=0)
    plain_axes(axes, "x [m]", "y [m]")
    for spine in axes.spines.values():
        spine.set_visible(True)
        spine.set_color(GRAY)
    axes.set_aspect("equal")
    axes.set_xlim(canvas.bounds[0], canvas.bounds[2])
    axes.set_ylim(canvas.bounds[1], canvas.bounds[3])
    axes.locator_params(nbins=7)


def legend(axes: Axes, handles: Sequence[Any], *, side: Literal["left", "right"] = "right") -> None:
    """Put a small legend above the left or right end of a panel."""
    axes.legend(
        handles=handles,
        loc="lower left" if side == "left" else "lower right",
        bbox_to_anchor=(float(side == "right"), 1.0),
        ncols=len(handles),
        fontsize=SMALL_SIZE,
        frameon=False,
        borderpad=0.1,
        borderaxespad=0.15,
        handlelength=1.6,
        handletextpad=0.4,
        columnspacing=1.0,
    )


def value_list(axes: Axes, lines: Sequence[tuple[str, str]]) -> None:
    """Write a table with names on the left and values on the right."""
    axes.set_axis_off()
    axes.set_xlim(0, 1)
    axes.set_ylim(0, 1)
    step = 1.0 / max(len(lines), 10)
    heights = 0.94 - step * np.arange(len(lines))
    for y, (name, value) in zip(heights, lines, strict=True):
        axes.text(0.0, y, name, fontsize=TEXT_SIZE, color=BLACK, va="center")
        axes.text(1.0, y, value, fontsize=TEXT_SIZE, color=BLACK, va="center", ha="right")
    axes.hlines(heights - step / 2, 0.0, 1.0, color=GRAY, linewidth=0.4, alpha=0.5)


def path_ends(axes: Axes, path: Trajectory) -> list[Line2D]:
    """Mark where a path starts and ends; return the marks for the legend."""
    marks: list[Line2D] = []
    for shape, label, xy in (("o", "start", path.xy[0]), ("s", "end", path.xy[-1])):
        marks += axes.plot(
            *xy, shape, color="white", markeredgecolor=BLACK, markersize=5.5, zorder=6, label=label
        )
    return marks


def fewer_ticks(axes: Axes, width: float, height: float) -> None:
    """Limit the ticks of a map to those that fit along its sides, inches."""
    for axis, room in ((axes.xaxis, width / 0.7), (axes.yaxis, height / 0.4)):
        if room < 1:
            axis.set_ticks([axis.get_view_interval()[0]])
        else:
            axis.set_major_locator(MaxNLocator(min(7, int(room))))


class Drawing(Figure):
    """A figure that has a Jupyter picture without pyplot."""

    def savefig(self, fname: Any, **options: Any) -> None:
        """Save the figure as Matplotlib does, a PNG in half the time."""
        kind = options.get("format") or (Path(fname).suffix[1:] if isinstance(fname, (str, Path)) else "png")
        if kind == "png":
            options = {"pil_kwargs": {"compress_level": COMPRESSION}} | options
        super().savefig(fname, **options)

    def _repr_png_(self) -> bytes:
        drawn, small = BytesIO(), BytesIO()
        self.savefig(drawn, dpi=SCREEN_DPI)
        # With 256 colors a notebook is a third as large, without a visible difference.
        Image.open(drawn).convert("RGB").quantize(256).save(small, "png", optimize=True)
        return small.getvalue()


def bare_figure(width: float, height: float, dpi: float = DPI) -> Drawing:
    """Return a white figure in inches without a layout engine."""
    return Drawing(figsize=(width, height), dpi=dpi, facecolor="white")


def page_of_panels(
    text: str, heights: Sequence[float], widths: Sequence[float], dpi: float = PAGE_DPI
) -> tuple[Drawing, GridSpec]:
    """Return a page with a headline, and the grid of its panels (sizes in inches)."""
    head = 0.5 + 0.21 * (1 + text.count("\n"))
    width = len(widths) * SPACE_LEFT + sum(widths) + RIM
    height = head + sum(heights) + len(heights) * (SPACE_BELOW + GAP) - GAP
    page = bare_figure(width, height, dpi)
    page.suptitle(text, fontsize=TITLE_SIZE + 1.5, x=0.012, ha="left", color=BLACK)
    grid = page.add_gridspec(
        *(len(heights), len(widths)),
        height_ratios=heights,
        width_ratios=widths,
        left=SPACE_LEFT / width,
        right=1 - RIM / width,
        top=1 - head / height,
        bottom=SPACE_BELOW / height,
        wspace=SPACE_LEFT * len(widths) / sum(widths),
        hspace=(SPACE_BELOW + GAP) * len(heights) / sum(heights),
    )
    return page, grid


def new_figure(width: float, height: float) -> Drawing:
    """Return a white figure in inches with a constrained layout."""
    figure = bare_figure(width, height)
    figure.set_layout_engine("constrained", w_pad=0.06, h_pad=0.06, wspace=0.02, hspace=0.02)
    return figure


MAP_MARGIN = 1.0
"""Margin around paths and known cells, meters."""
TYPICAL_SLOPE = 0.25
"""Median slope in a hillshade, rise over run, to which heights are exaggerated up to 6 times."""
FREE_SHADE, UNKNOWN_SHADE = 1.0, 0.80
"""Gray of free cells and of unknown cells."""
WALL = (0.16, 0.16, 0.20)
FLOOR, BEYOND = (0.97, 0.97, 0.96), (0.84, 0.84, 0.85)
"""Colors of a laser map's known cells and of its unknown cells."""


@dataclass(frozen=True)
class Canvas:
    """Placement of a picture in the world; row 0 = north.

    Attributes:
        bounds: west, south, east, north in meters.
        shape: rows, columns of square pixels.
    """

    bounds: tuple[float, float, float, float]
    shape: tuple[int, int]

    @staticmethod
    def over(bounds: tuple[float, float, float, float], pixels: int = 900) -> Canvas:
        """Lay square pixels over bounds, `pixels` along the longer side."""
        west, south, east, north = bounds
        pixel = max(east - west, north - south) / pixels
        rows, cols = max(1, round((north - south) / pixel)), max(1, round((east - west) / pixel))
        return Canvas((west, south, west + cols * pixel, south + rows * pixel), (rows, cols))

    @property
    def pixel(self) -> float:
        """Edge of a pixel, meters."""
        return (self.bounds[2] - self.bounds[0]) / self.shape[1]

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """West, east, south, north, as matplotlib's `imshow` expects."""
        west, south, east, north = self.bounds
        return west, east, south, north

    @property
    def centers(self) -> FloatArray:
        """(rows, cols, 2) x and y of the pixels' centers, meters."""
        (west, _, _, north), (rows, cols) = self.bounds, self.shape
        x = west + (np.arange(cols) + 0.5) * self.pixel
        y = north - (np.arange(rows) + 0.5) * self.pixel
        return np.stack(np.meshgrid(x, y), axis=-1)

    def heights(self, surface: HeightField) -> FloatArray:
        """Return (rows, cols) meters; NaN off the surface."""
        return surface.height_at(*np.moveaxis(self.centers, -1, 0))

    def mark_pixels(self, mask: BoolArray, grid: OccupancyGrid | WallGrid) -> BoolArray:
        """Return the pixels that contain a marked cell of a grid, however small.

        Row 0 of `mask` is south.
        """
        seen = mask_at(mask, grid.resolution, grid.origin, self.centers)
        if grid.resolution < self.pixel:
            x, y = grid.origin.apply((np.argwhere(mask)[:, ::-1] + 0.5) * grid.resolution).T
            col = np.floor((x - self.bounds[0]) / self.pixel).astype(np.int64)
            row = np.floor((self.bounds[3] - y) / self.pixel).astype(np.int64)
            inside = (row >= 0) & (row < self.shape[0]) & (col >= 0) & (col < self.shape[1])
            seen[row[inside], col[inside]] = True
        return seen

    def grid_picture(self, grid: OccupancyGrid) -> FloatArray:
        """Return the (rows, cols, 3) picture of a map: black occupied, white free, gray unknown."""
        shade = np.full(self.shape, UNKNOWN_SHADE)
        shade[self.mark_pixels(grid.known, grid)] = FREE_SHADE
        shade[self.mark_pixels(grid.occupied, grid)] = 0.0
        return np.repeat(shade[..., None], 3, axis=-1)


def bounds_shown(path: Trajectory, grid: OccupancyGrid) -> tuple[float, float, float, float]:
    """Return west, south, east, north of a path and a map's known cells.

    Meters, with a margin.
    """
    boxes = [(*path.xy.min(axis=0).tolist(), *path.xy.max(axis=0).tolist())]
    known = bounds_of(grid)
    if known is not None:
        boxes.append(known)
    seen = np.array(boxes)
    west, south = (seen[:, :2].min(axis=0) - MAP_MARGIN).tolist()
    east, north = (seen[:, 2:].max(axis=0) + MAP_MARGIN).tolist()
    return west, south, east, north


def bounds_of(grid: OccupancyGrid) -> tuple[float, float, float, float] | None:
    """Return west, south, east, north of a map's known cells, meters; None without any."""
    rows, cols = (np.flatnonzero(grid.known.any(axis=axis)) for axis in (1, 0))
    if len(rows) == 0:
        return None
    low, high = (rows[0], cols[0]), (rows[-1] + 1, cols[-1] + 1)
    corners = np.array([(c, r) for r in (low[0], high[0]) for c in (low[1], high[1])], dtype=np.float64)
    xy = grid.origin.apply(corners * grid.resolution)
    (west, south), (east, north) = xy.min(axis=0).tolist(), xy.max(axis=0).tolist()
    return west, south, east, north


def height_colors() -> Colormap:
    """Return a color scale from low (slate) to high (sand) with rising brightness."""
    return LinearSegmentedColormap.from_list("relief", ["#7d97a5", "#a9b5ac", "#d3cfb4", "#f6e8c6"])


def shaded_heights(world: World, canvas: Canvas) -> FloatArray:
    """Return a (rows, cols, 3) hillshade tinted by height, or floor and walls."""
    if world.truth is not None:
        known = canvas.mark_pixels(world.truth.known, world.truth)
        colors = np.where(known[..., None], FLOOR, BEYOND)
    else:
        colors = shaded_surface(world.surface, canvas)
    if world.walls is not None:
        colors[canvas.mark_pixels(world.walls.solid, world.walls)] = WALL
    return colors


def shaded_surface(surface: HeightField, canvas: Canvas) -> FloatArray:
    """Return a (rows, cols, 3) hillshade, 0 to 1, tinted by height; row 0 = north.

    Heights are exaggerated until the ground's typical slope is visible.
    """
    low, high, pixel = float(surface.z.min()), float(surface.z.max()), canvas.pixel
    z = np.nan_to_num(canvas.heights(surface), nan=low)
    shade = np.full(z.shape, 0.7)
    if min(z.shape) > 1:
        slope = float(np.median(np.hypot(*np.gradient(z, pixel))))
        exaggeration = float(np.clip(TYPICAL_SLOPE / slope, 1.0, 6.0)) if slope > 1e-4 else 1.0
        light = LightSource(azdeg=315, altdeg=45)  # north-west, as on printed maps
        shade = light.hillshade(z, exaggeration, pixel, pixel)
    tint = height_colors()((z - low) / max(high - low, 1e-9))[..., :3]
    shaded: FloatArray = np.clip(tint * (0.42 + 0.78 * shade[..., None]), 0, 1)
    return shaded
