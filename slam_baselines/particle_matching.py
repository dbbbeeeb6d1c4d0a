"""Where one particle expects the robot, and where its map says that the scan was taken."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from slam_baselines.likelihood import Beams, linearise, log_likelihood
from slam_baselines.scan_matching import solve3

Array = NDArray[np.float64]


class Prior(NamedTuple):
    """The pose by odometry.

    Attributes:
        pose: (3,) x, y, yaw of `T_map_base`.
        information: (3, 3) inverse of its covariance.
    """

    pose: Array
    information: Array


class Tuning(NamedTuple):
    """The numbers of ProposalConfig that the kernels need, under the same names."""

    sigma: float
    kernelSize: int  # noqa: N815
    iterations: int
    lsigma: float
    lstep: float
    astep: float
    llsamplerange: float
    lasamplerange: float
    poor_score: float
    minimumScore: float  # noqa: N815
    least_beams: int


@njit(cache=True)
def score(view, beams, pose, tuning):  # type: ignore[no-untyped-def]
    """Return the log-likelihood of a scan at a pose."""
    spread = tuning.sigma / view.resolution
    return log_likelihood(view, beams, pose, tuning.kernelSize, tuning.lsigma, spread)[0]


@njit(cache=True)
def log_prior(pose, prior):  # type: ignore[no-untyped-def]
    """Return the logarithm of the odometry's density at a pose, up to a constant."""
    d = _difference(pose, prior.pose)
    return -0.5 * (d @ (prior.information @ d))


@njit(cache=True)
def match(view, beams, prior, start, tuning, H):  # type: ignore[no-untyped-def]
    """Return the (3,) pose at which the scan fits best near the start; fill H with its information.

    Gauss-Newton in two stages: few beams and a wide view, then all beams and a narrow one. The odometry
    is a prior, so that a direction in which the map says nothing follows it.
    """
    pose, g = start.copy(), np.empty(3)
    few = max(1, len(beams.points) // 90)
    reach, width = tuning.kernelSize, tuning.sigma / view.resolution
    for stage in range(2):
        wider, stride, done = (3, few, 0.01) if stage == 0 else (1, 1, 0.001)
        for _ in range(tuning.iterations):
            linearise(view, beams, stride, pose, wider * reach, wider * width, H, g)
            H /= tuning.sigma**2
            pull = prior.information @ _difference(pose, prior.pose)
            step = solve3(H + prior.information, g / tuning.sigma**2 - pull)
            pose += step * (0.2 / max(0.2, np.hypot(step[0], step[1]), 2 * abs(step[2])))
            if np.hypot(step[0], step[1]) < done and abs(step[2]) < done / 5:
                break
    return pose


@njit(cache=True)
def search(view, beams, prior, tuning):  # type: ignore[no-untyped-def]
    """Return the (3,) pose of the best score in a window around the prior, by trying all."""
    stride = max(1, len(beams.points) // 60)
    some = Beams(np.ascontiguousarray(beams.points[::stride]), beams.weights[::stride] * stride)
    n, turns = int(tuning.llsamplerange / tuning.lstep), int(tuning.lasamplerange / tuning.astep)
    best, highest = prior.pose.copy(), -np.inf
    pose = np.empty(3)
    for k in range(-turns, turns + 1):
        for i in range(-n, n + 1):
            for j in range(-n, n + 1):
                pose[0], pose[1] = prior.pose[0] + i * tuning.lstep, prior.pose[1] + j * tuning.lstep
                pose[2] = prior.pose[2] + k * tuning.astep
                value = score(view, some, pose, tuning) + log_prior(pose, prior)
                if value > highest:
                    highest = value
                    best[:] = pose
    return best


@njit(cache=True)
def moved(pose, by):  # type: ignore[no-untyped-def]
    """Return pose @ by, all (3,)."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.array((pose[0] + c * by[0] - s * by[1], pose[1] + s * by[0] + c * by[1], pose[2] + by[2]))


@njit(cache=True)
def between(a, b):  # type: ignore[no-untyped-def]
    """Return a^-1 @ b, all (3,)."""
    c, s = np.cos(a[2]), np.sin(a[2])
    dx, dy = b[0] - a[0], b[1] - a[1]
    return np.array((c * dx + s * dy, c * dy - s * dx, b[2] - a[2]))


@njit(cache=True)
def _difference(pose, other):  # type: ignore[no-untyped-def]
    d = pose - other
    d[2] = (d[2] + np.pi) % (2 * np.pi) - np.pi
    return d
