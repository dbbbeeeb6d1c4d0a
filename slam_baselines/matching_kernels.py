"""Kernels of the scan-to-map matching: see scan_matching."""

from __future__ import annotations

import numpy as np
from numba import njit

from slam_baselines.ray_update import FULL, UNSEEN
from slam_baselines.small_matrices import invert3, solve3


@njit(cache=True)
def levels_for(frames, covariance, lever):  # type: ignore[no-untyped-def]
    """Return how many levels it takes to catch an error of two standard deviations."""
    error = np.sqrt(max(covariance[0, 0], covariance[1, 1])) + lever * np.sqrt(covariance[2, 2])
    levels = 1
    while levels < len(frames) and 2 * error > frames[levels - 1, 2]:
        levels += 1
    return levels


@njit(cache=True)
def fit(  # type: ignore[no-untyped-def]
    values, frames, points, weights, prior, covariance, start, levels, iterations,
    variance, converged, lever, out,
):  # fmt: skip
    """Match, on as many levels as it takes where `levels` is 0; fill `out` (24,), covariance last."""
    information = invert3(covariance)
    if levels == 0:
        levels = levels_for(frames, covariance, lever)
    used = iterations[:levels]
    match(values, frames, points, weights, prior, information, start, used, variance, converged, False, out)
    for i in range(3):
        for j in range(3):
            information[i, j] += out[3 + 3 * i + j]
    out[15:] = invert3(information).ravel()


@njit(cache=True)
def match(  # type: ignore[no-untyped-def]
    values, frames, points, weights, prior, information, start, iterations, variance, converged, exact, out
):
    """Run Gauss-Newton from the coarsest level to the finest; fill `out` (15 or more).

    Unless it is to be exact, score and information may be those of a pose one last, tiny step away.
    """
    pose = start.copy()
    H, g = np.empty((3, 3)), np.empty(3)
    A, b = np.empty((3, 3)), np.empty(3)
    score = known = 0.0
    settled = False
    for level in range(len(iterations) - 1, -1, -1):
        cell = frames[level, 2]
        stride = 2**level  # a coarse level needs fewer beams to show the way
        for _ in range(iterations[level]):
            score, known = linearise(values[level], frames[level], points, weights, stride, pose, H, g)
            for i in range(3):
                b[i] = g[i] * stride / variance
                for j in range(3):
                    A[i, j] = H[i, j] * stride / variance + information[i, j]
                    b[i] -= information[i, j] * (pose[j] - prior[j])
            step = solve3(A, b)
            length = np.hypot(step[0], step[1])
            pose += step * (4 * cell / max(4 * cell, length, abs(step[2]) * 20 * cell))
            settled = length < converged * cell and abs(step[2]) < converged * 0.1
            if settled:
                break
    if exact or not settled:
        score, known = linearise(values[0], frames[0], points, weights, 1, pose, H, g)
    out[:3] = pose
    out[3:12] = (H / variance).ravel()
    total = max(weights.sum(), 1e-9)
    out[12], out[13], out[14] = score / max(known, 1e-9), known, known / total


@njit(cache=True)
def linearise(value, frame, points, weights, stride, pose, H, g):  # type: ignore[no-untyped-def]
    """Fill Hessian and gradient of the matching cost (eqs. 12-13); return score and known weight.

    Args:
        value: (rows, cols) layer of the map.
        frame: (3,) lattice row and column of its cell (0, 0), resolution in metres.
        points: (n, 2 or more) ends of beams in the levelled base frame.
        weights: (n,) of the beams.
        stride: only every so many beams count.
        pose: (3,) x, y, yaw.
        H: (3, 3) to be filled.
        g: (3,) to be filled.
    """
    rows, cols = value.shape
    scale, one = 1 / frame[2], np.uintp(1)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    u0, v0 = pose[0] * scale - 0.5 - frame[1], pose[1] * scale - 0.5 - frame[0]
    h00 = h01 = h02 = h11 = h12 = h22 = g0 = g1 = g2 = 0.0
    seen = score = 0.0
    for i in range(0, len(points), stride):
        px, py = c * points[i, 0] - s * points[i, 1], s * points[i, 0] + c * points[i, 1]
        u, v = u0 + px * scale, v0 + py * scale
        if not (u >= 0 and v >= 0 and u < cols - 1 and v < rows - 1):
            continue
        # Unsigned: an index that might be negative costs a comparison.
        col, row = np.uintp(int(u)), np.uintp(int(v))
        u -= int(u)
        v -= int(v)
        sw, se, nw, ne = (
            value[row, col],
            value[row, col + one],
            value[row + one, col],
            value[row + one, col + one],
        )
        south, north = sw + u * (float(se) - sw), nw + u * (float(ne) - nw)
        m, w = south + v * (north - south), weights[i]
        if not (sw == UNSEEN and se == UNSEEN and nw == UNSEEN and ne == UNSEEN):
            seen += w
            score += w * m
        dx, dy = (float(se) - sw) * (1 - v) + (float(ne) - nw) * v, north - south
        dyaw, e = dy * px - dx * py, w * (FULL - m)
        h00 += w * dx * dx
        h01 += w * dx * dy
        h02 += w * dx * dyaw
        h11 += w * dy * dy
        h12 += w * dy * dyaw
        h22 += w * dyaw * dyaw
        g0 += dx * e
        g1 += dy * e
        g2 += dyaw * e
    unit = scale / FULL
    H[0, 0], H[0, 1], H[0, 2], H[1, 1], H[1, 2], H[2, 2] = h00, h01, h02, h11, h12, h22
    H[1, 0], H[2, 0], H[2, 1] = h01, h02, h12
    H *= unit * unit
    g[0], g[1], g[2] = g0 * unit / FULL, g1 * unit / FULL, g2 * unit / FULL
    return score / FULL, seen
