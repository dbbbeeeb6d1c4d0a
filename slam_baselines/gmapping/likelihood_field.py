"""How well a scan fits into one particle's map, and in which direction it would fit better.

The ends of beams are compared with the means of the hits in the cells around them, as in likelihood
fields: close to a mean is likely, whatever the beam has passed before.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lirs_wct.arrays import BoolArray, FloatArray, IntArray
from lirs_wct.kernels import njit
from slam_baselines.gmapping.patches import ABSENT, BITS, MASK, MEAN_STEPS
from slam_baselines.mapping.occupancy_map import UNKNOWN

NOTHING = 0.5
"""Loss of log-likelihood of a beam that ends where nothing is."""
EPS = 0.09
"""Variance of a wall across itself, square cells."""
WIDER = 3
"""The coarse stage of matching looks so many times as far."""


class Beams(NamedTuple):
    """A scan for the kernels.

    Attributes:
        points: (n, 2 or more) ends of beams in the leveled base frame, metres.
        weights: (n,) how much each counts.
    """

    points: FloatArray
    weights: FloatArray


class NearWalls(NamedTuple):
    """Walls around the ends of beams in one map, as last looked up: most poses tried leave them there.

    Attributes:
        reach: cells looked at to each side of a beam's end.
        cells: (n,) int64, the cell in which the beam ended; NOWHERE before the first look.
        known: (n,) whether that cell is known.
        counts: (n,) walls around it.
        means: (n, most, 2) where these were hit on average, cells east and north in the lattice.
    """

    reach: int
    cells: IntArray
    known: BoolArray
    counts: IntArray
    means: FloatArray


class Near(NamedTuple):
    """Walls around the ends of all beams, and farther around the few that the coarse stage uses."""

    fine: NearWalls
    coarse: NearWalls


NOWHERE = -(1 << 62)
"""No cell's number."""


@njit(cache=True, nogil=True)
def near_walls(beams: int, reach: int) -> Any:
    """Return room for the walls within `reach` cells around the ends of beams."""
    means, known = np.empty((beams, (2 * reach + 1) ** 2, 2)), np.empty(beams, np.bool_)
    cells, counts = np.empty(beams, np.int64), np.empty(beams, np.int64)
    cells[:] = NOWHERE
    return NearWalls(reach, cells, known, counts, means)


@njit(cache=True, nogil=True)
def near_beams(beams: Any, reach: int) -> Any:
    """Return room for what is within `reach` cells of the ends of a scan's beams."""
    n, stride = len(beams.points), coarse_stride(beams)
    return Near(near_walls(n, reach), near_walls((n + stride - 1) // stride, WIDER * reach))


@njit(cache=True, nogil=True)
def forget(near: Any) -> None:
    """Let all beams be looked up anew: another map follows."""
    near.fine.cells[:] = NOWHERE
    near.coarse.cells[:] = NOWHERE


@njit(cache=True, nogil=True)
def coarse_stride(beams: Any) -> int:
    """Return the step from one beam of the coarse stage to the next."""
    return max(1, len(beams.points) // 90)


@njit(cache=True, nogil=True)
def _find_walls(view: Any, near: Any, beam: int, row0: int, col0: int) -> None:
    """Note the walls around a cell in which a beam ends, in row order."""
    table, corner, patches, _, wall_slope = view
    reach = near.reach
    count, last = 0, col0 + reach
    near.known[beam] = False
    for row in range(row0 - reach, row0 + reach + 1):
        col = col0 - reach
        while col <= last:
            end, r, c = min(last, col | MASK) + 1, (row >> BITS) - corner[0], (col >> BITS) - corner[1]
            inside = 0 <= r < table.shape[0] and 0 <= c < table.shape[1]
            p = table[r, c] if inside else ABSENT
            if p == ABSENT:
                col = end
                continue
            q, first = patches.record[p], (row & MASK) << BITS
            if row == row0 and col <= col0 < end:
                near.known[beam] = patches.log_odds[p, first | (col0 & MASK)] != UNKNOWN
            while q != ABSENT and col < end:
                cell = first | (col & MASK)
                if patches.log_odds[p, cell] > 0 and patches.min_slope[q, cell] >= wall_slope:
                    near.means[beam, count, 0] = col + patches.mean[q, cell, 0] / MEAN_STEPS
                    near.means[beam, count, 1] = row + patches.mean[q, cell, 1] / MEAN_STEPS
                    count += 1
                col += 1
            col = end
    near.cells[beam], near.counts[beam] = (row0 << 32) + col0, count


# Inlined with plain arrays: handing tuples of arrays on for every beam would cost more than the work.
@njit(cache=True, nogil=True, inline="always")
def _attraction(means: Any, beam: int, count: int, u: float, v: float, narrow: float) -> Any:
    """Return how strongly walls attract a beam's end (u, v in cells), whereto, and by which matrix.

    The walls' cells weigh exp(narrow d^2). The end is drawn to their weighted mean m, across the wall but not
    along it: by A = eps (S + eps I)^-1, S their weighted covariance, eps = (0.3 cells)^2.
    """
    w = su = sv = suu = suv = svv = 0.0
    for k in range(count):
        du, dv = means[beam, k, 0] - u, means[beam, k, 1] - v
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
    scale = EPS / (cuu * cvv - cuv * cuv)
    return w, du, dv, scale * cvv, -scale * cuv, scale * cuu


@njit(cache=True, nogil=True)
def log_likelihood(view: Any, beams: Any, near: Any, pose: Any, lsigma: float, width: float) -> Any:
    """Return the log-likelihood of a scan, and the weights of beams that end at a wall and on known cells.

    Each beam gives -d^2 / lsigma, d metres from its end to the wall within `reach` cells, and -NOTHING
    without one. The distance is taken across the wall: taken to the nearest cell's mean, a likelihood this
    sharp would prefer poses that fall in step with the lattice.

    Args:
        view: the map.
        beams: of the scan.
        near: walls around their ends.
        pose: (3,) x, y, yaw.
        lsigma: square metres.
        width: standard deviation of the attraction, cells.
    """
    points, weights, res = beams.points, beams.weights, view.resolution
    cells, counts, means = near.cells, near.counts, near.means
    c, s = np.cos(pose[2]) / res, np.sin(pose[2]) / res
    x, y = pose[0] / res, pose[1] / res
    narrow, sharp = -0.5 / width**2, res * res / lsigma
    total = hit = known = 0.0
    for i in range(len(points)):
        if weights[i] == 0:
            continue
        u, v = x + c * points[i, 0] - s * points[i, 1], y + s * points[i, 0] + c * points[i, 1]
        row, col = int(np.floor(v)), int(np.floor(u))
        if cells[i] != (row << 32) + col:
            _find_walls(view, near, i, row, col)
        w, du, dv, auu, auv, avv = _attraction(means, i, counts[i], u, v, narrow)
        if w > 0:
            d2 = auu * du * du + 2 * auv * du * dv + avv * dv * dv
            total -= weights[i] * min(NOTHING, d2 * sharp)
            hit += weights[i]
            known += weights[i]
            continue
        total -= weights[i] * NOTHING
        if near.known[i]:
            known += weights[i]
    return total, hit, known


@njit(cache=True, nogil=True)
def linearize(view: Any, beams: Any, near: Any, stride: int, pose: Any, width: float, H: Any, g: Any) -> Any:
    """Fill H (3, 3) and g (3,) of a Gauss-Newton step that moves the beams' ends onto the walls.

    In units of one over the variance of a beam.

    Args:
        view: the map.
        beams: of the scan.
        near: walls around the ends of the beams used.
        stride: only every so manyth beam is used.
        pose: (3,) x, y, yaw.
        width: standard deviation of the attraction, cells.
        H: filled.
        g: filled.
    """
    points, weights, res = beams.points, beams.weights, view.resolution
    cells, counts, means = near.cells, near.counts, near.means
    c, s = np.cos(pose[2]) / res, np.sin(pose[2]) / res
    x, y = pose[0] / res, pose[1] / res
    H[:] = 0
    g[:] = 0
    narrow = -0.5 / width**2
    for i in range(0, len(points), stride):
        if weights[i] == 0:
            continue
        pu, pv = c * points[i, 0] - s * points[i, 1], s * points[i, 0] + c * points[i, 1]
        k, u, v = i // stride, x + pu, y + pv
        row, col = int(np.floor(v)), int(np.floor(u))
        if cells[k] != (row << 32) + col:
            _find_walls(view, near, k, row, col)
        w, du, dv, auu, auv, avv = _attraction(means, k, counts[k], u, v, narrow)
        if w < 1e-6:
            continue
        gain = weights[i] * stride * min(1.0, w)
        auu, auv, avv = gain * auu, gain * auv, gain * avv
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
