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
        points: (n, 2 or more) ends of beams in the leveled base frame, meters.
        weights: (n,) how much each counts.
    """

    points: FloatArray
    weights: FloatArray


class NearWalls(NamedTuple):
    """Beams that count, and the walls around their ends in one map, as last looked up.

    Most poses tried leave an end where it was or move it to a neighboring cell: what is around a cell is kept
    in one of the beam's slots, the cells of a square each in another.

    Attributes:
        reach: cells looked at to each side of a beam's end.
        side: of the square, cells: 1 or 2.
        points: (n, 2) ends of beams in the leveled base frame, meters.
        weights: (n,) how much each counts.
        ends: (n, 2) the same from the pose tried last, cells east and north in the lattice.
        slot: (n,) of each beam, in which the walls around that end are.
        pull: (n, 6) of each beam from there: its strength, its aim east and north, its matrix; see _attract.
        pairs: (m, 3) room for the walls that attract a beam: offset east and north, and weight.
        cells: (slots,) int64, the cell in which the beam ended; NOWHERE before the first look.
        known: (slots,) whether that cell is known.
        counts: (slots,) walls around it.
        means: (slots, most + 1, 2) where these were hit on average, cells east and north in the lattice.
    """

    reach: int
    side: int
    points: FloatArray
    weights: FloatArray
    ends: FloatArray
    slot: IntArray
    pull: FloatArray
    pairs: FloatArray
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
def near_walls(beams: Any, stride: int, reach: int, side: int) -> Any:
    """Return every so manyth beam that counts, with room for the walls within `reach` cells of its end."""
    every, n = (len(beams.points) + stride - 1) // stride, 0
    points, weights = np.empty((every, 2)), np.empty(every)
    for i in range(0, len(beams.points), stride):
        points[n, 0], points[n, 1] = beams.points[i, 0], beams.points[i, 1]
        weights[n] = beams.weights[i] * stride
        n += beams.weights[i] != 0
    points, weights = points[:n], weights[:n]
    slots, most = n * side * side, (2 * reach + 1) ** 2
    means, known = np.empty((slots, most + 1, 2)), np.empty(slots, np.bool_)
    cells, counts = np.empty(slots, np.int64), np.empty(slots, np.int64)
    cells[:] = NOWHERE
    ends, slot, pull, pairs = (
        np.empty((n, 2)),
        np.empty(n, np.int64),
        np.empty((n, 6)),
        np.empty((n * most, 3)),
    )
    return NearWalls(reach, side, points, weights, ends, slot, pull, pairs, cells, known, counts, means)


@njit(cache=True, nogil=True, inline="always")
def near_beams(beams: Any, reach: int) -> Any:
    """Return room for what is within `reach` cells of the ends of a scan's beams."""
    # Not plain numbers: for each literal Numba would compile near_walls once more.
    one, two = np.int64(1), np.int64(2)
    coarse = near_walls(beams, coarse_stride(beams), WIDER * reach, one)
    return Near(near_walls(beams, one, reach, two), coarse)


@njit(cache=True, nogil=True)
def forget(near: Any) -> None:
    """Let all beams be looked up anew: another map follows."""
    near.fine.cells[:] = NOWHERE
    near.coarse.cells[:] = NOWHERE


@njit(cache=True, nogil=True, inline="always")
def coarse_stride(beams: Any) -> int:
    """Return the step from one beam of the coarse stage to the next."""
    return max(1, len(beams.points) // 90)


# For all beams at once: to hand tuples of arrays on for one would cost more than to look.
@njit(cache=True, nogil=True)
def _look_up(view: Any, near: Any) -> None:
    """Note the walls around the ends of beams, in row order, where they are not noted yet."""
    table, corner, patches, _, wall_slope = view
    reach, ends, cells = near.reach, near.ends, near.cells
    for i in range(len(ends)):
        row0, col0 = int(np.floor(ends[i, 1])), int(np.floor(ends[i, 0]))
        slot = (i * near.side + (row0 & (near.side - 1))) * near.side + (col0 & (near.side - 1))
        near.slot[i] = slot
        if cells[slot] == (row0 << 32) + col0:
            continue
        count, last, known = 0, col0 + reach, False
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
                    known = patches.log_odds[p, first | (col0 & MASK)] != UNKNOWN
                # Without a branch, which could not be foreseen: what is no wall is overwritten by the next.
                for at in range(col, end if q != ABSENT else col):
                    cell = first | (at & MASK)
                    near.means[slot, count, 0] = at + patches.mean[q, cell, 0] / MEAN_STEPS
                    near.means[slot, count, 1] = row + patches.mean[q, cell, 1] / MEAN_STEPS
                    count += (patches.log_odds[p, cell] > 0) & (patches.min_slope[q, cell] >= wall_slope)
                col = end
        cells[slot], near.counts[slot], near.known[slot] = (row0 << 32) + col0, count, known


@njit(cache=True, nogil=True)
def _attract(near: Any, narrow: float) -> None:
    """Note how strongly walls attract the beams' ends, whereto, and by which matrix.

    The walls' cells weigh exp(narrow d^2). An end is drawn to their weighted mean m, across the wall but not
    along it: by A = eps (S + eps I)^-1, S their weighted covariance, eps = (0.3 cells)^2.
    """
    ends, slots, counts, means, pairs, pull = (
        near.ends, near.slot, near.counts, near.means, near.pairs, near.pull
    )  # fmt: skip
    n = 0
    for i in range(len(ends)):
        slot = slots[i]
        for k in range(counts[slot]):
            du, dv = means[slot, k, 0] - ends[i, 0], means[slot, k, 1] - ends[i, 1]
            pairs[n, 0], pairs[n, 1], pairs[n, 2] = du, dv, narrow * (du * du + dv * dv)
            n += 1
    # In a loop of its own: around the call all sums would leave the registers.
    for j in range(n):
        pairs[j, 2] = np.exp(pairs[j, 2])
    n = 0
    for i in range(len(ends)):
        w = su = sv = suu = suv = svv = 0.0
        for j in range(n, n + counts[slots[i]]):
            du, dv, a = pairs[j, 0], pairs[j, 1], pairs[j, 2]
            w += a
            su += a * du
            sv += a * dv
            suu += a * du * du
            suv += a * du * dv
            svv += a * dv * dv
        n += counts[slots[i]]
        total = max(w, 1e-30)
        du, dv = su / total, sv / total
        cuu, cuv, cvv = suu / total - du * du + EPS, suv / total - du * dv, svv / total - dv * dv + EPS
        scale = EPS / (cuu * cvv - cuv * cuv)
        pull[i, 0], pull[i, 1], pull[i, 2] = w, du, dv
        pull[i, 3], pull[i, 4], pull[i, 5] = scale * cvv, -scale * cuv, scale * cuu


@njit(cache=True, nogil=True)
def log_likelihood(view: Any, near: Any, pose: Any, lsigma: float, width: float) -> Any:
    """Return the log-likelihood of a scan, and the weights of beams that end at a wall and on known cells.

    Each beam gives -d^2 / lsigma, d meters from its end to the wall within `reach` cells, and -NOTHING
    without one. The distance is taken across the wall: taken to the nearest cell's mean, a likelihood this
    sharp would prefer poses that fall in step with the lattice.

    Args:
        view: the map.
        near: the beams and the walls around their ends.
        pose: (3,) x, y, yaw.
        lsigma: square meters.
        width: standard deviation of the attraction, cells.
    """
    res, points, weights, ends, pull = view.resolution, near.points, near.weights, near.ends, near.pull
    c, s = np.cos(pose[2]) / res, np.sin(pose[2]) / res
    x, y = pose[0] / res, pose[1] / res
    narrow, sharp = -0.5 / width**2, res * res / lsigma
    total = hit = known = 0.0
    for i in range(len(points)):
        ends[i, 0] = x + c * points[i, 0] - s * points[i, 1]
        ends[i, 1] = y + s * points[i, 0] + c * points[i, 1]
    _look_up(view, near)
    _attract(near, narrow)
    for i in range(len(points)):
        w, du, dv = pull[i, 0], pull[i, 1], pull[i, 2]
        auu, auv, avv = pull[i, 3], pull[i, 4], pull[i, 5]
        if w > 0:
            d2 = auu * du * du + 2 * auv * du * dv + avv * dv * dv
            total -= weights[i] * min(NOTHING, d2 * sharp)
            hit += weights[i]
            known += weights[i]
            continue
        total -= weights[i] * NOTHING
        if near.known[near.slot[i]]:
            known += weights[i]
    return total, hit, known


@njit(cache=True, nogil=True)
def linearize(view: Any, near: Any, pose: Any, width: float, H: Any, g: Any) -> Any:
    """Fill H (3, 3) and g (3,) of a Gauss-Newton step that moves the beams' ends onto the walls.

    In units of one over the variance of a beam.

    Args:
        view: the map.
        near: the beams and the walls around their ends.
        pose: (3,) x, y, yaw.
        width: standard deviation of the attraction, cells.
        H: filled.
        g: filled.
    """
    res, points, weights, ends, pull = view.resolution, near.points, near.weights, near.ends, near.pull
    c, s = np.cos(pose[2]) / res, np.sin(pose[2]) / res
    x, y = pose[0] / res, pose[1] / res
    H[:] = 0
    g[:] = 0
    for i in range(len(points)):
        ends[i, 0] = x + (c * points[i, 0] - s * points[i, 1])
        ends[i, 1] = y + (s * points[i, 0] + c * points[i, 1])
    _look_up(view, near)
    _attract(near, -0.5 / width**2)
    for i in range(len(points)):
        w, du, dv = pull[i, 0], pull[i, 1], pull[i, 2]
        auu, auv, avv = pull[i, 3], pull[i, 4], pull[i, 5]
        if w < 1e-6:
            continue
        pu, pv = c * points[i, 0] - s * points[i, 1], s * points[i, 0] + c * points[i, 1]
        gain = weights[i] * min(1.0, w)
        auu, auv, avv = gain * auu, gain * auv, gain * avv
        # du/dyaw = -pv, dv/dyaw = pu; lengths in meters from here on.
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
