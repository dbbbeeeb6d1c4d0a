"""Correlative scan matching of the original on a grid of blurred hits.

Olson 2009, as the program has it: the candidates of two lattices are tried one and all; the response is the
mean of the blurred hits at the ends of the beams.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from lirs_extensions.originals.slam_toolbox.config import SlamToolboxOriginalConfig
from lirs_wct.geometry import FloatArray, LaserScan, Pose2, njit, wrap_angle

OCCUPIED = 100
"""Value of a cell with a hit."""
EQUAL = 1e-6
"""Responses are equal up to this difference."""
PENALTY_GAIN = 0.2
"""Share of a squared distance or turn, in the variances, by which the response is lowered."""
COVARIANCE_MARGIN = 0.1
"""Candidates so far below the best response enter the covariance."""
EXPANSION, EXPANSIONS = math.radians(20), 3
"""Larger turn of each repeated match, radians, and largest number of them."""
LARGEST_VARIANCE = 500.0
"""Variance of a position without any response, square meters."""
MOST_CORRELATION = 1 - 1e-6
"""Largest correlation of x and y, so that a line of candidates has an information."""
SPACING = 0.1
"""Distance of points along a scan that decide together on which side of a wall it was seen, meters."""


class ScanNode:
    """Scan at its place in the map.

    Attributes:
        odometry: `T_odom_base`.
        ranges: (n,) all beams, infinite without return, meters.
        returns: (k, 2) ends of the beams with return in the sensor's frame.
        pose: `T_map_base` as known now, and `sensor` is `T_map_sensor`.
        points: (n, 2) ends of all beams in the map frame, not finite without return.
        center: Mean of the hits in range, else the sensor's place, in the map frame.
    """

    def __init__(self, scan: LaserScan, odometry: Pose2, config: SlamToolboxOriginalConfig) -> None:
        self.stamp, self.odometry, self.mount = scan.stamp, odometry, scan.T_base_laser.to_pose2()
        r = scan.ranges.astype(np.float64)
        # In float32, as the ranges: in a log with millimeters some are equal to the limit.
        known = np.isfinite(r) & (scan.ranges < np.float32(config.no_return_share * scan.range_max))
        self.ranges = np.where(known, r, np.inf)
        # A LaserScan message holds float32.
        first, step = (float(np.float32(angle)) for angle in (scan.angle_min, scan.angle_increment))
        self._angles = first + step * np.arange(len(r))
        x, y = r[known] * np.cos(self._angles[known]), r[known] * np.sin(self._angles[known])
        self.returns = np.stack((x, y), axis=-1)
        nearest = max(scan.range_min, config.min_laser_range)
        self._central = known & (r >= nearest) & (r <= config.max_laser_range) & config.use_scan_barycenter
        self.place(odometry)

    def place(self, pose: Pose2) -> None:
        """Set the pose `T_map_base`."""
        self.pose, self.sensor = pose, pose @ self.mount
        x, y, angles = self.sensor.x, self.sensor.y, self.sensor.yaw + self._angles
        with np.errstate(invalid="ignore"):  # infinity times 0
            rays = self.ranges * np.cos(angles), self.ranges * np.sin(angles)
        self.points = np.stack((x + rays[0], y + rays[1]), axis=-1)
        self.center: tuple[float, float] = x, y
        if self._central.any():
            self.center = tuple(self.points[self._central].mean(axis=0).tolist())

    def base_at(self, sensor: Pose2) -> Pose2:
        """Return `T_map_base` of a pose of the sensor."""
        return sensor @ self.mount.inverse()


class SensorMatch(NamedTuple):
    """Sensor's pose in the map frame, response (0 to 1), and covariance (3, 3)."""

    sensor: Pose2
    response: float
    covariance: FloatArray


class Lattice(NamedTuple):
    """Candidates of one stage: offsets from a center (n,), and responses (y, x, heading)."""

    center: Pose2
    shifts: FloatArray
    turns: FloatArray
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
        """Return the covariance (3, 3); the heading's variance is that of the step."""
        best, (step, turn) = self.best, (float(each[1] - each[0]) for each in (self.shifts, self.turns))
        covariance = np.diag((LARGEST_VARIANCE, LARGEST_VARIANCE, 4 * turn**2))
        if best < EQUAL:
            return covariance
        by_place = self.responses.max(axis=2)
        w = np.where(by_place >= best - COVARIANCE_MARGIN, by_place, 0.0)
        dx = (self.shifts - (result.x - self.center.x))[None]
        dy = (self.shifts - (result.y - self.center.y))[:, None]
        xx, xy, yy = (float((w * d).sum() / w.sum()) for d in (dx * dx, dx * dy, dy * dy))
        xx, yy = max(xx, 0.1 * step**2), max(yy, 0.1 * step**2)
        most = MOST_CORRELATION * math.sqrt(xx * yy)
        xy = min(max(xy, -most), most)
        covariance[:2, :2] = np.array(((xx, xy), (xy, yy))) / best
        return covariance


class CorrelativeMatcher:
    """Matcher of a scan with others, on a grid around the start."""

    def __init__(self, config: SlamToolboxOriginalConfig, grid: str) -> None:
        """Take the parameters `{grid}_search_space_*`."""
        names = (f"{grid}_search_space_{name}" for name in ("dimension", "resolution", "smear_deviation"))
        dimension, resolution, deviation = (getattr(config, name) for name in names)
        self._config, self._resolution = config, resolution
        searched = int(dimension / resolution + 1.5)
        self._reach = 0.5 * (searched - 1) * resolution
        self._size = searched + 2 * math.ceil(config.max_laser_range / resolution)
        half = int(2 * deviation / resolution + 0.5)
        self._border = half + 1
        steps = np.arange(-half, half + 1) * resolution
        blur = np.exp(-0.5 * np.square(np.hypot(steps, steps[:, None]) / deviation))
        self._kernel = np.floor(OCCUPIED * blur + 0.5).astype(np.uint8)
        rows = self._size + 2 * self._border
        self.cells = np.zeros((rows, -(-rows // 8) * 8), np.uint8)
        self._corner = 0.0, 0.0

    def match(
        self, node: ScanNode, base: list[ScanNode], start: Pose2, *, penalize: bool = False, fine: bool = True
    ) -> SensorMatch:
        """Match a node with others, from a pose of its sensor."""
        c, step = self._config, 2 * self._resolution
        self._draw(base, start)
        for k in range(1 + EXPANSIONS * c.use_response_expansion):
            turns = _offsets(c.coarse_search_angle_offset + k * EXPANSION, c.coarse_angle_resolution)
            lattice = self._search(node, start, _offsets(self._reach, step), turns, penalize)
            if lattice.best > EQUAL:
                break
        result = lattice.result
        covariance = lattice.covariance(result)
        if fine:
            turns = _offsets(0.5 * c.coarse_angle_resolution, c.fine_search_angle_offset)
            lattice = self._search(node, result, _offsets(0.5 * step, self._resolution), turns, penalize)
            result = lattice.result
            covariance[2, 2] = self._heading_variance(node, lattice, result)
        return SensorMatch(result, min(lattice.best, 1.0), covariance)

    def _draw(self, base: list[ScanNode], start: Pose2) -> None:
        """Draw the hits that are seen from their front, around a pose in the middle cell."""
        half = 0.5 * (self._size - 1) * self._resolution
        self._corner = start.x - half, start.y - half
        self.cells.fill(0)
        for node in base:
            visible = node.points[seen_from(node.points, start.x, start.y)]
            _draw_blurred(self.cells, self._kernel, visible, self._corner, 1 / self._resolution, self._size)

    def _search(
        self, node: ScanNode, center: Pose2, shifts: FloatArray, turns: FloatArray, penalize: bool
    ) -> Lattice:
        """Return the responses of all candidates around a pose."""
        c = self._config
        raw = self._raw(node, center.x + shifts, center.y + shifts, center.yaw + turns)
        if not penalize:
            return Lattice(center, shifts, turns, raw)
        square = np.square(shifts)
        away = square[:, None] + square
        near = 1 - PENALTY_GAIN * away / c.distance_variance_penalty**2
        ahead = 1 - PENALTY_GAIN * np.square(turns) / c.angle_variance_penalty**2
        factor = np.maximum(near, c.minimum_distance_penalty)[:, :, None]
        factor = factor * np.maximum(ahead, c.minimum_angle_penalty)
        return Lattice(center, shifts, turns, raw * factor)

    def _raw(self, node: ScanNode, x: FloatArray, y: FloatArray, headings: FloatArray) -> FloatArray:
        """Return responses (y, x, heading) without penalty."""
        scale, border = 1 / self._resolution, self._border
        cols = np.floor((x - self._corner[0]) * scale + 0.5).astype(np.int64) + border
        rows = np.floor((y - self._corner[1]) * scale + 0.5).astype(np.int64) + border
        sums = np.zeros((len(headings), len(y), len(x)), np.int32)
        _sum_hits(self.cells, node.returns, headings, rows, cols, scale, sums)
        responses: FloatArray = sums.transpose(1, 2, 0) / (OCCUPIED * max(1, len(node.ranges)))
        return responses

    def _heading_variance(self, node: ScanNode, fine: Lattice, result: Pose2) -> float:
        """Return the variance of the heading at the result's cell, square radians."""
        headings = fine.center.yaw + fine.turns
        raw = self._raw(node, np.array((result.x,)), np.array((result.y,)), headings).ravel()
        w = np.where(raw >= fine.best - COVARIANCE_MARGIN, raw, 0.0)
        step2 = float(fine.turns[1] - fine.turns[0]) ** 2
        if w.sum() <= EQUAL:
            return 1000 * step2
        total = float((w * np.square(fine.turns - wrap_angle(result.yaw - fine.center.yaw))).sum())
        return (total if total >= EQUAL else step2) / float(w.sum())


def _offsets(most: float, step: float) -> FloatArray:
    """Return the offsets of a lattice; 0 need not be among them."""
    offsets: FloatArray = -most + step * np.arange(int(2 * most / step + 1.5), dtype=np.float64)
    return offsets


@njit
def seen_from(points: Any, x: float, y: float) -> Any:
    """Return which points (n, 2) of a scan show their front to a viewpoint.

    Infinite points follow IEEE arithmetic; points after the last anchor are never shown.
    """
    seen = np.zeros(len(points), np.bool_)
    anchor, since = 0, 0
    for i in range(len(points)):
        ax, ay, bx, by = points[anchor, 0], points[anchor, 1], points[i, 0], points[i, 1]
        if math.isnan(ax) or math.isnan(ay):  # a NaN point cannot be the anchor
            anchor = i
        if (ax - bx) ** 2 + (ay - by) ** 2 > SPACING * SPACING:
            if not bx * (y - ay) + by * (ax - x) + (ay * x - ax * y) < 0:
                seen[since:i] = True
            anchor = since = i
    return seen


@njit
def _draw_blurred(cells: Any, kernel: Any, points: Any, corner: Any, scale: float, size: int) -> None:
    """Raise the cells around points, unless a point's cell is full."""
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
                    if whole or 0 <= at + cols[m] < len(flat):
                        sums[k, j, m] += flat[np.uintp(at + cols[m])]


@njit(inline="always")
def _nearest(value: float) -> int:
    return int(value + 0.5) if value >= 0 else int(value - 0.5)
