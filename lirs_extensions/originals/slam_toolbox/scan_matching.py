"""Correlative scan matching of the original: two lattices of candidates on a grid of blurred hits.

Olson 2009, "Real-time correlative scan matching", as the authors' program has it: the candidates of each
stage are tried one and all, the response is the mean of the blurred hits at the ends of the beams.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from lirs_extensions.originals.slam_toolbox.config import SlamToolboxOriginalConfig
from lirs_wct.arrays import FloatArray, IntArray, njit
from lirs_wct.geometry import LaserScan, Pose2, wrap_angle

OCCUPIED = 100
"""Value of a cell with a hit."""
EQUAL = 1e-6
"""Responses are equal up to this difference."""
PENALTY_GAIN = 0.2
"""Share of a squared distance or turn, in the variances, by which the response is lowered."""
MARGIN = 0.1
"""Candidates so far below the best response enter the covariance."""
EXPANSION, EXPANSIONS = math.radians(20), 3
"""Larger turn of each repeated match, radians, and largest number of them."""
LARGEST_VARIANCE = 500.0
"""Variance of a position without any response, square meters."""
SPACING = 0.1
"""Distance of points along a scan that decide together on which side of a wall it was seen, meters."""


class ScanNode:
    """Scan with its pose in the map.

    Attributes:
        odometry: `T_odom_base`.
        mount: `T_base_sensor`.
        ranges: (n,) all beams, infinite without return, meters.
        angles: (n,) in the sensor's frame, radians.
    """

    def __init__(self, scan: LaserScan, odometry: Pose2, config: SlamToolboxOriginalConfig) -> None:
        self.stamp, self.odometry = scan.stamp, odometry
        self.mount = scan.T_base_laser.to_pose2()
        r = scan.ranges.astype(np.float64)
        known = np.isfinite(r) & (r < config.no_return_share * scan.range_max)
        self.ranges = np.where(known, r, np.inf)
        # A LaserScan message holds float32.
        first, step = (float(np.float32(angle)) for angle in (scan.angle_min, scan.angle_increment))
        self.angles = first + step * np.arange(len(r))
        nearest = max(scan.range_min, config.min_laser_range)
        self._central = (r >= nearest) & known & (r <= config.max_laser_range)
        self._by_center = config.use_scan_barycenter
        self.pose = odometry

    @property
    def pose(self) -> Pose2:
        """Pose `T_map_base` as known now."""
        return self._pose

    @pose.setter
    def pose(self, pose: Pose2) -> None:
        self._pose = pose
        for name in ("points", "center"):
            self.__dict__.pop(name, None)

    @property
    def sensor(self) -> Pose2:
        """Pose `T_map_sensor`."""
        return self._pose @ self.mount

    def base_at(self, sensor: Pose2) -> Pose2:
        """Return `T_map_base` of a pose of the sensor."""
        return sensor @ self.mount.inverse()

    @cached_property
    def points(self) -> FloatArray:
        """(n, 2) ends of all beams in the map frame, not finite without return."""
        sensor = self.sensor
        angles = sensor.yaw + self.angles
        return np.stack(
            (sensor.x + self.ranges * np.cos(angles), sensor.y + self.ranges * np.sin(angles)), axis=-1
        )

    @cached_property
    def center(self) -> tuple[float, float]:
        """Mean of the hits in range, else the sensor's place, in the map frame."""
        sensor = self.sensor
        if not self._by_center or not self._central.any():
            return sensor.x, sensor.y
        x, y = self.points[self._central].mean(axis=0).tolist()
        return x, y

    @cached_property
    def returns(self) -> FloatArray:
        """(k, 2) ends of the beams with return in the sensor's frame."""
        known = np.isfinite(self.ranges)
        r, angles = self.ranges[known], self.angles[known]
        return np.stack((r * np.cos(angles), r * np.sin(angles)), axis=-1)


class Match(NamedTuple):
    """Sensor's pose in the map frame, its response, 0 to 1, and its covariance (3, 3)."""

    sensor: Pose2
    response: float
    covariance: FloatArray


class Lattice(NamedTuple):
    """Candidates of one stage: their offsets from `center` (n,), and their responses.

    The responses (y, x, heading) are without and with the penalty.
    """

    center: Pose2
    shifts: FloatArray
    turns: FloatArray
    raw: FloatArray
    responses: FloatArray

    @property
    def best(self) -> float:
        """Largest response."""
        return float(self.responses.max())

    @property
    def result(self) -> Pose2:
        """Mean of the candidates with the largest response."""
        rows, cols, turns = np.nonzero(self.responses >= self.best - EQUAL)
        # One after the other: a mean halfway between two cells is rounded by its last bit.
        x, y, c, s = 0.0, 0.0, 0.0, 0.0
        for row, col, turn in zip(rows, cols, turns, strict=True):
            x += self.center.x + float(self.shifts[col])
            y += self.center.y + float(self.shifts[row])
            heading = self.center.yaw + float(self.turns[turn])
            c, s = c + math.cos(heading), s + math.sin(heading)
        n = len(rows)
        return Pose2(x / n, y / n, math.atan2(s / n, c / n))

    def covariance(self, result: Pose2) -> FloatArray:
        """Return the (3, 3) covariance of x and y; that of the heading is the step's."""
        best, step = self.best, float(self.shifts[1] - self.shifts[0])
        covariance = np.diag((LARGEST_VARIANCE, LARGEST_VARIANCE, 4 * float(self.turns[1] - self.turns[0]) ** 2))
        if best < EQUAL:
            return covariance
        by_place = self.responses.max(axis=2)
        w = np.where(by_place >= best - MARGIN, by_place, 0.0)
        dx = (self.shifts - (result.x - self.center.x))[None]
        dy = (self.shifts - (result.y - self.center.y))[:, None]
        xx, xy, yy = (float((w * d).sum() / w.sum()) for d in (dx * dx, dx * dy, dy * dy))
        least = 0.1 * step**2
        covariance[:2, :2] = np.array(((max(xx, least), xy), (xy, max(yy, least)))) / best
        return covariance


class ScanMatcher:
    """Matcher of a scan with others, on a grid around the pose from which it starts."""

    def __init__(
        self, config: SlamToolboxOriginalConfig, dimension: float, resolution: float, deviation: float
    ) -> None:
        """Search a square of an edge `dimension` on cells of `resolution`; all in meters."""
        self._config, self._resolution = config, resolution
        searched = _rounded(dimension / resolution) + 1
        self._reach = 0.5 * (searched - 1) * resolution
        self._size = searched + 2 * math.ceil(config.max_laser_range / resolution)
        half = _rounded(2 * deviation / resolution)
        self._border = half + 1
        steps = np.arange(-half, half + 1) * resolution
        blur = np.exp(-0.5 * np.square(np.hypot(steps, steps[:, None]) / deviation))
        self._kernel = np.floor(OCCUPIED * blur + 0.5).astype(np.uint8)
        rows = self._size + 2 * self._border
        self._cells = np.zeros((rows, -(-rows // 8) * 8), np.uint8)
        self._corner = 0.0, 0.0

    @property
    def nbytes(self) -> int:
        """Memory of its grid."""
        return self._cells.nbytes

    def match(
        self, node: ScanNode, base: Sequence[ScanNode], start: Pose2, *, penalize: bool = False, fine: bool = True
    ) -> Match:
        """Match a node with others from a pose of its sensor.

        Args:
            penalize: Whether responses are lowered with the distance and the turn from the start.
            fine: Whether the second stage follows.
        """
        c = self._config
        self._draw(base, start)
        step, turn = 2 * self._resolution, c.coarse_search_angle_offset
        lattice = self._search(node, start, (self._reach, step), (turn, c.coarse_angle_resolution), penalize)
        for k in range(EXPANSIONS if c.use_response_expansion else 0):
            if lattice.best > EQUAL:
                break
            wider = turn + (k + 1) * EXPANSION
            lattice = self._search(
                node, start, (self._reach, step), (wider, c.coarse_angle_resolution), penalize
            )
        result = lattice.result
        covariance = lattice.covariance(result)
        if fine:
            angular = 0.5 * c.coarse_angle_resolution, c.fine_search_angle_offset
            lattice = self._search(node, result, (0.5 * step, self._resolution), angular, penalize)
            result = lattice.result
            covariance[2, 2] = self._heading_variance(node, lattice, result)
        return Match(result, min(lattice.best, 1.0), covariance)

    def _draw(self, base: Sequence[ScanNode], start: Pose2) -> None:
        """Draw the hits of nodes that are seen from their front, around a pose in the middle cell."""
        half = 0.5 * (self._size - 1) * self._resolution
        self._corner = start.x - half, start.y - half
        self._cells.fill(0)
        for node in base:
            visible = node.points[seen_from(node.points, start.x, start.y)]
            _draw_blurred(self._cells, self._kernel, visible, self._corner, 1 / self._resolution, self._size)

    def _search(
        self,
        node: ScanNode,
        center: Pose2,
        linear: tuple[float, float],
        angular: tuple[float, float],
        penalize: bool,
    ) -> Lattice:
        """Return the responses of all candidates; `linear` and `angular` are largest offset and step."""
        c, shifts, turns = self._config, _offsets(*linear), _offsets(*angular)
        raw = self._raw(node, center.x + shifts, center.y + shifts, center.yaw + turns)
        if not penalize:
            return Lattice(center, shifts, turns, raw, raw)
        square = np.square(shifts)
        away = square[:, None] + square
        near = 1 - PENALTY_GAIN * away / c.distance_variance_penalty**2
        ahead = 1 - PENALTY_GAIN * np.square(turns) / c.angle_variance_penalty**2
        factor = np.maximum(near, c.minimum_distance_penalty)[:, :, None] * np.maximum(
            ahead, c.minimum_angle_penalty
        )
        return Lattice(center, shifts, turns, raw, raw * factor)

    def _raw(self, node: ScanNode, x: FloatArray, y: FloatArray, headings: FloatArray) -> FloatArray:
        """Return responses (y, x, heading) without penalty."""
        scale, border = 1 / self._resolution, self._border
        cols, rows = (
            _rounded_all((at - corner) * scale) + border for at, corner in zip((x, y), self._corner, strict=True)
        )
        sums = np.zeros((len(headings), len(y), len(x)), np.int32)
        _sum_hits(self._cells, node.returns, headings, rows, cols, scale, sums)
        return sums.transpose(1, 2, 0) / (OCCUPIED * len(node.ranges))

    def _heading_variance(self, node: ScanNode, fine: Lattice, result: Pose2) -> float:
        """Return the variance of the heading at the result's cell, square radians."""
        headings = fine.center.yaw + fine.turns
        raw = self._raw(node, np.array((result.x,)), np.array((result.y,)), headings).ravel()
        w = np.where(raw >= fine.best - MARGIN, raw, 0.0)
        step2 = float(fine.turns[1] - fine.turns[0]) ** 2
        if w.sum() <= EQUAL:
            return 1000 * step2
        total = float((w * np.square(fine.turns - wrap_angle(result.yaw - fine.center.yaw))).sum())
        return (total if total >= EQUAL else step2) / float(w.sum())


def _rounded(value: float) -> int:
    """Round a number of at least 0, halves up."""
    return math.floor(value + 0.5)


def _rounded_all(values: FloatArray) -> IntArray:
    """Round numbers, halves away from 0."""
    rounded: IntArray = (np.sign(values) * np.floor(np.abs(values) + 0.5)).astype(np.int64)
    return rounded


def _offsets(most: float, step: float) -> FloatArray:
    """Return the offsets of a lattice; where its width is no multiple of the step, 0 is none of them."""
    offsets: FloatArray = -most + step * np.arange(_rounded(2 * most / step) + 1)
    return offsets


@njit
def seen_from(points: Any, x: float, y: float) -> Any:
    """Return which points (n, 2) of a scan show their front to a viewpoint; infinite ones count as IEEE says.

    The end of the scan after its last anchor is never used.
    """
    seen = np.zeros(len(points), np.bool_)
    anchor, since = 0, 0
    for i in range(len(points)):
        ax, ay, bx, by = points[anchor, 0], points[anchor, 1], points[i, 0], points[i, 1]
        if (ax - bx) ** 2 + (ay - by) ** 2 > SPACING * SPACING:
            if not bx * (y - ay) + by * (ax - x) + (ay * x - ax * y) < 0:
                seen[since:i] = True
            anchor = since = i
    return seen


@njit
def _draw_blurred(cells: Any, kernel: Any, points: Any, corner: Any, scale: float, size: int) -> None:
    """Raise the cells around points; a point in a cell of the largest value changes nothing."""
    half = len(kernel) // 2
    for i in range(len(points)):
        u, v = (points[i, 0] - corner[0]) * scale, (points[i, 1] - corner[1]) * scale
        if not (-0.5 < u < size - 0.5 and -0.5 < v < size - 0.5):  # infinite ones, too
            continue
        col, row = int(u + 0.5) + 1, int(v + 0.5) + 1  # first cell of the kernel's square
        if cells[row + half, col + half] == OCCUPIED:
            continue
        for j in range(len(kernel)):
            for k in range(len(kernel)):
                cells[row + j, col + k] = max(cells[row + j, col + k], kernel[j, k])


@njit
def _sum_hits(cells: Any, returns: Any, headings: Any, rows: Any, cols: Any, scale: float, sums: Any) -> None:
    """Add the cells at the ends of the beams to the sums (heading, y, x).

    Cells are tested by their number only: beyond the side of the grid begins the next row.
    """
    flat, stride = cells.ravel(), cells.shape[1]
    first, last = rows[0] * stride + cols[0], rows[-1] * stride + cols[-1]
    for k in range(len(headings)):
        c, s = math.cos(headings[k]) * scale, math.sin(headings[k]) * scale
        for i in range(len(returns)):
            x, y = returns[i]
            u, v = c * x - s * y, s * x + c * y
            offset = _nearest(v) * stride + _nearest(u)
            whole = first + offset >= 0 and last + offset < len(flat)
            for j in range(len(rows)):
                at = offset + rows[j] * stride
                for m in range(len(cols)):
                    cell = at + cols[m]
                    if whole or 0 <= cell < len(flat):
                        sums[k, j, m] += flat[cell]


@njit(inline="always")
def _nearest(value: float) -> int:
    return int(value + 0.5) if value >= 0 else int(value - 0.5)
