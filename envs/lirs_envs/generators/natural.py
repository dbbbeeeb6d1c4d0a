"""Natural ground from a seed: fractal hills, valley, dunes or plain, optional rocks."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import cv2
import numpy as np

from lirs_wct.arrays import FloatArray, njit

NODES = 257
"""Nodes along each side of a generated terrain."""
EDGE = 50.0
"""Side of a natural terrain, meters."""


def fractal(rng: np.random.Generator, hurst: float = 1.0, nodes: int = NODES) -> FloatArray:
    """Return (n, n) heights 0 to 1 of spectral synthesis (Saupe 1988). Amplitudes fall with k^-(H + 1)."""
    f = np.fft.fftfreq(nodes)
    k = np.hypot(f[:, None], f)
    k[0, 0] = np.inf
    z = np.fft.ifft2(k ** -(hurst + 1) * np.exp(2j * np.pi * rng.random(k.shape))).real
    heights: FloatArray = (z - z.min()) / np.ptp(z)
    return heights


def across(rng: np.random.Generator) -> FloatArray:
    """Return (n, n) signed distances from a random line through the center, -1.4 to 1.4."""
    u, angle = np.linspace(-1, 1, NODES), rng.uniform(0, np.pi)
    distance: FloatArray = u * np.cos(angle) + u[:, None] * np.sin(angle)
    return distance


def dunes(rng: np.random.Generator) -> FloatArray:
    """Return heights of dunes: long windward sides, short slip faces."""
    phase = (2.5 * across(rng) + 2 * fractal(rng, 1.2)) % 1
    ridge = cv2.GaussianBlur(np.where(phase < 0.7, phase / 0.7, (1 - phase) / 0.3), (0, 0), 4)
    return np.asarray(1.6 * ridge + fractal(rng, 1.2), dtype=np.float64)


def with_rocks(
    rng: np.random.Generator,
    z: FloatArray,
    count: int = 14,
    *,
    edge: float = EDGE,
    border: float = 3.0,
    radius: tuple[float, float] = (0.25, 0.8),
    height: tuple[float, float] = (0.4, 1.2),
) -> FloatArray:
    """Return heights with rocks on them, as domes with steep sides.

    Args:
        rng: Random generator of positions and sizes.
        z: (n, n) heights, meters.
        count: Number of rocks.
        edge: Side of the square, meters.
        border: Width along its sides where no rock has its middle; at least the largest radius, meters.
        radius: Least and largest radius, meters.
        height: Least and largest height, meters.
    """
    low, high = zip((border, edge - border), (border, edge - border), radius, height, strict=True)
    rocks = rng.uniform(low, high, (count, 4))
    z = np.array(z, dtype=np.float64)
    _add_rocks(z, np.linspace(0, edge, len(z)), rocks)
    return z


@njit
def _add_rocks(z: FloatArray, x: FloatArray, rocks: FloatArray) -> None:
    """Add rocks (n, 4), east, north, radius, height, to heights. The nodes are at `x` along both axes."""
    per_meter = (len(z) - 1) / x[-1]
    for east, north, wide, high in rocks:
        for i in range(int((north - wide) * per_meter), int((north + wide) * per_meter) + 2):
            for j in range(int((east - wide) * per_meter), int((east + wide) * per_meter) + 2):
                distance = math.hypot(x[j] - east, x[i] - north) / wide
                if distance < 1.0:
                    z[i, j] += high * math.sqrt(1.0 - distance**4)


NATURAL_TERRAINS: Mapping[str, Callable[[np.random.Generator], FloatArray]] = {
    "hills": lambda rng: 6 * fractal(rng),
    "rough hills": lambda rng: 5 * fractal(rng, 0.8),
    "valley": lambda rng: 7 * across(rng) ** 2 + 1.5 * fractal(rng),
    "dunes": dunes,
    "plain": lambda rng: 1.2 * fractal(rng),
    "hills with rocks": lambda rng: with_rocks(rng, 5 * fractal(rng)),
    "plain with rocks": lambda rng: with_rocks(rng, 1.2 * fractal(rng)),
}
"""Makers of (257, 257) heights in meters, 50 m square, by name."""
