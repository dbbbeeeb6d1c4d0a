"""De-skewing: the poses at which the beams of a rolling scan were cast, and the scan without the motion.

A robot that moves with constant velocity v and rates w (both in its own frame) is after a time t at
exp(t [v, w]) in the frame that it had: rotation by Rodrigues' formula, translation by its integral
(Lynch and Park, "Modern Robotics", eqs. 3.51 and 3.88).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from lirs_envs.lidar.presets import ring_directions
from lirs_wct.arrays import BoolArray, FloatArray, IntArray
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.scan import LaserScan


def moved_frames(times: ArrayLike, velocity: ArrayLike, rates: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return rotations (n, 3, 3) and positions (n, 3) of a moving frame, in the frame that it was at time 0.

    Args:
        times: (n,) seconds.
        velocity: (3,) along the frame's own axes, m/s, constant there.
        rates: (3,) about the frame's own axes, rad/s, constant.

    Raises:
        ConfigError: an array has the wrong shape or a value that is not finite.
    """
    t, v, w = (np.asarray(a, dtype=np.float64) for a in (times, velocity, rates))
    if t.ndim != 1 or v.shape != (3,) or w.shape != (3,):
        raise ConfigError(
            f"a motion needs times (n,), velocity (3,), rates (3,), got {t.shape, v.shape, w.shape}"
        )
    if not (np.isfinite(v).all() and np.isfinite(w).all()):
        raise ConfigError(f"velocity and rates of a motion must be finite, got {v} and {w}")
    rate = float(np.linalg.norm(w))
    if rate < 1e-9:
        return np.broadcast_to(np.eye(3), (len(t), 3, 3)), t[:, None] * v
    x, y, z = w / rate
    K = np.array(((0, -z, y), (z, 0, -x), (-y, x, 0)))
    angle = (rate * t)[:, None, None]
    R = np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * (K @ K)
    G = angle * np.eye(3) + (1 - np.cos(angle)) * K + (angle - np.sin(angle)) * (K @ K)
    return R, (G @ v) / rate


def deskewed_points(scan: LaserScan, velocity: ArrayLike, rates: ArrayLike) -> FloatArray:
    """Return (n, 3) ends of the beams in the base frame at the scan's stamp; NaN where a beam met nothing.

    Args:
        scan: a rolling scan; one with `time_increment` 0 has no skew.
        velocity: (3,) of the base along its axes during the scan, m/s: from odometry.
        rates: (3,) about them, rad/s: from the gyro.
    """
    angles = scan.angles
    ranges = np.where(scan.hits, scan.ranges, np.nan).astype(np.float64)
    beams = ranges[:, None] * ring_directions(angles)
    R, p = moved_frames(scan.time_increment * np.arange(len(angles)), velocity, rates)
    points: FloatArray = np.einsum("nij,nj->ni", R, scan.T_base_laser.apply(beams)) + p
    return points


def deskewed_scan(scan: LaserScan, velocity: ArrayLike, rates: ArrayLike) -> LaserScan:
    """Return the scan as if all beams had been cast at its stamp.

    Ends of beams go to the beam of the nearest angle, the nearer one where two meet; a beam that nothing
    falls on is invalid (NaN), and one that had met nothing keeps that where its turned direction ends.
    """
    points = scan.T_base_laser.inverse().apply(deskewed_points(scan, velocity, rates))
    hits = np.isfinite(points[:, 0])
    empty = np.flatnonzero(np.isposinf(scan.ranges))
    turned = scan.angles + scan.time_increment * np.arange(len(scan.ranges)) * np.asarray(rates)[2]
    ranges = np.full(len(scan.ranges), np.nan)
    ranges[_indices(scan, turned[empty])[0]] = np.inf
    index, inside = _indices(scan, np.arctan2(points[hits, 1], points[hits, 0]))
    distance = np.hypot(points[hits, 0], points[hits, 1])[inside]
    met = np.full(len(ranges), np.inf)
    np.minimum.at(met, index, distance)
    ranges = np.where(np.isfinite(met), met, ranges)
    return replace(scan, ranges=ranges.astype(np.float32), time_increment=0.0)


def _indices(scan: LaserScan, angles: FloatArray) -> tuple[IntArray, BoolArray]:
    """Return the beams nearest to angles, and which angles have one."""
    offset = np.remainder(angles - scan.angle_min + scan.angle_increment / 2, 2 * np.pi)
    index = (offset / scan.angle_increment).astype(np.int64)
    inside = index < len(scan.ranges)
    return index[inside], inside
