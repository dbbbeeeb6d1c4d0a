"""The map of a drive from above, with both paths in it, as a picture for a page."""

from __future__ import annotations

import math

import cv2
import numpy as np

from lirs_validation.gui.session.playback import BLACK, UNKNOWN, Moment
from lirs_wct.arrays import ByteArray, FloatArray
from lirs_wct.drawing.style import BLUE, VERMILLION, rgb
from lirs_wct.geometry.pose import Pose2

SIDE = 480
"""Pixels of the longer side."""
MARGIN = 1.0
"""Meters around the map."""


def map_picture(moment: Moment) -> ByteArray:
    """Return (rows, cols, 3) RGB: the map north up, the true path blue, the estimated one vermillion."""
    found = moment.map
    if found is None or not found.known:
        return np.full((SIDE, SIDE, 3), UNKNOWN, np.uint8)
    rows, cols = found.shape
    corners = found.origin.apply(
        [(x * cols * found.resolution, y * rows * found.resolution) for x in (0, 1) for y in (0, 1)]
    )
    low, high = corners.min(axis=0) - MARGIN, corners.max(axis=0) + MARGIN
    scale = SIDE / float((high - low).max())
    width, height = (math.ceil(side * scale) for side in (high - low).tolist())
    picture = _drawn(found.pixels, found.origin, found.resolution, low, scale, (width, height))
    walls = _pixels(found.walls, low, scale, height)  # thinner than a pixel, and yet what matters
    picture[np.clip(walls[:, 1], 0, height - 1), np.clip(walls[:, 0], 0, width - 1)] = BLACK
    for path, color in ((moment.truth[:, :2], BLUE), (moment.estimate, VERMILLION)):
        points = _pixels(path, low, scale, height)
        cv2.polylines(picture, [points], False, [int(255 * v) for v in rgb(color)], 2, cv2.LINE_AA)
    return picture


def _drawn(
    pixels: ByteArray, origin: Pose2, resolution: float, low: FloatArray, scale: float, size: tuple[int, int]
) -> ByteArray:
    """Return the cells, turned as the map lies in the world, in a picture of a size."""
    width, height = size
    c, s = math.cos(origin.yaw) * resolution * scale, math.sin(origin.yaw) * resolution * scale
    x, y = (origin.x - low[0]) * scale, (origin.y - low[1]) * scale
    onto = np.array(((c, -s, x), (-s, -c, height - 1 - y)))
    drawn = cv2.warpAffine(
        pixels,
        onto,
        (width, height),
        flags=cv2.INTER_NEAREST,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=UNKNOWN,
    )
    return np.repeat(drawn[..., None], 3, axis=-1).astype(np.uint8)


def _pixels(
    path: FloatArray, low: FloatArray, scale: float, height: int
) -> np.ndarray[tuple[int, ...], np.dtype[np.int32]]:
    at = (path - low) * scale
    return np.stack((at[:, 0], height - 1 - at[:, 1]), axis=-1).round().astype(np.int32)
