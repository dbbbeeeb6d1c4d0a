"""Points of a sweep, deskewed and thinned out, and its edges."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from lirs_extensions.clouds.wheel_lio.voxel_map import EMPTY, find_slot, voxel_key
from lirs_wct.arrays import FloatArray, njit
from lirs_wct.geometry import PointCloud

INSIDE = 3
"""Points of a surface beside its end."""
OCCLUSION_DISTANCE = 0.5
"""Distance of what is behind the end of a surface, meters."""
MAX_BEAM_ANGLE = 0.02
"""Largest angle between two beams of a ring, radians."""
NOISE = 0.1
"""Difference of two ranges on a surface by noise, meters."""


@dataclass(frozen=True, slots=True)
class BodyTwist:
    """Velocity of the base at a sweep's stamp, along and about its own axes.

    Attributes:
        linear: (3,) m/s.
        angular: (3,) rad/s.
    """

    linear: FloatArray
    angular: FloatArray


class SweepPoints(NamedTuple):
    """Points of a sweep to register, base frame, meters.

    Attributes:
        surfaces: (n, 3).
        edges: (m, 3) vertical ends of surfaces, and others.
        origin: (3,) of the beams.
    """

    surfaces: FloatArray
    edges: FloatArray
    origin: FloatArray


def deskew(cloud: PointCloud, twist: BodyTwist) -> FloatArray:
    """Return the points (n, 3) in the base frame at the stamp, meters.

    A point that was measured a time t after the stamp is moved by exp(t [v, w]): the base is taken to go on
    at the velocity that it had at the stamp.
    """
    points = np.empty((len(cloud), 3))
    mount = cloud.T_base_laser
    _deskew(cloud.xyz, cloud.time, mount.rotation, mount.position, twist.linear, twist.angular, points)
    return points


@njit
def _deskew(xyz: Any, time: Any, R: Any, offset: Any, v: Any, w: Any, points: Any) -> None:
    """Fill `points` by Rodrigues' formula and its integral (Lynch and Park, "Modern Robotics", eq. 3.88)."""
    rate = math.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    t0, a, b, c = -1.0, 0.0, 0.0, 0.0
    for n in range(len(xyz)):
        p = np.dot(R, xyz[n].astype(np.float64)) + offset
        t = time[n]
        if t == 0.0:
            points[n] = p
            continue
        if t != t0:
            angle = rate * t
            if angle > 1e-6:
                a, b = math.sin(angle) / rate, (1 - math.cos(angle)) / rate**2
                c = (angle - math.sin(angle)) / rate**3
            else:
                a, b, c = t, t * t / 2, t**3 / 6
            t0 = t
        wp, wv = _cross(w, p), _cross(w, v)
        wwp, wwv = _cross(w, wp), _cross(w, wv)
        for i in range(3):
            points[n, i] = p[i] + a * wp[i] + b * wwp[i] + t * v[i] + b * wv[i] + c * wwv[i]


@njit
def _cross(a: Any, b: Any) -> Any:
    return np.array((a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]))


@njit
def thin(points: Any, cell: float) -> Any:
    """Return the mean (m, 3) of the points (n, 3) in each cubic cell.

    The cells are in the order of their first points.
    """
    slots = 1024
    while slots < 2 * len(points):
        slots *= 2
    keys, row = np.full(slots, EMPTY, np.int64), np.empty(slots, np.int64)
    sums, counts, m = np.zeros((len(points), 3)), np.zeros(len(points)), 0
    for n in range(len(points)):
        key = voxel_key(points[n, 0], points[n, 1], points[n, 2], cell, 0)
        slot = find_slot(keys, key)
        if keys[slot] == EMPTY:
            keys[slot], row[slot] = key, m
            m += 1
        k = row[slot]
        sums[k] += points[n]
        counts[k] += 1
    for k in range(m):
        sums[k] /= counts[k]
    return sums[:m]


@njit
def find_edges(points: Any, ring: Any, origin: Any) -> Any:
    """Return the ends (m, 3) of surfaces in the rings, meters.

    There the next beam of the ring has no return, or one far behind. The last beam on a surface misses its
    end by half the distance of two beams on the mean, which is added.

    Args:
        points: (n, 3) of a sweep, ring by ring, meters.
        ring: (n,) of the points.
        origin: (3,) of the beams.
    """
    n = len(points)
    azimuth, distance = np.empty(n), np.empty(n)
    for i in range(n):
        x, y, z = points[i, 0] - origin[0], points[i, 1] - origin[1], points[i, 2] - origin[2]
        azimuth[i], distance[i] = math.atan2(y, x), math.sqrt(x * x + y * y + z * z)
    found, count, begin = np.empty((2 * n, 3)), 0, 0
    while begin < n:
        end = begin
        while end < n and ring[end] == ring[begin]:
            end += 1
        turn = end - begin if end - begin > 2 * INSIDE else 0
        for i in range(begin, begin + turn):
            for outward in (-1, 1):
                beyond = begin + (i - begin + outward) % turn
                inside = begin + (i - begin - INSIDE * outward) % turn
                angle, gap = _angle(azimuth[inside], azimuth[i]) / INSIDE, _angle(azimuth[i], azimuth[beyond])
                is_end = gap >= 3 * angle or distance[beyond] >= distance[i] + OCCLUSION_DISTANCE
                step = INSIDE * (NOISE + 4 * angle * distance[i])
                if is_end and angle <= MAX_BEAM_ANGLE and abs(distance[inside] - distance[i]) < step:
                    found[count] = points[i] + (points[i] - points[inside]) / (2 * INSIDE)
                    count += 1
        begin = end
    return found[:count]


@njit
def _angle(a: float, b: float) -> Any:
    """Return the angle between two azimuths, radians."""
    return abs((a - b + math.pi) % math.tau - math.pi)
