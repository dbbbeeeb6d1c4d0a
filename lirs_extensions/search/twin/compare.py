"""Residuals between measured ranges and those expected by a map of other blocks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lirs_envs.lidar.presets import LidarNoise, draw_noise, measure
from lirs_extensions.search.twin.surface import (
    Expected,
    LogScans,
    Surfaces,
    align,
    expected_beams,
    fit_surfaces,
    map_of,
)
from lirs_wct.arrays import BoolArray, Float32Array, FloatArray, IntArray
from lirs_wct.geometry import LaserScan, Pose2, Trajectory

BLOCK = 2.5
"""Length of a block along the path, meters."""
REFINEMENTS = (0.15, 0.08, 0.05)
"""Widths of the matching of the even blocks' scans to their own surfaces, meters."""
WIDTH = 0.05
"""Width of the matching of the odd blocks' scans, meters."""
GATE = 0.25
"""Largest residual that counts as noise; beyond it a beam met something else, meters."""
LOCALIZED = 1 / 3
"""Smallest share of a scan's beams on the map's lines; others are not compared."""
CLUSTER = 3
"""Fewest neighboring beams of an object that the map lacks."""


@dataclass(frozen=True)
class LogComparison:
    """Beams of the odd blocks against the map of the even ones.

    Attributes:
        scans: all scans at their matched poses.
        beams: expected beams of all scans.
        surfaces: lines of the even blocks' map.
        used: (n,) scans that are compared: in odd blocks, and localized.
        compared: (n, beams) beams that are compared.
        residual: (n, beams) measured less expected range, meters; not finite where nothing was measured.
    """

    scans: LogScans
    beams: Expected
    surfaces: Surfaces
    used: BoolArray
    compared: BoolArray
    residual: FloatArray

    @property
    def noise(self) -> BoolArray:
        """(n, beams) compared beams whose residual counts as noise."""
        return self.compared & (np.abs(self.residual) <= GATE)

    def residuals(self) -> tuple[FloatArray, FloatArray, FloatArray, IntArray]:
        """Return residual, expected range, cosine of the incidence and block of the noise's beams, (m,)."""
        some = self.noise
        rows, _ = np.nonzero(some)
        b = self.beams
        return self.residual[some], b.ranges[some], b.cosine[some], self.scans.block[rows]


def compare(scans: LogScans) -> LogComparison:
    """Map the even blocks, localize the odd ones there, and compare their beams."""
    even = scans.even
    poses, share = scans.poses.copy(), np.zeros(len(scans.poses))
    for width in REFINEMENTS:
        surfaces = fit_surfaces(replace(scans, poses=poses))
        moved = np.empty_like(poses[even])
        align(surfaces, scans.ranges[even], scans.angles, poses[even], width, moved, np.empty(len(moved)))
        poses[even] = moved
    placed = replace(scans, poses=poses)
    surfaces = fit_surfaces(placed)
    for width in (*REFINEMENTS[:-1], WIDTH):
        moved, found = np.empty_like(poses[~even]), np.empty(int((~even).sum()))
        align(surfaces, scans.ranges[~even], scans.angles, poses[~even], width, moved, found)
        poses[~even], share[~even] = moved, found
    placed = replace(scans, poses=poses)
    beams = expected_beams(map_of(placed), surfaces, placed)
    used = ~even & (share >= LOCALIZED)
    with np.errstate(invalid="ignore"):
        residual = scans.ranges - beams.ranges
    return LogComparison(placed, beams, surfaces, used, beams.flat & used[:, None], residual)


def simulate_scans(real: LogComparison, start: FloatArray, noise: LidarNoise, seed: int) -> LogScans:
    """Return the scans that a lidar with `noise` measures at the matched poses.

    Args:
        real: comparison of the log.
        start: (n, 3) first poses, from which the matching begins as it did for the log.
        noise: Noise of the simulated lidar.
        seed: Seed of the noise.
    """
    drawn = noisy_ranges(real.beams.ranges, real.scans.range_max, noise, seed)
    return replace(real.scans, ranges=drawn.astype(np.float64), poses=start)


def noisy_ranges(exact: FloatArray, range_max: float, noise: LidarNoise, seed: int) -> Float32Array:
    """Return exact ranges (n, beams) as a lidar measures them, meters; inf = no wall."""
    rng = np.random.default_rng(seed)
    ranges = np.empty(exact.shape, np.float32)
    for k, row in enumerate(exact):
        measure(row, *draw_noise(noise, len(row), rng), (0.0, range_max), noise.parameters, ranges[k])
    return ranges


def blocks_of(poses: FloatArray) -> IntArray:
    """Return (n,) the block of each pose (n, 3) along the path."""
    steps = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    along = np.concatenate(([0.0], np.cumsum(steps)))
    blocks: IntArray = np.floor(along / BLOCK).astype(np.int64)
    return blocks


def scan_arrays(scans: Sequence[LaserScan], trajectory: Trajectory) -> LogScans:
    """Return scans of one laser as arrays, at the mapper's poses."""
    stamps = np.array([scan.stamp for scan in scans])
    x, y, yaw = trajectory.planar_at(stamps).T
    base = Trajectory.from_poses(stamps, map(Pose2, x.tolist(), y.tolist(), yaw.tolist()))
    poses = laser_poses(base, scans)
    ranges = np.stack([np.where(scan.hits, scan.ranges.astype(np.float64), np.inf) for scan in scans])
    reach = max(scan.limits[1] for scan in scans)
    return LogScans(ranges, scans[0].angles, poses, blocks_of(poses), reach)


def laser_poses(base: Trajectory, scans: Sequence[LaserScan]) -> FloatArray:
    """Return (n, 3) planar poses of the laser from those of the base."""
    mounts = (Pose2(s.T_base_laser.x, s.T_base_laser.y, s.T_base_laser.yaw) for s in scans)
    return np.array([(base.pose2(k) @ mount).as_array() for k, mount in enumerate(mounts)])
