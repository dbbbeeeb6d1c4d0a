"""Scan matching in one particle's map: likelihood field, Gauss-Newton, wider search.

The likelihood field compares the ends of beams with the means of the hits in the cells around them. An end
close to a mean is likely, whatever the beam has passed before.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lirs_wct.arrays import BoolArray, FloatArray, IntArray, njit
from slam_baselines.gmapping.patches import ABSENT, BITS, MASK, MEAN_STEPS
from slam_baselines.occupancy_map import UNKNOWN
from slam_baselines.registration import solve3

SAME_PEAK = 0.05
"""Meters, and radians: peaks closer together are one.

Only the first particle is searched for in any case. A better fit of the same peak, found because it had two
attempts, would raise its weight above that of the others scan by scan.
"""


NEVER, IF_POOR, ALWAYS = 0, 1, 2
"""When find_peak searches the wider window."""


class OdometryPrior(NamedTuple):
    """Pose (3,) `T_map_base` by odometry, and its information (3, 3)."""

    pose: FloatArray
    information: FloatArray


class Tuning(NamedTuple):
    """The numbers of GmappingConfig that the kernels need, under the same names."""

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


@njit(inline="always")
def score(view: Any, near: Any, pose: Any, tuning: Any) -> Any:
    """Return the log-likelihood of a scan at a pose, and the weights as of log_likelihood."""
    return log_likelihood(view, near.fine, pose, tuning.lsigma, tuning.sigma / view.resolution)


@njit
def pose_difference(pose: Any, other: Any) -> Any:
    """Return a pose (3,) less another, the heading in [-pi, pi)."""
    d = np.empty(3)
    for i in range(3):
        d[i] = pose[i] - other[i]
    d[2] = (d[2] + np.pi) % (2 * np.pi) - np.pi
    return d


@njit
def log_prior(pose: Any, prior: Any) -> Any:
    """Return the logarithm of the odometry's density at a pose, up to a constant."""
    d = pose_difference(pose, prior.pose)
    return -0.5 * (d @ (prior.information @ d))


@njit
def match(view: Any, near: Any, prior: Any, start: Any, tuning: Any, H: Any) -> Any:
    """Return the best (3,) pose near the start; fill H with its information.

    Gauss-Newton in two stages: few beams and a wide view, then all beams and a narrow one. The odometry
    is a prior for directions that the map does not constrain.
    """
    pose, g, A, variance = start.copy(), np.empty(3), np.empty((3, 3)), tuning.sigma**2
    for stage in range(2):
        walls = near.coarse if stage == 0 else near.fine
        wider, done = (WIDER, 0.01) if stage == 0 else (1, 0.001)
        width = wider * (tuning.sigma / view.resolution)
        for _ in range(tuning.iterations):
            linearize(view, walls, pose, width, H, g)
            pull = prior.information @ pose_difference(pose, prior.pose)
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


@njit
def find_peak(
    view: Any, beams: Any, near: Any, prior: Any, start: Any, wider: int, tuning: Any, H: Any
) -> Any:
    """Return the best (3,) pose of a scan; fill H with its information.

    The wider window is searched NEVER, IF_POOR the fit near the start is, or ALWAYS, as `wider` says. Also
    returns the scan's log-likelihood there, weights of beams that end at a wall and on known cells, and
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


@njit
def match_one(view: Any, beams: Any, expected: Any, covariance: Any, wider: int, tuning: Any) -> Any:
    """Return the best (3,) pose of a scan in one map, and log_likelihood's weights."""
    prior, near = OdometryPrior(expected, np.linalg.inv(covariance)), near_beams(beams, tuning.kernelSize)
    H = np.empty((3, 3))
    peak, _, hit, known, _ = find_peak(view, beams, near, prior, expected, wider, tuning, H)
    return peak, hit, known


@njit
def search(view: Any, beams: Any, prior: Any, tuning: Any) -> Any:
    """Return the best (3,) pose in a window around the prior, by exhaustive search.

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


@njit
def _coarse_walls(view: Any, points: Any, pose: Any, cell: float, margin: float) -> Any:
    """Return a coarse map (rows, cols) of walls, and its first cell's row and column.

    Cells are 2 on walls, 1 next to them, 0 elsewhere. The map covers the reach of beams around a pose.
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


NOTHING = 0.5
"""Loss of log-likelihood of a beam that ends without a wall nearby."""
EPS = 0.09
"""Variance of a wall across itself, square cells."""
WIDER = 3
"""Ratio of the coarse stage's reach to the fine stage's."""


class ScanBeams(NamedTuple):
    """Ends of beams (n, 2 or more), leveled base frame, meters, and weights (n,)."""

    points: FloatArray
    weights: FloatArray


class NearWalls(NamedTuple):
    """Weighted beams and the walls around their ends in one map, as last looked up.

    Most tried poses leave an end in its cell or move it to a neighboring one. So each beam has one slot for
    each cell of a square, which caches the walls around that cell.

    Attributes:
        reach: Cells looked at to each side of a beam's end.
        side: Edge of the square, cells: 1 or 2.
        points: (n, 2) ends of beams in the leveled base frame, meters.
        weights: (n,) of the beams.
        ends: (n, 2) the same from the pose tried last, cells east and north in the lattice.
        slot: (n,) of each beam, with the walls around its end.
        pull: (n, 6) of each beam: strength, offset east and north, matrix; see _attract.
        pairs: (m, 3) scratch for the walls that attract a beam: offset east and north, and weight.
        cells: (slots,) int64, the cell in which the beam ended; NOWHERE before the first lookup.
        known: (slots,) whether that cell is known.
        counts: (slots,) walls around it.
        means: (slots, most + 1, 2) mean of the hits in each, cells east and north in the lattice.
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
    """Walls around the ends of all beams, and in a wider area for coarse beams."""

    fine: NearWalls
    coarse: NearWalls


NOWHERE = -(1 << 62)
"""Number of an invalid cell."""


@njit
def near_walls(beams: Any, stride: int, reach: int, side: int) -> Any:
    """Return every `stride`-th weighted beam, with space for walls within `reach` cells."""
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


@njit(inline="always")
def near_beams(beams: Any, reach: int) -> Any:
    """Return the beams of both stages, with space for walls within `reach` cells."""
    # Not plain numbers: for each literal Numba would compile near_walls once more.
    one, two = np.int64(1), np.int64(2)
    coarse = near_walls(beams, coarse_stride(beams), WIDER * reach, one)
    return Near(near_walls(beams, one, reach, two), coarse)


@njit
def invalidate(near: Any) -> None:
    """Invalidate the looked-up walls, since another map follows."""
    near.fine.cells[:] = NOWHERE
    near.coarse.cells[:] = NOWHERE


@njit(inline="always")
def coarse_stride(beams: Any) -> int:
    """Return the step from one beam of the coarse stage to the next."""
    return max(1, len(beams.points) // 90)


# For all beams at once: to hand tuples of arrays on for one would cost more than to look.
@njit
def _look_up(view: Any, near: Any) -> None:
    """Look up the walls around the beams' ends, in row order, unless they are cached."""
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
                # Without an unpredictable branch: a cell that is no wall is overwritten by the next.
                for at in range(col, end if q != ABSENT else col):
                    cell = first | (at & MASK)
                    near.means[slot, count, 0] = at + patches.mean[q, cell, 0] / MEAN_STEPS
                    near.means[slot, count, 1] = row + patches.mean[q, cell, 1] / MEAN_STEPS
                    count += (patches.log_odds[p, cell] > 0) & (patches.min_slope[q, cell] >= wall_slope)
                col = end
        cells[slot], near.counts[slot], near.known[slot] = (row0 << 32) + col0, count, known


@njit
def _attract(near: Any, narrow: float) -> None:
    """Compute the attraction of the beams' ends by walls: strength, offset, matrix.

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


@njit
def log_likelihood(view: Any, near: Any, pose: Any, lsigma: float, width: float) -> Any:
    """Return a scan's log-likelihood, and the weights of beams at walls and on known cells.

    Each beam gives -d^2 / lsigma, d meters from its end to the wall within `reach` cells, and -NOTHING
    without one. The distance is taken across the wall: taken to the nearest cell's mean, a likelihood this
    sharp would prefer poses that fall in step with the lattice. `lsigma` is in square meters, `width` the
    standard deviation of the attraction in cells.
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


@njit
def linearize(view: Any, near: Any, pose: Any, width: float, H: Any, g: Any) -> Any:
    """Fill H (3, 3) and g (3,) of a Gauss-Newton step toward the walls.

    In units of one over the variance of a beam.
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
