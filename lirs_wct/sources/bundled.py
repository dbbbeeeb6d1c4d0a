"""The three bundled worlds, similar to the paper's Fig. 12: pictures made by seeded code.

They are 16-bit pictures of 1025 x 1025 px for a square of 50 m: smooth hills with solid obstacles (boxes,
walls, pillars). They pass through the same pipeline as a user's picture.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from lirs_wct.arrays import BoolArray, ByteArray, FloatArray
from lirs_wct.errors import require_known

PIXELS = 1025
SIZE = 50.0
BORDER_DISTANCE = 1.0
"""Distance of obstacles from the border, meters; twice that from the center, where robots start."""


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """Parameters of a bundled world.

    Attributes:
        seed: seed of its random generator.
        relief: relief of the hills without obstacles, meters.
        smoothing: standard deviation of the filter that smooths the hills, meters.
        obstacles: number of obstacles on the 2,500 m2.
        gap: free space between obstacles, meters.
    """

    seed: int
    relief: float
    smoothing: float
    obstacles: int
    gap: float


RECIPES = {
    "simple": Recipe(seed=1, relief=0.5, smoothing=1.7151395415239903, obstacles=25, gap=3.0),
    "medium": Recipe(seed=2, relief=2.0, smoothing=3.627624852142082, obstacles=50, gap=2.4),
    "advanced": Recipe(seed=3, relief=5.0, smoothing=4.874656118452941, obstacles=100, gap=2.0),
}
"""Bundled worlds. 95 % of their ground slopes by at most 4, 10 and 18 deg over 1 m, from which the smoothing
was solved."""


@dataclass(frozen=True)
class BundledPicture:
    """A bundled world as a picture.

    Attributes:
        pixels: (1025, 1025) uint16, row 0 = north, 65535 = highest.
        height: meters between 0 and 65535.
        hills: (1025, 1025) float64 meters before obstacles.
    """

    pixels: NDArray[np.uint16]
    height: float
    hills: FloatArray


def bundled_picture(name: str) -> BundledPicture:
    """Make the picture of a bundled world; the same on every call."""
    require_known("bundled world", name, RECIPES)
    recipe = RECIPES[name]
    rng = np.random.default_rng(recipe.seed)
    hills = _hills(recipe, rng)
    z = _with_obstacles(hills, recipe, rng)
    z -= z.min()
    return BundledPicture(np.round(z / z.max() * 65535).astype(np.uint16), float(z.max()), hills)


def _hills(recipe: Recipe, rng: np.random.Generator) -> FloatArray:
    """Return smoothed noise of the recipe's relief, meters."""
    from scipy import ndimage  # imported here: the command line needs only the names of worlds

    coarse = 8
    spacing = coarse * SIZE / (PIXELS - 1)
    noise = rng.standard_normal((2, PIXELS // coarse + 1, PIXELS // coarse + 1))
    widths = (recipe.smoothing / spacing, recipe.smoothing / 3 / spacing)
    long, short = (_unit(ndimage.gaussian_filter(n, width)) for n, width in zip(noise, widths, strict=True))
    at = np.linspace(0, PIXELS // coarse, PIXELS)
    z: FloatArray = ndimage.map_coordinates(
        recipe.relief * _unit(long + 0.15 * short),
        np.meshgrid(at, at, indexing="ij"),
        order=3,
        mode="nearest",
    )
    return recipe.relief * _unit(z)


def _unit(z: FloatArray) -> FloatArray:
    unit: FloatArray = (z - z.min()) / (z.max() - z.min())
    return unit


def _with_obstacles(hills: FloatArray, recipe: Recipe, rng: np.random.Generator) -> FloatArray:
    """Set flat-topped solids on the hills, at least 1 m above their ground."""
    z = hills.copy()
    keep_out = np.zeros((PIXELS, PIXELS), np.uint8)
    cell = SIZE / (PIXELS - 1)
    margin = round(BORDER_DISTANCE / cell)
    cv2.circle(keep_out, (PIXELS // 2, PIXELS // 2), 2 * margin, 1, -1)
    gap = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * round(recipe.gap / cell) + 1,) * 2)
    placed = 0
    while placed < recipe.obstacles:
        outline = _outline(rng) / cell + rng.uniform(margin, PIXELS - margin, size=2)
        if outline.min() < margin or outline.max() > PIXELS - 1 - margin:
            continue
        mask, window = _fill(np.round(outline).astype(np.int32))
        if (keep_out[window] & mask).any():
            continue
        ground = hills[window][mask]
        z[window][mask] = ground.max() + rng.uniform(1.2, 2.4)
        _keep_distance(keep_out, mask, window, gap)
        placed += 1
    return z


def _fill(outline: NDArray[np.int32]) -> tuple[BoolArray, tuple[slice, slice]]:
    """Return the mask of a polygon's pixels, and its window of the picture."""
    (left, upper), (right, lower) = outline.min(axis=0) - 2, outline.max(axis=0) + 3
    mask = np.zeros((lower - upper, right - left), np.uint8)
    cv2.fillPoly(mask, [outline - (left, upper)], 1)
    # No tips of a single pixel, so that a contact grid of twice the spacing can have every corner.
    mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)).astype(np.uint8)
    return mask > 0, (slice(upper, lower), slice(left, right))


def _keep_distance(
    keep_out: ByteArray, mask: BoolArray, window: tuple[slice, slice], kernel: ByteArray
) -> None:
    """Dilate an obstacle by a kernel into the mask of ground that is taken.

    The kernel at the obstacle's rim and the obstacle itself cover what the kernel at all its pixels does.
    """
    reach = kernel.shape[0] // 2
    inner = cv2.erode(mask.astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))) > 0
    grown = np.pad(mask, reach).astype(np.uint8)
    for row, col in np.argwhere(mask & ~inner).tolist():
        grown[row : row + kernel.shape[0], col : col + kernel.shape[1]] |= kernel
    low = [s.start - reach for s in window]
    rows, cols = (
        slice(max(0, start), min(PIXELS, start + size)) for start, size in zip(low, grown.shape, strict=True)
    )
    keep_out[rows, cols] |= grown[
        rows.start - low[0] : rows.stop - low[0], cols.start - low[1] : cols.stop - low[1]
    ]


def _outline(rng: np.random.Generator) -> FloatArray:
    """Return the (n, 2) outline of a random box, wall or pillar, meters."""
    kind = rng.choice(("box", "wall", "pillar"), p=(0.45, 0.35, 0.2))
    if kind == "pillar":
        angle = np.linspace(0, math.tau, 24, endpoint=False)
        return rng.uniform(0.3, 0.8) * np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    w, h = (rng.uniform(0.8, 2.6, size=2)) if kind == "box" else (rng.uniform(3.0, 6.0), 0.35)
    corners = np.array(((-w, -h), (w, -h), (w, h), (-w, h))) / 2
    turn = rng.uniform(0, math.pi)
    c, s = math.cos(turn), math.sin(turn)
    turned: FloatArray = corners @ np.array(((c, s), (-s, c)))
    return turned
