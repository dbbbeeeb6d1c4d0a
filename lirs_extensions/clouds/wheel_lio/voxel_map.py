"""Local map of planes and vertical lines in voxels of three sizes.

A lidar with rings sees the ground in lines far apart. A plane comes from the smallest voxel around a point
whose points determine it: near the robot a small one, farther away a larger one.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lirs_wct.arrays import FloatArray, IntArray, njit

LEVELS = 3
"""Sizes of voxels; the edge of each is twice that of the one before."""
START = 1 << 15
"""Slots of a new table."""
FILLED = 0.5
"""Largest share of used slots."""
MIN_BACK_DISTANCE = 0.05
"""Least distance of a sensor behind a plane at which it sees another surface, meters."""
CHUNK = 2048
"""Points that are added together; the table must have free slots for all of them."""
EMPTY = -1
VARIANCE, FITTED = 6, 7
"""Columns of the planes after normal (3) and point (3): variance across (0 = no plane), and the number of
points when it was fitted."""


class Table(NamedTuple):
    """Hash table of voxels with open addressing.

    Attributes:
        keys: (slots,) of the voxels, EMPTY in a free slot.
        sums: (slots, 10) number of points, sums of x, y, z, xx, xy, xz, yy, yz, zz from the voxel's center.
        planes: (slots, 8), map frame, meters; normals point to the side that was seen.
    """

    keys: IntArray
    sums: FloatArray
    planes: FloatArray


class PlaneRule(NamedTuple):
    """Conditions under which the points of a voxel determine a plane.

    Attributes:
        points: least number of points.
        full: number of points at which a voxel takes no more: the first poses are the most accurate ones.
        thickness: largest standard deviation across the plane, by the voxel's edge.
        width: least standard deviation along the narrow side of the points, by the voxel's edge.
        normal: largest standard deviation of the normal, radians.
    """

    points: float = 10
    full: float = 2000
    thickness: float = 0.15
    width: float = 0.12
    normal: float = 0.02


class LineRule(NamedTuple):
    """Conditions under which the points of a voxel determine a vertical line.

    Attributes:
        points: least number of points.
        full: number of points at which a voxel takes no more.
        thickness: largest standard deviation across the line, meters.
        length: least standard deviation along it, meters.
    """

    points: float = 8
    full: float = 2000
    thickness: float = 0.1
    length: float = 0.1


class VoxelMap:
    """Sums of points in voxels around the robot; the base of both maps.

    The smallest voxels have the edge `cell`, meters. Those farther from the robot than `radius`, meters, are
    dropped when the table is full.
    """

    _rule: PlaneRule | LineRule

    def __init__(self, cell: float, radius: float) -> None:
        self.cell, self._radius = cell, radius
        self.table, self._used = _new_table(START), 0

    @property
    def memory(self) -> int:
        """Bytes of the table."""
        return sum(array.nbytes for array in self.table)

    def insert(self, points: FloatArray, center: FloatArray) -> None:
        """Add points (n, 3) of the map frame, seen from `center` (3,), meters.

        A voxel takes no points of the other side of its plane: a thin wall has two faces.
        """
        for begin in range(0, len(points), CHUNK):
            chunk = points[begin : begin + CHUNK]
            if self._used + LEVELS * CHUNK > FILLED * len(self.table.keys):
                self._make_room(center)
            touched = np.empty(LEVELS * CHUNK, np.int64)
            created, count = _add(self.table, chunk, center, self.cell, self._rule.full, touched)
            self._used += created
            self._fit(self.table, touched[:count], center, self.cell, self._rule)

    def _fit(self, table: Table, slots: IntArray, center: FloatArray, cell: float, rule: Any) -> None:
        raise NotImplementedError

    def _make_room(self, center: FloatArray) -> None:
        """Drop the voxels far from a point; enlarge the table where that does not suffice."""
        kept = _near(self.table.keys, center, self.cell, self._radius)
        slots = START
        while len(kept) + 2 * LEVELS * CHUNK > FILLED * slots:
            slots *= 2
        old, self.table, self._used = self.table, _new_table(slots), len(kept)
        _copy(old, self.table, kept)


class PlaneMap(VoxelMap):
    """Planes of surfaces."""

    _rule = PlaneRule()

    def _fit(self, *given: Any) -> None:
        _fit_planes(*given)


class LineMap(VoxelMap):
    """Vertical lines: ends of walls, poles, trunks. An edge that moves with the view makes none."""

    _rule = LineRule()

    def _fit(self, *given: Any) -> None:
        _fit_lines(*given)


class LocalMap(NamedTuple):
    """Surroundings of the robot in the level map frame."""

    planes: PlaneMap
    lines: LineMap


def _new_table(slots: int) -> Table:
    return Table(np.full(slots, EMPTY, np.int64), np.zeros((slots, 10)), np.zeros((slots, 8)))


@njit
def voxel_key(x: float, y: float, z: float, cell: float, level: int) -> int:
    """Return the key of a point's voxel.

    It has 20 bits of each index, and 2 of the level.
    """
    edge, half = cell * (1 << level), 1 << 19
    i, j, k = int(np.floor(x / edge)) + half, int(np.floor(y / edge)) + half, int(np.floor(z / edge)) + half
    return (level << 60) | ((i & 0xFFFFF) << 40) | ((j & 0xFFFFF) << 20) | (k & 0xFFFFF)


@njit
def find_slot(keys: Any, key: int) -> int:
    """Return the slot of a key, or the free one in which it belongs."""
    mask = len(keys) - 1
    slot = (((key ^ (key >> 29)) * 0x1E3779B97F4A7C15) >> 20) & mask
    while keys[slot] != EMPTY and keys[slot] != key:
        slot = (slot + 1) & mask
    return slot


@njit
def _center(key: int, cell: float) -> Any:
    """Return the center of a voxel, meters."""
    edge, half = cell * (1 << (key >> 60)), 1 << 19
    i, j, k = ((key >> 40) & 0xFFFFF) - half, ((key >> 20) & 0xFFFFF) - half, (key & 0xFFFFF) - half
    return (i + 0.5) * edge, (j + 0.5) * edge, (k + 0.5) * edge


@njit
def _add(table: Any, points: Any, center: Any, cell: float, full: float, touched: Any) -> Any:
    """Add points; return the numbers of new voxels and of rows in `touched`."""
    keys, sums, planes = table
    created = count = 0
    for n in range(len(points)):
        for level in range(LEVELS):
            key = voxel_key(points[n, 0], points[n, 1], points[n, 2], cell, level)
            slot = find_slot(keys, key)
            if keys[slot] == EMPTY:
                keys[slot] = key
                created += 1
            s = sums[slot]
            if s[0] >= full or is_behind(planes[slot], center):
                continue
            if s[0] == planes[slot, FITTED]:
                touched[count] = slot
                count += 1
            cx, cy, cz = _center(key, cell)
            x, y, z = points[n, 0] - cx, points[n, 1] - cy, points[n, 2] - cz
            s[0] += 1
            s[1] += x
            s[2] += y
            s[3] += z
            s[4] += x * x
            s[5] += x * y
            s[6] += x * z
            s[7] += y * y
            s[8] += y * z
            s[9] += z * z
    return created, count


@njit
def is_behind(plane: Any, sensor: Any) -> Any:
    """Return whether a sensor (3,) is on the unseen side of a plane."""
    a, b, c = plane[0], plane[1], plane[2]
    side = a * (sensor[0] - plane[3]) + b * (sensor[1] - plane[4]) + c * (sensor[2] - plane[5])
    return plane[VARIANCE] > 0.0 and side < -MIN_BACK_DISTANCE


@njit
def _fit_planes(table: Any, slots: Any, center: Any, cell: float, rule: Any) -> None:
    """Fit the planes of voxels by the eigenvectors of their points' covariance.

    With n points, variance v across the plane and w along its narrow side, the normal has the variance
    v / (n w).
    """
    keys, sums, planes = table
    C = np.empty((3, 3))
    for slot in slots:
        s, plane = sums[slot], planes[slot]
        n = s[0]
        plane[FITTED], plane[VARIANCE] = n, 0.0
        if n < rule.points:
            continue
        x, y, z = s[1] / n, s[2] / n, s[3] / n
        C[0, 0], C[1, 1], C[2, 2] = s[4] / n - x * x, s[7] / n - y * y, s[9] / n - z * z
        C[0, 1] = C[1, 0] = s[5] / n - x * y
        C[0, 2] = C[2, 0] = s[6] / n - x * z
        C[1, 2] = C[2, 1] = s[8] / n - y * z
        values, vectors = np.linalg.eigh(C)
        edge, across, narrow = cell * (1 << (keys[slot] >> 60)), max(values[0], 1e-6), values[1]
        if (
            across <= (rule.thickness * edge) ** 2
            and narrow >= (rule.width * edge) ** 2
            and across <= n * narrow * rule.normal**2
        ):
            cx, cy, cz = _center(keys[slot], cell)
            plane[0], plane[1], plane[2] = vectors[0, 0], vectors[1, 0], vectors[2, 0]
            plane[3], plane[4], plane[5] = cx + x, cy + y, cz + z
            if np.dot(plane[:3], center - plane[3:6]) < 0:
                plane[:3] = -plane[:3]
            plane[VARIANCE] = across


@njit
def _fit_lines(table: Any, slots: Any, center: Any, cell: float, rule: Any) -> None:
    """Fit vertical lines to voxels: mean and horizontal variance of the points."""
    keys, sums, lines = table
    for slot in slots:
        s, line = sums[slot], lines[slot]
        n = s[0]
        line[FITTED], line[VARIANCE] = n, 0.0
        if n < rule.points:
            continue
        x, y, z = s[1] / n, s[2] / n, s[3] / n
        xx, yy, zz, xy = s[4] / n - x * x, s[7] / n - y * y, s[9] / n - z * z, s[5] / n - x * y
        across = (xx + yy) / 2 + np.sqrt(((xx - yy) / 2) ** 2 + xy * xy)
        if across <= rule.thickness**2 and zz >= rule.length**2:
            cx, cy, cz = _center(keys[slot], cell)
            line[3], line[4], line[5] = cx + x, cy + y, cz + z
            line[VARIANCE] = max(across, 1e-6)


@njit
def _near(keys: Any, center: Any, cell: float, radius: float) -> Any:
    """Return the slots of the voxels within a radius of a point."""
    kept = np.empty(len(keys), np.int64)
    count = 0
    for slot in range(len(keys)):
        if keys[slot] != EMPTY:
            x, y, z = _center(keys[slot], cell)
            square = (x - center[0]) ** 2 + (y - center[1]) ** 2 + (z - center[2]) ** 2
            if square <= radius * radius:
                kept[count] = slot
                count += 1
    return kept[:count]


@njit
def _copy(old: Any, new: Any, slots: Any) -> None:
    """Copy voxels to an empty table."""
    for slot in slots:
        to = find_slot(new[0], old[0][slot])
        new[0][to] = old[0][slot]
        new[1][to] = old[1][slot]
        new[2][to] = old[2][slot]
