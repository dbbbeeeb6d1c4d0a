"""Registration of a sweep with a map of planes and a motion prior.

Directions that the sweep does not constrain are found by the eigenvalues of the registration's information
and left to the prior: solution remapping (Zhang, Kaess and Singh, "On Degeneracy of Optimization-based State
Estimation Problems", ICRA 2016, sections IV and V).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from lirs_extensions.clouds.wheel_lio.voxel_map import (
    EMPTY,
    LEVELS,
    VARIANCE,
    LocalMap,
    find_slot,
    is_behind,
    voxel_key,
)
from lirs_wct.geometry import BoolArray, FloatArray, PointCloud, njit

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
    """Velocity (3,) m/s and rates (3,) rad/s of the base in its axes."""

    linear: FloatArray
    angular: FloatArray


class SweepPoints(NamedTuple):
    """Points of a sweep, and the origin (3,) of its beams, base frame, meters.

    Edges (m, 3) are vertical ends of surfaces, and others.
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
    """Return the ends (m, 3) of surfaces in the rings of a sweep, meters.

    There the next beam of the ring has no return, or one far behind. The last beam on a surface misses its
    end by half the distance of two beams on the mean, which is added. The beams have one origin (3,).
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


STEPS = 15
"""Largest number of Gauss-Newton steps."""
CONVERGED_STEP = np.repeat((2e-4, 2e-5), 3)
"""Step at which the registration has converged, meters and radians."""
LEAST_POINTS = 50
"""Number of points with a plane below which a sweep constrains nothing."""


class MatchRule(NamedTuple):
    """Errors of a sweep's points; meanings as of WheelLioConfig.

    The error that all points share does not average out, however many points there are.
    """

    noise: float
    edge: float
    gate: float
    error: float
    weak: float


PLANAR = [0, 1, 5]
"""Indices of x, y and yaw in a motion in space."""


@dataclass(frozen=True, slots=True)
class SpatialPrior:
    """Expected base pose, R (3, 3) and t (3,), level map frame, meters.

    Its standard deviations (6,) are those of the position along the frame's axes, meters, and of the turn
    about them, radians.
    """

    R: FloatArray
    t: FloatArray
    sigmas: FloatArray

    @property
    def planar(self) -> FloatArray:
        """(3, 3) covariance of x, y, yaw."""
        covariance: FloatArray = np.diag(self.sigmas[PLANAR] ** 2)
        return covariance


@dataclass(frozen=True, slots=True)
class Constraint:
    """Information of a sweep about six directions of motion.

    A direction is a unit vector of a shift along the map frame's axes and a turn about them through the
    robot. The turn counts by its arc at the points' root mean square distance.

    Attributes:
        values: (6,) eigenvalues, ascending: mean square of the share of the motion that the planes see.
        directions: (6, 6) eigenvectors in columns.
        weak: (6,) whether the sweep leaves a direction to the prior.
    """

    values: FloatArray
    directions: FloatArray
    weak: BoolArray


@dataclass(frozen=True, slots=True)
class PlaneMatch:
    """Most probable pose of a sweep by its points with a plane.

    Its covariance (3, 3) is of x, y, yaw relative to the map.
    """

    R: FloatArray
    t: FloatArray
    points: int
    constraint: Constraint
    covariance: FloatArray


NOTHING = Constraint(np.zeros(6), np.eye(6), np.ones(6, np.bool_))
"""Constraint of a sweep without planes."""


def register(seen: SweepPoints, local: LocalMap, prior: SpatialPrior, rule: MatchRule) -> PlaneMatch:
    """Return the most probable pose of a sweep; without enough planes the expected one.

    Each Gauss-Newton step solves (A + E + P) x = b + e + P o. A and b are of the surfaces' points in the
    directions that are not weak, E and e of the edges, P is the information of the prior and o the offset of
    the expected pose. Edges count each by itself: there are few of them, and beams miss them at random.
    """
    R, t, P = prior.R, prior.t, prior.sigmas**-2.0
    planes, lines = local
    for _ in range(STEPS):
        H, g, weight, square, found = linearize(
            seen.surfaces, seen.origin, planes.table, planes.cell, R, t, rule
        )
        if found < LEAST_POINTS:
            return PlaneMatch(prior.R, prior.t, found, NOTHING, prior.planar)
        arc = np.repeat((1.0, math.sqrt(square / weight)), 3)
        constraint = find_weak(H / weight / np.outer(arc, arc), rule.weak)
        strong = constraint.directions * ~constraint.weak
        J = strong.T * arc
        A = (J.T * constraint.values) @ J / rule.error**2
        b = J.T @ (strong.T @ (g / weight / arc)) / rule.error**2
        E, e = linearize_edges(seen.edges, lines.table, lines.cell, R, t, rule)
        offset = np.concatenate((prior.t - t, Rotation.from_matrix(prior.R @ R.T).as_rotvec()))
        information = A + E + np.diag(P)
        step = np.linalg.solve(information, b + e + P * offset)
        t, R = t + step[:3], Rotation.from_rotvec(step[3:]).as_matrix() @ R
        if (abs(step) < CONVERGED_STEP).all():
            break
    return PlaneMatch(R, t, found, constraint, np.linalg.inv(information)[np.ix_(PLANAR, PLANAR)])


def find_weak(information: FloatArray, weak: float) -> Constraint:
    """Return eigenvalues and directions of an information matrix (6, 6); weak are those below `weak`^2."""
    values, directions = np.linalg.eigh(information)
    return Constraint(values, directions, values < weak**2)


@njit
def linearize(points: Any, origin: Any, table: Any, cell: float, R: Any, t: Any, rule: Any) -> Any:
    """Linearize the distances of points, seen from `origin` (3,), from the map's planes.

    Returns weighted sums over the points with a plane: J'J (6, 6) and J'r (6,) of a shift and a turn about
    the robot, 1, and the square of the distance from the robot; and the number of these points.
    """
    H, g = np.zeros((6, 6)), np.zeros(6)
    total = square = 0.0
    found = 0
    J, sensor = np.empty(6), np.dot(R, origin) + t
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        qx = R[0, 0] * x + R[0, 1] * y + R[0, 2] * z
        qy = R[1, 0] * x + R[1, 1] * y + R[1, 2] * z
        qz = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z
        slot = _smallest(table, qx + t[0], qy + t[1], qz + t[2], cell)
        if slot < 0:
            continue
        plane = table[2][slot]
        if is_behind(plane, sensor):
            continue
        a, b, c = plane[0], plane[1], plane[2]
        r = a * (plane[3] - qx - t[0]) + b * (plane[4] - qy - t[1]) + c * (plane[5] - qz - t[2])
        if abs(r) > rule.gate:
            continue
        variance = rule.noise**2 + plane[VARIANCE]
        w = variance / (variance + r * r) ** 2  # Geman and McClure
        J[0], J[1], J[2] = a, b, c
        J[3], J[4], J[5] = qy * c - qz * b, qz * a - qx * c, qx * b - qy * a
        for i in range(6):
            g[i] += w * r * J[i]
            for j in range(6):
                H[i, j] += w * J[i] * J[j]
        total += w
        square += w * (qx * qx + qy * qy + qz * qz)
        found += 1
    return H, g, total, square, found


@njit
def _smallest(table: Any, x: float, y: float, z: float, cell: float) -> Any:
    """Return the slot of the smallest plane or line around a point, -1 without."""
    keys, _, planes = table
    for level in range(LEVELS):
        slot = find_slot(keys, voxel_key(x, y, z, cell, level))
        if keys[slot] != EMPTY and planes[slot, VARIANCE] > 0.0:
            return slot
    return -1


@njit
def linearize_edges(points: Any, table: Any, cell: float, R: Any, t: Any, rule: Any) -> Any:
    """Linearize the horizontal distances of edges from the map's vertical lines.

    Returns weighted sums J'J (6, 6) and J'r (6,), as in `linearize`.
    """
    H, g = np.zeros((6, 6)), np.zeros(6)
    J, r = np.zeros((2, 6)), np.empty(2)
    for n in range(len(points)):
        q = np.dot(R, points[n])
        slot = _smallest(table, q[0] + t[0], q[1] + t[1], q[2] + t[2], cell)
        if slot < 0:
            continue
        line = table[2][slot]
        r[0], r[1] = line[3] - q[0] - t[0], line[4] - q[1] - t[1]
        square = r[0] * r[0] + r[1] * r[1]
        if square > rule.gate**2:
            continue
        variance = rule.edge**2 + line[VARIANCE]
        w = variance / (variance + square) ** 2
        J[0, 0], J[0, 4], J[0, 5] = 1.0, q[2], -q[1]
        J[1, 1], J[1, 3], J[1, 5] = 1.0, -q[2], q[0]
        for i in range(6):
            g[i] += w * (J[0, i] * r[0] + J[1, i] * r[1])
            for j in range(6):
                H[i, j] += w * (J[0, i] * J[0, j] + J[1, i] * J[1, j])
    return H, g
