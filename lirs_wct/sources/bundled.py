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

from lirs_wct.arrays import ByteArray, FloatArray
from lirs_wct.errors import unknown_name

PIXELS = 1025
SIZE = 50.0
MARGIN = 1.0
"""Distance of obstacles from the border, meters; twice that from the center, where robots start."""


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """Parameters of a bundled world.

    Attributes:
        seed: seed of its random generator.
        relief: relief of the hills without obstacles, meters.
        slope: 95th percentile of the hills' slope over 1 m, degrees.
        obstacles: number of obstacles on the 2,500 m2.
        gap: free space between obstacles, meters.
    """

    seed: int
    relief: float
    slope: float
    obstacles: int
    gap: float


RECIPES = {
    "simple": Recipe(seed=1, relief=0.5, slope=4.0, obstacles=25, gap=3.0),
    "medium": Recipe(seed=2, relief=2.0, slope=10.0, obstacles=50, gap=2.4),
    "advanced": Recipe(seed=3, relief=5.0, slope=18.0, obstacles=100, gap=2.0),
}


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
    """Make the picture of a bundled world; the same on every call.

    Raises:
        ConfigError: no bundled world has that name.
    """
    if name not in RECIPES:
        raise unknown_name("bundled world", name, RECIPES)
    recipe = RECIPES[name]
    rng = np.random.default_rng(recipe.seed)
    hills = _hills(recipe, rng)
    z = _with_obstacles(hills, recipe, rng)
    z -= z.min()
    return BundledPicture(np.round(z / z.max() * 65535).astype(np.uint16), float(z.max()), hills)


def slope_over(z: FloatArray, meters: float, cell: float) -> FloatArray:
    """Return slopes in degrees of heights (rows, cols) over a baseline in meters."""
    step = max(1, round(meters / cell / 2))
    dx = (z[step:-step, 2 * step :] - z[step:-step, : -2 * step]) / (2 * step * cell)
    dy = (z[2 * step :, step:-step] - z[: -2 * step, step:-step]) / (2 * step * cell)
    return np.degrees(np.arctan(np.hypot(dx, dy)))


def _hills(recipe: Recipe, rng: np.random.Generator) -> FloatArray:
    """Choose the wavelength at which the recipe's relief has the recipe's slope."""
    from scipy import ndimage, optimize  # imported here: the command line needs only the names of worlds

    coarse = 8
    spacing = coarse * SIZE / (PIXELS - 1)
    noise = rng.standard_normal((2, PIXELS // coarse + 1, PIXELS // coarse + 1))

    def terrain(sigma: float) -> FloatArray:
        long, short = (
            _unit(ndimage.gaussian_filter(n, s / spacing))
            for n, s in zip(noise, (sigma, sigma / 3), strict=True)
        )
        return recipe.relief * _unit(long + 0.15 * short)

    def excess(sigma: float) -> float:
        return float(np.percentile(slope_over(terrain(sigma), 1.0, spacing), 95)) - recipe.slope

    sigma = float(optimize.brentq(excess, 1.0, 15.0, xtol=1e-3))
    at = np.linspace(0, PIXELS // coarse, PIXELS)
    z: FloatArray = ndimage.map_coordinates(
        terrain(sigma), np.meshgrid(at, at, indexing="ij"), order=3, mode="nearest"
    )
    return recipe.relief * _unit(z)


def _unit(z: FloatArray) -> FloatArray:
    unit: FloatArray = (z - z.min()) / (z.max() - z.min())
    return unit


def _with_obstacles(hills: FloatArray, recipe: Recipe, rng: np.random.Generator) -> FloatArray:
    """Set flat-topped solids on the hills, each at least 1 m above the ground that it covers."""
    z = hills.copy()
    keep_out = np.zeros((PIXELS, PIXELS), np.uint8)
    cell = SIZE / (PIXELS - 1)
    margin = round(MARGIN / cell)
    cv2.circle(keep_out, (PIXELS // 2, PIXELS // 2), 2 * margin, 1, -1)
    gap = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * round(recipe.gap / cell) + 1,) * 2)
    placed = 0
    while placed < recipe.obstacles:
        outline = _outline(rng) / cell + rng.uniform(margin, PIXELS - margin, size=2)
        if outline.min() < margin or outline.max() > PIXELS - 1 - margin:
            continue
        mask = np.zeros_like(keep_out)
        cv2.fillPoly(mask, [np.round(outline).astype(np.int32)], 1)
        # No tips of a single pixel, so that a contact grid of twice the spacing can have every corner.
        mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)).astype(np.uint8)
        if (keep_out & mask).any():
            continue
        z[mask > 0] = hills[mask > 0].max() + rng.uniform(1.2, 2.4)
        keep_out |= _dilate(mask, gap)
        placed += 1
    return z


def _dilate(mask: ByteArray, kernel: ByteArray) -> ByteArray:
    """Dilate within the mask's neighborhood only, because obstacles are small."""
    rows, cols = np.nonzero(mask)
    r = kernel.shape[0]
    box = (
        slice(max(0, rows.min() - r), rows.max() + r + 1),
        slice(max(0, cols.min() - r), cols.max() + r + 1),
    )
    grown = np.zeros_like(mask)
    grown[box] = cv2.dilate(np.ascontiguousarray(mask[box]), kernel)
    return grown


def _outline(rng: np.random.Generator) -> FloatArray:
    """Return the (n, 2) outline of a random box, wall or pillar about its center, meters."""
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
