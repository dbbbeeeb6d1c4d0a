"""Camera poses that show a whole scene."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from lirs_wct.arrays import FloatArray

AZIMUTH, ELEVATION = math.radians(62), math.radians(-35)
"""Viewing direction of an overview: towards the north-north-east, and down."""
DISTANCE_FACTOR = 1.05
"""Camera distance, as a multiple of the least one that shows the whole box."""


@dataclass(frozen=True, slots=True)
class Viewpoint:
    """Position and viewing direction of a camera.

    Attributes:
        position: x, y, z, meters.
        yaw: angle of the viewing direction from the x axis, radians.
        pitch: angle of the viewing direction below the horizon, radians.
    """

    position: tuple[float, float, float]
    yaw: float
    pitch: float

    @property
    def axes(self) -> FloatArray:
        """(3, 3) rows: forward, right, up in the world."""
        return camera_axes(self.yaw, self.pitch)


def camera_axes(yaw: float, pitch: float) -> FloatArray:
    """Return (3, 3) rows forward, right, up of a camera; pitch is downward."""
    cy, sy, cp, sp = math.cos(yaw), math.sin(yaw), math.cos(pitch), math.sin(pitch)
    return np.array(((cp * cy, cp * sy, -sp), (sy, -cy, 0.0), (sp * cy, sp * sy, cp)))


def overview(low: ArrayLike, high: ArrayLike, fovy: float, aspect: float = 4 / 3) -> Viewpoint:
    """Return a viewpoint outside a box that shows the whole box.

    Args:
        low: (3,) lowest corner, meters.
        high: (3,) highest corner.
        fovy: the picture's angle from its lower to its upper edge, radians.
        aspect: Width of the picture over its height.
    """
    ends = np.array((low, high), np.float64)
    corners = np.array([ends[list(which), range(3)] for which in product((0, 1), repeat=3)])
    middle = corners.mean(axis=0)
    ahead, right, up = ((corners - middle) @ axis for axis in camera_axes(AZIMUTH, -ELEVATION))
    half = math.tan(fovy / 2)
    least = np.maximum(np.abs(right) / (half * aspect), np.abs(up) / half) - ahead
    eye = middle - camera_axes(AZIMUTH, -ELEVATION)[0] * float(least.max()) * DISTANCE_FACTOR
    return Viewpoint((float(eye[0]), float(eye[1]), float(eye[2])), AZIMUTH, -ELEVATION)
