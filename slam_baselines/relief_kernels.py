"""Kernels of the relief: the ceiling of the ground, and what rises above it.

`frame` is (3,): lattice row and column of the ceiling's cell (0, 0), resolution in metres; `near` and
`far` are the errors of a beam's height at the robot and per metre of range.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True)
def lower(ceiling, frame, origin, ends, with_end, near, far):  # type: ignore[no-untyped-def]
    """Lower the ceiling along beams to their height plus near + far * range."""
    res = frame[2]
    x, y = origin[0] / res - frame[1], origin[1] / res - frame[0]
    for i in range(len(ends)):
        dx, dy, dz = ends[i, 0] / res - frame[1] - x, ends[i, 1] / res - frame[0] - y, ends[i, 2] - origin[2]
        length = np.sqrt((dx * res) ** 2 + (dy * res) ** 2 + dz * dz)
        steps = int(max(abs(dx), abs(dy))) + 1
        dx, dy, rise, loose = dx / steps, dy / steps, dz / steps, far * length / steps
        for k in range(steps + 1 if with_end else steps):
            z = np.float32(origin[2] + k * rise + near + k * loose)
            row, col = int(y + k * dy), int(x + k * dx)
            if z < ceiling[row, col]:
                ceiling[row, col] = z


@njit(cache=True)
def stand(ceiling, frame, ground, footprint, old):  # type: ignore[no-untyped-def]
    """The robot stands here: the ground is where its wheels are."""
    reach = int(footprint / frame[2])
    row0, col0 = int(ground[1] / frame[2] - frame[0]), int(ground[0] / frame[2] - frame[1])
    for row in range(row0 - reach, row0 + reach + 1):
        for col in range(col0 - reach, col0 + reach + 1):
            ceiling[row, col] = min(ceiling[row, col], np.float32(ground[2] - old))


@njit(cache=True)
def steepness(ceiling, frame, origin, hits, ground, bounds, offsets, step, steep):  # type: ignore[no-untyped-def]
    """Fill `steep` with the largest proven rise over run towards each hit."""
    old, near, far = bounds
    res = frame[2]
    rows, cols = ceiling.shape
    for i in range(len(hits)):
        x, y, z = hits[i]
        reach = np.sqrt((x - origin[0]) ** 2 + (y - origin[1]) ** 2 + (z - origin[2]) ** 2)
        z -= near + far * reach
        best = (z - ground[2]) / (np.hypot(x - ground[0], y - ground[1]) + res)
        z -= old
        row, col = int(np.floor(y / res - frame[0])), int(np.floor(x / res - frame[1]))
        for k in range(len(offsets)):
            r, c = row + int(offsets[k, 0]), col + int(offsets[k, 1])
            if r < 0 or c < 0 or r >= rows or c >= cols:
                continue
            best = max(best, (z - ceiling[r, c]) / (offsets[k, 2] + res))
        steep[i] = np.uint8(min(max(best / step, 0.0), 255.0))
