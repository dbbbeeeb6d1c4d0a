"""Scan matching in one particle's map: Gauss-Newton, and a search of a wider window where that fits badly."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lirs_wct.arrays import FloatArray
from lirs_wct.kernels import njit
from slam_baselines.common.linalg import solve3
from slam_baselines.gmapping.likelihood_field import (
    NOTHING,
    WIDER,
    linearize,
    log_likelihood,
    near_beams,
)
from slam_baselines.gmapping.patches import ABSENT, BITS, MASK

SAME_PEAK = 0.05
"""Meters, and radians: peaks closer together are one.

Only the first particle is searched for in any case. A better fit of the same peak, found because it had two
attempts, would raise its weight above that of the others scan by scan.
"""


NEVER, IF_POOR, ALWAYS = 0, 1, 2
"""When find_peak searches the wider window."""


class Prior(NamedTuple):
    """The pose by odometry.

    Attributes:
        pose: (3,) x, y, yaw of `T_map_base`.
        information: (3, 3) inverse of its covariance.
    """

    pose: FloatArray
    information: FloatArray


class Tuning(NamedTuple):
    """The numbers of ProposalConfig that the kernels need, under the same names."""

    sigma: float
    kernelSize: int  # noqa: N815
    iterations: int
    lsigma: float
    lstep: float
    astep: float
    llsamplerange: float
    lasamplerange: float
    search_threshold: float
    minimumScore: float  # noqa: N815
    min_beams: int


@njit(cache=True, nogil=True, inline="always")
def score(view: Any, near: Any, pose: Any, tuning: Any) -> Any:
    """Return the log-likelihood of a scan at a pose, and the weights as of log_likelihood."""
    return log_likelihood(view, near.fine, pose, tuning.lsigma, tuning.sigma / view.resolution)


@njit(cache=True, nogil=True)
def log_prior(pose: Any, prior: Any) -> Any:
    """Return the logarithm of the odometry's density at a pose, up to a constant."""
    d = _difference(pose, prior.pose)
    return -0.5 * (d @ (prior.information @ d))


@njit(cache=True, nogil=True)
def match(view: Any, near: Any, prior: Any, start: Any, tuning: Any, H: Any) -> Any:
    """Return the (3,) pose at which the scan fits best near the start; fill H with its information.

    Gauss-Newton in two stages: few beams and a wide view, then all beams and a narrow one. The odometry
    is a prior, so that a direction in which the map says nothing follows it.
    """
    pose, g, A, variance = start.copy(), np.empty(3), np.empty((3, 3)), tuning.sigma**2
    for stage in range(2):
        walls = near.coarse if stage == 0 else near.fine
        wider, done = (WIDER, 0.01) if stage == 0 else (1, 0.001)
        width = wider * (tuning.sigma / view.resolution)
        for _ in range(tuning.iterations):
            linearize(view, walls, pose, width, H, g)
            pull = prior.information @ _difference(pose, prior.pose)
            # Not in array expressions, each of which Numba would compile as a kernel.
            for i in range(3):
                g[i] = g[i] / variance - pull[i]
                for j in range(3):
                    H[i, j] /= variance
                    A[i, j] = H[i, j] + prior.information[i, j]
            step = solve3(A, g)
            shift, turn = np.hypot(step[0], step[1]), abs(step[2])
            share = 0.2 / max(0.2, shift, 2 * turn)
            for i in range(3):
                pose[i] += step[i] * share
            if shift < done and turn < done / 5:
                break
    return pose


@njit(cache=True, nogil=True)
def find_peak(
    view: Any, beams: Any, near: Any, prior: Any, start: Any, wider: int, tuning: Any, H: Any
) -> Any:
    """Return the (3,) pose at which a scan fits best; fill H with its information.

    The wider window is searched NEVER, IF_POOR the fit near the start is, or ALWAYS, as `wider` says.

    Returns:
        The pose, the scan's log-likelihood there, weights of beams that end at a wall and on known cells,
        whether the window was searched.
    """
    peak = match(view, near, prior, start, tuning, H)
    value, hit, known = score(view, near, peak, tuning)
    poor = hit < tuning.search_threshold * known
    if known < tuning.min_beams or not (wider == ALWAYS or (wider == IF_POOR and poor)):
        return peak, value, hit, known, False
    curvature = np.empty((3, 3))
    other = match(view, near, prior, search(view, beams, prior, tuning), tuning, curvature)
    apart = other - peak
    if np.hypot(apart[0], apart[1]) < SAME_PEAK and abs(apart[2]) < SAME_PEAK:
        return peak, value, hit, known, True
    better, there, seen = score(view, near, other, tuning)
    gain = better + log_prior(other, prior) - value - log_prior(peak, prior)
    if gain > 0 and there >= tuning.search_threshold * seen:
        # Not `H[:] = curvature`: Numba would compile the message of shapes that differ.
        for i in range(3):
            for j in range(3):
                H[i, j] = curvature[i, j]
        return other, better, there, seen, True
    return peak, value, hit, known, True


@njit(cache=True, nogil=True)
def match_one(view: Any, beams: Any, expected: Any, covariance: Any, wider: int, tuning: Any) -> Any:
    """Return the (3,) pose at which a scan fits best into one map, and the weights as of log_likelihood.

    Args:
        view: the map.
        beams: of the scan.
        expected: (3,) pose by odometry.
        covariance: (3, 3) of it.
        wider: when to search a wider window; see find_peak.
        tuning: of the matching.
    """
    prior, near = Prior(expected, np.linalg.inv(covariance)), near_beams(beams, tuning.kernelSize)
    H = np.empty((3, 3))
    peak, _, hit, known, _ = find_peak(view, beams, near, prior, expected, wider, tuning, H)
    return peak, hit, known


@njit(cache=True, nogil=True)
def search(view: Any, beams: Any, prior: Any, tuning: Any) -> Any:
    """Return the (3,) pose of the best score in a window around the prior, by trying all.

    Olson 2009, "Real-time correlative scan matching": the scan is rotated once for each yaw, then shifted by
    whole cells of a coarser map, in which a miss by one cell counts half.
    """
    stride = max(1, len(beams.points) // 120)
    points, weights = beams.points[::stride], beams.weights[::stride] * stride
    n, turns = int(tuning.llsamplerange / tuning.lstep), int(tuning.lasamplerange / tuning.astep)
    cell = tuning.lstep
    walls, row0, col0 = _coarse_walls(view, points, prior.pose, cell, tuning.llsamplerange)
    rows, cols = walls.shape
    at_row, at_col = np.empty(len(points), np.int64), np.empty(len(points), np.int64)
    best, highest, pose = prior.pose.copy(), -np.inf, np.empty(3)
    for k in range(-turns, turns + 1):
        pose[2] = prior.pose[2] + k * tuning.astep
        c, s = np.cos(pose[2]), np.sin(pose[2])
        for i in range(len(points)):
            x, y = c * points[i, 0] - s * points[i, 1], s * points[i, 0] + c * points[i, 1]
            at_row[i] = int(np.floor((prior.pose[1] + y) / cell)) - row0
            at_col[i] = int(np.floor((prior.pose[0] + x) / cell)) - col0
        for dr in range(-n, n + 1):
            for dc in range(-n, n + 1):
                pose[0], pose[1] = prior.pose[0] + dc * cell, prior.pose[1] + dr * cell
                value = log_prior(pose, prior)
                for i in range(len(points)):
                    r, q = at_row[i] + dr, at_col[i] + dc
                    near = walls[r, q] if 0 <= r < rows and 0 <= q < cols else 0
                    value -= weights[i] * NOTHING * (1 - 0.5 * near)
                if value > highest:
                    highest = value
                    best[0], best[1], best[2] = pose[0], pose[1], pose[2]
    return best


@njit(cache=True, nogil=True)
def _coarse_walls(view: Any, points: Any, pose: Any, cell: float, margin: float) -> Any:
    """Return (rows, cols) 2 on walls, 1 beside them, 0 elsewhere; and row and column of the first cell.

    Covers what beams from around a pose reach.
    """
    farthest = 0.0
    for i in range(len(points)):
        farthest = max(farthest, points[i, 0] ** 2 + points[i, 1] ** 2)
    reach = np.sqrt(farthest) + margin + 2 * cell
    row0, col0 = int(np.floor((pose[1] - reach) / cell)), int(np.floor((pose[0] - reach) / cell))
    side = int(2 * reach / cell) + 2
    walls = np.zeros((side, side), np.uint8)
    table, res, patches = view.table, view.resolution, view.patches
    for r in range(table.shape[0]):
        for c in range(table.shape[1]):
            p = table[r, c]
            if p == ABSENT or patches.record[p] == ABSENT:
                continue
            record = patches.record[p]
            for k in range(1 << (2 * BITS)):
                if patches.log_odds[p, k] <= 0 or patches.min_slope[record, k] < view.wall_slope:
                    continue
                y = (((view.corner[0] + r) << BITS) + (k >> BITS) + 0.5) * res
                x = (((view.corner[1] + c) << BITS) + (k & MASK) + 0.5) * res
                row, col = int(np.floor(y / cell)) - row0, int(np.floor(x / cell)) - col0
                if 0 < row < side - 1 and 0 < col < side - 1:
                    walls[row, col] = 2
                    for i in range(row - 1, row + 2):
                        for j in range(col - 1, col + 2):
                            walls[i, j] = max(walls[i, j], 1)
    return walls, row0, col0


@njit(cache=True, nogil=True)
def moved(pose: Any, by: Any) -> Any:
    """Return pose @ by, all (3,)."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.array((pose[0] + c * by[0] - s * by[1], pose[1] + s * by[0] + c * by[1], pose[2] + by[2]))


@njit(cache=True, nogil=True)
def between(a: Any, b: Any) -> Any:
    """Return a^-1 @ b, all (3,)."""
    c, s = np.cos(a[2]), np.sin(a[2])
    dx, dy = b[0] - a[0], b[1] - a[1]
    return np.array((c * dx + s * dy, c * dy - s * dx, b[2] - a[2]))


@njit(cache=True, nogil=True)
def _difference(pose: Any, other: Any) -> Any:
    d = np.empty(3)
    for i in range(3):
        d[i] = pose[i] - other[i]
    d[2] = (d[2] + np.pi) % (2 * np.pi) - np.pi
    return d
