"""Route across a course from west to east, along which the ground is gentle."""

from __future__ import annotations

import cv2
import numpy as np

from lirs_envs.generators.natural import NODES
from lirs_wct.arrays import Float32Array, FloatArray

CELL = 0.1
"""Spacing of a course's nodes, meters."""
HALF = CELL * (NODES - 1) / 2
"""Half the side of a course, meters."""
ENDS = 10.8
"""Distance of start and goal west and east of the center, meters."""
LEG = 4.32
"""Distance along x between two bends of a route, meters."""
STEEPEST = 1.4
"""Largest slope of a route between two bends, meters north or south per meter east."""


def winding_route(rng: np.random.Generator, sway: float) -> FloatArray:
    """Return (n, 2) x, y of a smooth way from west to east, meters.

    Args:
        rng: random generator of its bends.
        sway: most that it is north or south of the middle line, meters.
    """
    x = np.linspace(-ENDS, ENDS, round(2 * ENDS / LEG) + 1)
    y = rng.uniform(-sway, sway, len(x))
    for k in range(1, len(x)):
        y[k] = y[k - 1] + np.clip(y[k] - y[k - 1], -STEEPEST * LEG, STEEPEST * LEG)
    fine = np.linspace(0, len(x) - 1, 20 * (len(x) - 1) + 1)
    leg = np.minimum(fine.astype(np.int64), len(x) - 2)
    blend = (1 - np.cos(np.pi * (fine - leg))) / 2
    return np.column_stack((np.interp(fine, np.arange(len(x)), x), y[leg] + blend * (y[leg + 1] - y[leg])))


def distance_to_route(route: FloatArray) -> Float32Array:
    """Return (n, n) distances in meters from course nodes to a route.

    Row 0 = north; the route is a line of (n, 2) points.
    """
    pixels = np.round(np.column_stack((route[:, 0] + HALF, HALF - route[:, 1])) / CELL).astype(np.int32)
    off_route = np.ones((NODES, NODES), np.uint8)
    cv2.polylines(off_route, [pixels], isClosed=False, color=(0,))
    distance = cv2.distanceTransform(off_route, cv2.DIST_L2, cv2.DIST_MASK_5)
    return np.asarray(distance * CELL, dtype=np.float32)
