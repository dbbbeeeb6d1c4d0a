"""The ground that lidars have seen, a grid for each of N robots."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from lirs_envs.tasks.site import SEEN_CELL, SeenFrame
from lirs_wct.arrays import BoolArray, ByteArray, Float32Array, FloatArray
from lirs_wct.geometry.pose import Pose3

DONE = np.float32(-np.inf)
"""Height below which no beam passes: there is nothing to be seen, or it was seen."""


class SeenGround:
    """Cells over whose ground a beam passed at most `reach` above it, or on which it ended; from true poses.

    Attributes:
        cells: (N,) number of seen cells.
        wanted_cells: (N,) number of seen cells among the wanted ones.

    Args:
        count: number of robots, N.
        beams: (n, 3) directions of the beams in the base's frame, unit vectors.
        mount: (3,) the lidar in the base's frame, metres.
        reach: metres.
    """

    def __init__(self, count: int, beams: FloatArray, mount: FloatArray, reach: float) -> None:
        self._beams, self._mount, self._reach = beams, mount, reach
        self._ceilings: list[Float32Array] = [np.zeros((0, 0), np.float32)] * count
        self._ground: list[BoolArray] = [np.zeros((0, 0), np.bool_)] * count
        self._wanted: list[BoolArray] = [np.zeros((0, 0), np.bool_)] * count
        self._corners = [(0.0, 0.0)] * count
        self.cells = np.zeros(count, np.int64)
        self.wanted_cells = np.zeros(count, np.int64)

    def begin(self, i: int, frame: SeenFrame, wanted: BoolArray) -> None:
        """Begin anew for robot `i`, which has seen nothing; `wanted` (rows, cols) cells are counted apart."""
        self._ceilings[i] = frame.height + np.float32(self._reach)
        self._ground[i] = np.isfinite(frame.height)
        self._wanted[i], self._corners[i] = wanted, frame.corner
        self.cells[i] = self.wanted_cells[i] = 0

    def add(self, i: int, ranges: Float32Array, range_max: float, T_world_base: Pose3) -> None:
        """Mark what the beams of robot `i` saw; one without return sees its whole range."""
        T = T_world_base
        cells, wanted = mark_seen(
            self._ceilings[i],
            self._wanted[i],
            self._corners[i],
            (T.qw, T.qx, T.qy, T.qz),
            (T.x, T.y, T.z),
            self._mount,
            self._beams,
            ranges,
            range_max,
        )
        self.cells[i] += cells
        self.wanted_cells[i] += wanted

    def seen(self, i: int) -> BoolArray:
        """Return (rows, cols) the cells that robot `i` has seen, row 0 = south."""
        seen: BoolArray = self._ground[i] & (self._ceilings[i] == DONE)
        return seen

    def local_map(self, i: int, x: float, y: float, yaw: float, out: ByteArray) -> None:
        """Fill (n, n): 255 = seen; the robot in the middle, row 0 = ahead, column 0 = left."""
        _crop(self._ceilings[i], self._ground[i], self._corners[i], (x, y, yaw), out)


@njit(cache=True, nogil=True, error_model="numpy")
def mark_seen(
    ceiling: Float32Array,
    wanted: BoolArray,
    corner: tuple[float, float],
    quaternion: tuple[float, float, float, float],
    position: tuple[float, float, float],
    mount: FloatArray,
    beams: FloatArray,
    ranges: Float32Array,
    range_max: float,
) -> tuple[int, int]:
    """Set the ceiling of each cell that a beam passes below it to -inf; return how many, and wanted ones.

    Cells are those that a beam crosses in the plane (Amanatides and Woo, "A fast voxel traversal algorithm
    for ray tracing", 1987); its height is that in the middle of the crossing.
    """
    rows, cols = ceiling.shape
    w, x, y, z = quaternion
    a, b, c = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    d, e, f = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    g, h, k = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    m0, m1, m2 = mount[0], mount[1], mount[2]
    u0 = (position[0] + (a * m0 + b * m1 + c * m2) - corner[0]) / SEEN_CELL
    v0 = (position[1] + (d * m0 + e * m1 + f * m2) - corner[1]) / SEEN_CELL
    z0 = position[2] + (g * m0 + h * m1 + k * m2)
    new, new_wanted = 0, 0
    for n in range(len(beams)):
        if not ranges[n] > 0.0:  # too near, or lost
            continue
        t_end = min(np.float64(ranges[n]), range_max)
        p, q, s = beams[n, 0], beams[n, 1], beams[n, 2]
        du, dv = (a * p + b * q + c * s) / SEEN_CELL, (d * p + e * q + f * s) / SEEN_CELL
        dz = g * p + h * q + k * s
        i, j = math.floor(u0), math.floor(v0)
        step_u, step_v = 1 if du > 0 else -1, 1 if dv > 0 else -1
        per_u, per_v = 1 / abs(du) if du != 0 else np.inf, 1 / abs(dv) if dv != 0 else np.inf
        tu = ((i + 1 - u0) if du > 0 else (u0 - i)) * per_u if du != 0 else np.inf
        tv = ((j + 1 - v0) if dv > 0 else (v0 - j)) * per_v if dv != 0 else np.inf
        t = 0.0
        while t < t_end and 0 <= i < cols and 0 <= j < rows:
            t_out = min(tu, tv, t_end)
            if z0 + 0.5 * (t + t_out) * dz <= ceiling[j, i]:
                ceiling[j, i] = DONE
                new += 1
                new_wanted += wanted[j, i]
            t = t_out
            if tu < tv:
                i += step_u
                tu += per_u
            else:
                j += step_v
                tv += per_v
    return new, new_wanted


@njit(cache=True, nogil=True)
def _crop(
    ceiling: Float32Array,
    ground: BoolArray,
    corner: tuple[float, float],
    pose: tuple[float, float, float],
    out: ByteArray,
) -> None:
    rows, cols = ceiling.shape
    n = len(out)
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    for r in range(n):
        ahead = ((n - 1) / 2 - r) * SEEN_CELL
        for c in range(n):
            left = ((n - 1) / 2 - c) * SEEN_CELL
            i = math.floor((pose[0] + cos * ahead - sin * left - corner[0]) / SEEN_CELL)
            j = math.floor((pose[1] + sin * ahead + cos * left - corner[1]) / SEEN_CELL)
            inside = 0 <= i < cols and 0 <= j < rows
            out[r, c] = 255 if inside and ground[j, i] and ceiling[j, i] == -np.inf else 0
