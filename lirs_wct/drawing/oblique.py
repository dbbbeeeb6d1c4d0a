"""Oblique view of a height block, drawn column by column from front to back, without OpenGL."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from lirs_wct.arrays import FloatArray
from lirs_wct.drawing.canvas import Canvas
from lirs_wct.kernels import njit

TURN, TILT = math.radians(-28), math.radians(35)
"""Azimuth of the viewer, south and slightly west, and angle by which the viewer looks down, radians."""
CUT = (0.62, 0.60, 0.57)
"""Color of the block's cut faces."""


class _Screen(NamedTuple):
    """Position of the picture's rows and columns; lengths in meters from the block's center.

    Attributes:
        left: rightward coordinate of the picture's left edge.
        near: depth of the block's nearest corner.
        far: depth of its farthest corner.
        lowest: upward coordinate of the picture's lower edge.
        unit: edge of the picture's pixels.
        base: height of the cut face below the lowest ground.
        pixel: edge of the canvas's pixels.
        tilt: angle by which the viewer looks down, radians.
    """

    left: float
    near: float
    far: float
    lowest: float
    unit: float
    base: float
    pixel: float
    tilt: float


def oblique_view(
    z: FloatArray,
    tops: FloatArray,
    sides: FloatArray,
    canvas: Canvas,
    *,
    exaggeration: float = 1.0,
    tilt: float = TILT,
    width: int = 1100,
) -> FloatArray:
    """Return a (rows, width, 4) orthographic view of a block of ground, transparent outside.

    Args:
        z: (rows, cols) meters, row 0 = north; NaN where there is no ground.
        tops: (rows, cols, 3) colors of nearly level faces.
        sides: (rows, cols, 3) colors of faces that rise towards the north.
        canvas: placement of these pixels.
        exaggeration: factor of the heights.
        tilt: angle by which the viewer looks down, radians.
        width: width of the picture, pixels.
    """
    w, s, e, n = canvas.bounds
    corners = np.array([(x - (w + e) / 2, y - (s + n) / 2) for x in (w, e) for y in (s, n)])
    right, depth = rotate_to_view(corners)
    low = float(np.nanmin(z))
    heights = (z - low) * exaggeration
    base = 0.04 * max(e - w, n - s)
    unit = (right.max() - right.min()) / width
    lowest = depth.min() * math.sin(tilt) - base * math.cos(tilt)
    highest = depth.max() * math.sin(tilt) + float(np.nanmax(heights)) * math.cos(tilt)
    rows = int((highest - lowest) / unit) + 2
    picture = np.zeros((rows, width, 4))
    screen = _Screen(
        left=float(right.min()),
        near=float(depth.min()),
        far=float(depth.max()),
        lowest=float(lowest),
        unit=float(unit),
        base=base,
        pixel=canvas.pixel,
        tilt=tilt,
    )
    _draw(picture, heights, tops, sides, screen)
    return picture[::-1]


def rotate_to_view(xy: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return rightward and depth coordinates of points (n, 2) relative to the center."""
    c, s = math.cos(TURN), math.sin(TURN)
    return c * xy[:, 0] + s * xy[:, 1], -s * xy[:, 0] + c * xy[:, 1]


@njit(cache=True)
def _draw(picture: FloatArray, z: FloatArray, tops: FloatArray, sides: Any, screen: _Screen) -> None:
    """Paint each column from front to back where the ground rises above the nearer ground.

    Row 0 = bottom.
    """
    rows, cols = z.shape
    height, width = picture.shape[0], picture.shape[1]
    left, near, far, lowest, unit, base, pixel, tilt = screen
    c, s = math.cos(TURN), math.sin(TURN)
    step = 0.5 * pixel
    for u in range(width):
        right = left + (u + 0.5) * unit
        horizon, last = -1, 0.0
        depth = near
        while depth <= far:
            x = c * right - s * depth + cols * pixel / 2
            y = s * right + c * depth + rows * pixel / 2
            j, i = math.floor(x / pixel), rows - 1 - math.floor(y / pixel)
            if 0 <= j < cols and 0 <= i < rows and not math.isnan(z[i, j]):
                ground = depth * math.sin(tilt) - lowest
                top = int((ground + z[i, j] * math.cos(tilt)) / unit)
                if horizon < 0:
                    # The cut face of the block, from its base up to the ground.
                    horizon, last = int((ground - base * math.cos(tilt)) / unit) - 1, z[i, j]
                    for v in range(max(0, horizon + 1), min(top, height - 1) + 1):
                        picture[v, u, :3] = CUT
                        picture[v, u, 3] = 1.0
                    horizon = max(horizon, top)
                elif top > horizon:
                    rises = z[i, j] - last > 1.2 * step
                    for v in range(horizon + 1, min(top, height - 1) + 1):
                        picture[v, u, :3] = sides[i, j] if rises else tops[i, j]
                        picture[v, u, 3] = 1.0
                    horizon = top
                last = z[i, j]
            depth += step
