"""How well a scan fits into one particle's map, and in which direction it would fit better.

The ends of beams are compared with the means of the hits in the cells around them, as in likelihood
fields: close to a mean is likely, whatever the beam has passed before.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from lirs_wct.arrays import FloatArray
from slam_baselines.common.linalg import solve3
from slam_baselines.gmapping.patches import ABSENT, BITS, MASK, MEAN_STEPS
from slam_baselines.mapping.occupancy_map import UNKNOWN

NOTHING = 0.5
"""Loss of log-likelihood of a beam that ends where nothing is."""
EPS = 0.09
"""Variance of a wall across itself, square cells."""


class Beams(NamedTuple):
    """A scan for the kernels.

    Attributes:
        points: (n, 2 or more) ends of beams in the leveled base frame, metres.
        weights: (n,) how much each counts.
    """

    points: FloatArray
    weights: FloatArray


# Inlined with plain arrays: handing tuples of arrays on for every cell would cost more than the work.
@njit(cache=True, inline="always")
def _cell(table: Any, row0: int, col0: int, row: int, col: int) -> Any:
    """Return the patch (or ABSENT) and the cell in it at a cell of the lattice; corner at row0, col0."""
    r, c = (row >> BITS) - row0, (col >> BITS) - col0
    inside = 0 <= r < table.shape[0] and 0 <= c < table.shape[1]
    return (table[r, c] if inside else ABSENT), ((row & MASK) << BITS) | (col & MASK)


@njit(cache=True, inline="always")
def _attraction(
    table: Any,
    top: int,
    left: int,
    log_odds: Any,
    records: Any,
    mean: Any,
    min_slopes: Any,
    wall_slope: int,
    u: float,
    v: float,
    reach: int,
    narrow: float,
) -> Any:
    """Return how strongly walls attract a beam's end (u, v in cells), whereto, and by which matrix.

    The walls' cells within `reach` weigh exp(narrow d^2). The end is drawn to their weighted mean m, across
    the wall but not along it: by A = eps (S + eps I)^-1, S their weighted covariance, eps = (0.3 cells)^2.
    """
    row0, col0 = int(np.floor(v)), int(np.floor(u))
    w = su = sv = suu = suv = svv = 0.0
    for row in range(row0 - reach, row0 + reach + 1):
        for col in range(col0 - reach, col0 + reach + 1):
            p, cell = _cell(table, top, left, row, col)
            # A cell that is occupied was hit, so there is a record.
            if p != ABSENT and log_odds[p, cell] > 0 and min_slopes[records[p], cell] >= wall_slope:
                du = col + mean[records[p], cell, 0] / MEAN_STEPS - u
                dv = row + mean[records[p], cell, 1] / MEAN_STEPS - v
                a = np.exp(narrow * (du * du + dv * dv))
                w += a
                su += a * du
                sv += a * dv
                suu += a * du * du
                suv += a * du * dv
                svv += a * dv * dv
    total = max(w, 1e-30)
    du, dv = su / total, sv / total
    cuu, cuv, cvv = suu / total - du * du + EPS, suv / total - du * dv, svv / total - dv * dv + EPS
    k = EPS / (cuu * cvv - cuv * cuv)
    return w, du, dv, k * cvv, -k * cuv, k * cuu


@njit(cache=True, nogil=True)
def log_likelihood(view: Any, beams: Any, pose: Any, reach: int, lsigma: float, width: float) -> Any:
    """Return the log-likelihood of a scan, and the weights of beams that end at a wall and on known cells.

    Each beam gives -d^2 / lsigma, d metres from its end to the wall within `reach` cells, and -NOTHING
    without one. The distance is taken across the wall: taken to the nearest cell's mean, a likelihood this
    sharp would prefer poses that fall in step with the lattice.

    Args:
        view: the map.
        beams: of the scan.
        pose: (3,) x, y, yaw.
        reach: cells looked at to each side of a beam's end.
        lsigma: square metres.
        width: standard deviation of the attraction, cells.
    """
    points, weights, res, wall_slope = beams.points, beams.weights, view.resolution, view.wall_slope
    table, top, left = view.table, view.corner[0], view.corner[1]
    log_odds, records = view.patches.log_odds, view.patches.record
    mean, min_slopes = view.patches.mean, view.patches.min_slope
    c, s = np.cos(pose[2]) / res, np.sin(pose[2]) / res
    x, y = pose[0] / res, pose[1] / res
    narrow, sharp = -0.5 / width**2, res * res / lsigma
    total = hit = known = 0.0
    for i in range(len(points)):
        if weights[i] == 0:
            continue
        u, v = x + c * points[i, 0] - s * points[i, 1], y + s * points[i, 0] + c * points[i, 1]
        w, du, dv, auu, auv, avv = _attraction(
            table, top, left, log_odds, records, mean, min_slopes, wall_slope, u, v, reach, narrow
        )
        if w > 0:
            d2 = auu * du * du + 2 * auv * du * dv + avv * dv * dv
            total -= weights[i] * min(NOTHING, d2 * sharp)
            hit += weights[i]
            known += weights[i]
            continue
        total -= weights[i] * NOTHING
        p, cell = _cell(table, top, left, int(np.floor(v)), int(np.floor(u)))
        if p != ABSENT and log_odds[p, cell] != UNKNOWN:
            known += weights[i]
    return total, hit, known


@njit(cache=True, nogil=True)
def linearize(view: Any, beams: Any, stride: int, pose: Any, reach: int, width: float, H: Any, g: Any) -> Any:
    """Fill H (3, 3) and g (3,) of a Gauss-Newton step that moves the beams' ends onto the walls.

    In units of one over the variance of a beam.

    Args:
        view: the map.
        beams: of the scan.
        stride: only every so manyth beam is used.
        pose: (3,) x, y, yaw.
        reach: cells looked at to each side of a beam's end.
        width: standard deviation of the attraction, cells.
        H: filled.
        g: filled.
    """
    points, weights, res, wall_slope = beams.points, beams.weights, view.resolution, view.wall_slope
    table, top, left = view.table, view.corner[0], view.corner[1]
    log_odds, records = view.patches.log_odds, view.patches.record
    mean, min_slopes = view.patches.mean, view.patches.min_slope
    c, s = np.cos(pose[2]) / res, np.sin(pose[2]) / res
    x, y = pose[0] / res, pose[1] / res
    H[:] = 0
    g[:] = 0
    narrow = -0.5 / width**2
    for i in range(0, len(points), stride):
        if weights[i] == 0:
            continue
        pu, pv = c * points[i, 0] - s * points[i, 1], s * points[i, 0] + c * points[i, 1]
        w, du, dv, auu, auv, avv = _attraction(
            table, top, left, log_odds, records, mean, min_slopes, wall_slope, x + pu, y + pv, reach, narrow
        )
        if w < 1e-6:
            continue
        k = weights[i] * stride * min(1.0, w)
        auu, auv, avv = k * auu, k * auv, k * avv
        # du/dyaw = -pv, dv/dyaw = pu; lengths in metres from here on.
        pu, pv, du, dv = pu * res, pv * res, du * res, dv * res
        fu, fv = auu * du + auv * dv, auv * du + avv * dv
        yu, yv = auv * pu - auu * pv, avv * pu - auv * pv
        H[0, 0] += auu
        H[0, 1] += auv
        H[1, 1] += avv
        H[0, 2] += yu
        H[1, 2] += yv
        H[2, 2] += yv * pu - yu * pv
        g[0] += fu
        g[1] += fv
        g[2] += fv * pu - fu * pv
    H[1, 0], H[2, 0], H[2, 1] = H[0, 1], H[0, 2], H[1, 2]


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


@njit(cache=True, nogil=True)
def score(view: Any, beams: Any, pose: Any, tuning: Any) -> Any:
    """Return the log-likelihood of a scan at a pose."""
    spread = tuning.sigma / view.resolution
    return log_likelihood(view, beams, pose, tuning.kernelSize, tuning.lsigma, spread)[0]


@njit(cache=True, nogil=True)
def log_prior(pose: Any, prior: Any) -> Any:
    """Return the logarithm of the odometry's density at a pose, up to a constant."""
    d = _difference(pose, prior.pose)
    return -0.5 * (d @ (prior.information @ d))


@njit(cache=True, nogil=True)
def match(view: Any, beams: Any, prior: Any, start: Any, tuning: Any, H: Any) -> Any:
    """Return the (3,) pose at which the scan fits best near the start; fill H with its information.

    Gauss-Newton in two stages: few beams and a wide view, then all beams and a narrow one. The odometry
    is a prior, so that a direction in which the map says nothing follows it.
    """
    pose, g = start.copy(), np.empty(3)
    few = max(1, len(beams.points) // 90)
    reach, width = tuning.kernelSize, tuning.sigma / view.resolution
    for stage in range(2):
        wider, stride, done = (3, few, 0.01) if stage == 0 else (1, 1, 0.001)
        for _ in range(tuning.iterations):
            linearize(view, beams, stride, pose, wider * reach, wider * width, H, g)
            H /= tuning.sigma**2
            pull = prior.information @ _difference(pose, prior.pose)
            step = solve3(H + prior.information, g / tuning.sigma**2 - pull)
            pose += step * (0.2 / max(0.2, np.hypot(step[0], step[1]), 2 * abs(step[2])))
            if np.hypot(step[0], step[1]) < done and abs(step[2]) < done / 5:
                break
    return pose


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
                    best[:] = pose
    return best


@njit(cache=True, nogil=True)
def _coarse_walls(view: Any, points: Any, pose: Any, cell: float, margin: float) -> Any:
    """Return (rows, cols) 2 on walls, 1 beside them, 0 elsewhere; and row and column of the first cell.

    Covers what beams from around a pose reach.
    """
    reach = np.sqrt((points[:, 0] ** 2 + points[:, 1] ** 2).max()) + margin + 2 * cell
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
    d = pose - other
    d[2] = (d[2] + np.pi) % (2 * np.pi) - np.pi
    return d
