"""Planar GMapping with the scan matcher and the defaults of OpenSLAM's program.

Grisetti, Stachniss, Burgard 2007, as the authors' program has it: particles are matched by a hill climb and
stay where it ends, and a processed scan is registered by its hits alone. No attitude, no ground filter: on
uneven ground hillsides are walls. With the random numbers of the original the same seed gives the
original's trajectory; readings are used as finely as a CARMEN log holds them, so that a run and its
recorded log give the same too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from lirs_extensions.originals.gmapping.hit_maps import HitMaps, MatchingParameters, match_scan
from lirs_extensions.originals.hector import line_cells
from lirs_wct.arrays import BoolArray, FloatArray, njit
from lirs_wct.errors import Checked, limited
from lirs_wct.geometry import Imu, LaserScan, OccupancyGrid, Pose2, Trajectory, compose_poses, wrap_angle
from slam_baselines.front_end import KeyframeTrajectory
from slam_baselines.gmapping.particles import Particles, normalize
from slam_baselines.mapper import MapperStats, PlanarMapper
from slam_baselines.occupancy_map import GrowingGrid

MILLIMETER, MICROMETER = 3, 6
"""Decimals of a range and of a position in a CARMEN log."""
HEADING = 8
"""Decimals of a heading in a CARMEN log, radians."""
BEAM = 6
"""Decimals of a beam's angle, degrees: the original's table of beams is in whole or half degrees."""
WARM_UP = {"resampleThreshold": 1.0}
"""Configuration with which a short drive reaches every kernel: particles are resampled at every scan."""


@dataclass(frozen=True, kw_only=True)
class GmappingOriginalConfig(Checked, of="gmapping_original"):
    """Parameters of OpenSLAM's GMapping with its defaults.

    Attributes:
        particles: number of paths.
        seed: Seed of the random numbers, as for the C library's `srand48`.
        linearUpdate: meters to drive before the next scan is processed.
        angularUpdate: radians to turn before the next scan is processed.
        resampleThreshold: particles are resampled when N_eff falls below this share of them.
        srr: error of the odometry in translation after one meter, meters.
        srt: error of the odometry in rotation after one meter, radians.
        str: error of the odometry in translation after one radian, meters.
        stt: error of the odometry in rotation after one radian, radians.
        sigma: Variance in the matcher's score, square meters.
        kernelSize: cells around the end of a beam in which the matcher looks for hits.
        lstep: first step of the matcher in x and y, meters.
        astep: first step of the matcher in yaw, radians.
        iterations: how often the steps are halved.
        lsigma: Variance in the likelihood, square meters.
        ogain: likelihoods are taken to the power 1 / (ogain * particles).
        delta: edge of a map's cell, meters.
        maxrange: farther readings are not used, meters. A beam without return reads the lidar's largest
            range, as in a CARMEN log.
        maxUrange: farther readings are no hits, meters: free up to there.
        occ_thresh: share of hits among the beams through a cell above which it is occupied.
    """

    particles: int = limited(30, "(0, inf]")
    seed: int = 0
    linearUpdate: float = limited(1.0, "[0, inf]")  # noqa: N815  the original's names
    angularUpdate: float = limited(0.5, "[0, inf]")  # noqa: N815
    resampleThreshold: float = limited(0.5, "[0, 1]")  # noqa: N815
    srr: float = limited(0.1, "[0, inf]")
    srt: float = limited(0.2, "[0, inf]")
    str: float = limited(0.1, "[0, inf]")
    stt: float = limited(0.2, "[0, inf]")
    sigma: float = limited(0.05, "(0, inf]")
    kernelSize: int = limited(1, "[0, inf]")  # noqa: N815
    lstep: float = limited(0.05, "(0, inf]")
    astep: float = limited(0.05, "(0, inf]")
    iterations: int = limited(5, "[1, inf]")
    lsigma: float = limited(0.075, "(0, inf]")
    ogain: float = limited(3.0, "(0, inf]")
    delta: float = limited(0.05, "(0, inf]")
    maxrange: float = limited(80.0, "(0, inf]", "m")
    maxUrange: float = limited(80.0, "(0, inf]", "m")  # noqa: N815
    occ_thresh: float = limited(0.25, "[0, 1)")

    @property
    def matching(self) -> MatchingParameters:
        """Parameters of the matcher."""
        return MatchingParameters(*(getattr(self, name) for name in MatchingParameters._fields))


class GmappingOriginalMapper(PlanarMapper):
    """Particle filter over paths, as published by its authors."""

    name = "gmapping_original"
    requires_odometry = True

    def __init__(self, config: GmappingOriginalConfig | None = None) -> None:
        super().__init__()
        self.config = config or GmappingOriginalConfig()
        self._particles = OriginalParticles(self.config)
        self._scans = KeyframeTrajectory()
        self._kept: list[ProcessedScan] = []
        self._odometry: Pose2 | None = None
        self._processed_at = self._best = Pose2()
        self._distance = self._turn = 0.0

    def process(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        """Move the particles by the odometry, process the scan if due; return `T_map_base`."""
        assert odometry is not None, "it is required"
        now, c = _logged_pose(odometry), self.config
        before, self._odometry = self._odometry or now, now
        self._particles.move(before.inverse() @ now)
        self._distance += before.distance(now)
        self._turn += abs(wrap_angle(now.yaw - before.yaw))
        if not self._kept or self._distance >= c.linearUpdate or self._turn >= c.angularUpdate:
            increment = self._processed_at.inverse() @ now if self._kept else Pose2()
            self._kept.append(kept := _usable(scan, c.maxrange, c.maxUrange))
            self._particles.process_scan(kept.ends[kept.hits], increment)
            self._best, self._processed_at = self._particles.pose, now
            self._distance = self._turn = 0.0
        increment = self._processed_at.inverse() @ now
        self._scans.add(scan.stamp, len(self._kept) - 1, increment)
        return self._best @ increment

    def map(self) -> OccupancyGrid:
        """Return the map along the best particle's path."""
        c = self.config
        return path_map(self._particles.path, self._kept, c.delta, c.occ_thresh)

    def trajectory(self) -> Trajectory:
        """Return the pose of every scan: the best particle's path, and the odometry in between."""
        return self._scans.trajectory([Pose2(*pose) for pose in self._particles.path.tolist()])

    def counts(self) -> MapperStats:
        """Return used and skipped scans, memory and other counts."""
        particles, processed = self._particles, len(self._kept)
        return MapperStats(
            used=processed,
            skipped={"not moved": self.received - processed},
            memory=particles.maps.nbytes + sum(s.ends.nbytes + s.hits.nbytes for s in self._kept),
            counts={
                "particles": self.config.particles,
                "resamplings": particles.resamplings,
                "patches": particles.maps.in_use,
            },
        )


class OriginalParticles(Particles[HitMaps]):
    """Particles with noisy motion, matched by a hill climb against maps of hits."""

    def __init__(self, config: GmappingOriginalConfig) -> None:
        super().__init__(HitMaps(config.particles, config.delta))
        self._config = config
        self._rng = Drand48(config.seed)

    @property
    def path(self) -> FloatArray:
        """(generations, 3) poses of the best particle at the processed scans."""
        return self.tree.path(self.best_leaf)

    def move(self, delta: Pose2) -> None:
        """Move every particle by the odometry since the last scan, with independent noise."""
        c, x, y, turn = self._config, abs(delta.x), abs(delta.y), abs(delta.yaw)
        across = 0.3 * c.srr
        sigma = np.array(
            (
                c.srr * x + c.str * turn + across * y,
                c.srr * y + c.str * turn + across * x,
                c.stt * turn + c.srt * float(np.hypot(x, y)),
            )
        )
        noise = np.zeros((len(self._poses), 3))
        # The original draws no number where there is nothing to scatter.
        scattered = sigma > 0
        noise[:, scattered] = self._rng.standard_normal((len(noise), int(scattered.sum()))) * sigma[scattered]
        self._poses = compose_poses(self._poses, delta.as_array() + noise)

    def process_scan(self, ends: FloatArray, increment: Pose2) -> None:
        """Match and weigh, resample where due, and register the scan.

        The ends of beams (n, 2) are in the base frame, meters; `T_processed_now` is by odometry.
        """
        c = self._config
        if self.tree.generations:
            for k, expected in enumerate(self._poses):
                self._poses[k], log_likelihood = match_scan(self.maps[k], expected, ends, c.matching)
                self._log_weights[k] += log_likelihood
                self._totals[k] += log_likelihood
            gain = 1 / (c.ogain * len(self._poses))
            self.resample(normalize(gain * self._log_weights), c.resampleThreshold, self._rng)
        self.maps.register_scan(self._poses, ends)
        self.add_generation(increment)


def _logged_pose(pose: Pose2) -> Pose2:
    return Pose2(round(pose.x, MICROMETER), round(pose.y, MICROMETER), round(pose.yaw, HEADING))


def _usable(scan: LaserScan, maxrange: float, max_urange: float) -> ProcessedScan:
    """Return the usable beams, rounded as in a CARMEN log."""
    most = round(scan.range_max, MILLIMETER)
    ranges = np.round(scan.ranges.astype(np.float64), MILLIMETER)
    ranges[scan.ranges == np.inf] = most
    known = np.isfinite(ranges) & (ranges > 0) & (ranges <= maxrange)
    r = ranges[known]
    angles = np.radians(np.round(np.degrees(scan.angles[known]), BEAM))
    mount = _logged_pose(scan.T_base_laser.to_pose2())
    hits = r <= max_urange
    ends: FloatArray = mount.apply(
        np.minimum(r, max_urange)[:, None] * np.stack((np.cos(angles), np.sin(angles)), axis=-1)
    )
    return ProcessedScan(np.array((mount.x, mount.y)), ends, hits)


class ProcessedScan(NamedTuple):
    """Processed scan: laser (2,) and ends of beams (n, 2), base frame, meters.

    An end is a hit (n,), or a long beam leaves the usable range there.
    """

    laser: FloatArray
    ends: FloatArray
    hits: BoolArray


def path_map(
    path: FloatArray, scans: Sequence[ProcessedScan], delta: float, occ_thresh: float
) -> OccupancyGrid:
    """Draw scans at their poses (n, 3) of `T_map_base`; cells are known as in slam_gmapping.

    A cell is occupied above the share `occ_thresh` of hits among the beams through it.
    """
    grid = GrowingGrid(delta, {"hits": (np.int32, 0), "visits": (np.int32, 0)})
    for pose, scan in zip(path.tolist(), scans, strict=True):
        T_map_base = Pose2(*pose)
        points = np.vstack((T_map_base.apply(scan.laser[None]), T_map_base.apply(scan.ends)))
        grid.ensure(*points.min(axis=0), *points.max(axis=0))
        # Cell (0, 0) has its center in the origin, as in the maps that are matched against.
        cells = np.floor(points / delta + 0.5).astype(np.int64) - (grid.col0, grid.row0)
        _draw(grid.layers["hits"], grid.layers["visits"], cells, scan.hits)
    hits, visits = grid.layers["hits"], grid.layers["visits"]
    p = np.where(visits > 0, hits > occ_thresh * visits, np.nan)
    log_odds = OccupancyGrid.from_probability(p, delta).log_odds
    return OccupancyGrid.of_lattice(log_odds, delta, grid.row0 - 0.5, grid.col0 - 0.5)


@njit
def _draw(hits: Any, visits: Any, cells: Any, is_hit: Any) -> None:
    """Count the beams from cells[0] to all others, each (col, row)."""
    for k in range(1, len(cells)):
        for row, col in line_cells(cells[0, 1], cells[0, 0], cells[k, 1], cells[k, 0]):
            visits[row, col] += 1
        if is_hit[k - 1]:
            row, col = cells[k, 1], cells[k, 0]
            visits[row, col] += 1
            hits[row, col] += 1


MULTIPLIER, INCREMENT, MASK = np.uint64(0x5DEECE66D), np.uint64(0xB), np.uint64((1 << 48) - 1)
"""Of the linear congruential generator (POSIX)."""
LOW = 0x330E
"""The low 16 bits of a seeded state (POSIX); the seed's 32 bits are above."""


class Drand48:
    """A stream of random numbers."""

    def __init__(self, seed: int) -> None:
        """Start as `srand48(seed)` does."""
        self._state = np.array([((seed & 0xFFFFFFFF) << 16) + LOW], np.uint64)

    def random(self) -> float:
        """Return the next number of the uniform distribution over [0, 1)."""
        return float(_uniform(self._state))

    def standard_normal(self, shape: tuple[int, ...]) -> FloatArray:
        """Return the next numbers of the standard normal distribution, in row order."""
        out = np.empty(shape)
        _fill_normal(self._state, out.reshape(-1))
        return out


@njit
def _uniform(state: Any) -> Any:
    state[0] = (state[0] * MULTIPLIER + INCREMENT) & MASK
    return np.float64(state[0]) / 281474976710656.0  # 2^48


@njit
def _fill_normal(state: Any, out: Any) -> None:
    """Fill `out` by Marsaglia's polar method; like the original, skip every second number."""
    for k in range(len(out)):
        while True:
            x = 2 * _uniform(state) - 1
            _uniform(state)
            y = 2 * _uniform(state) - 1
            w = x * x + y * y
            if 0 < w <= 1:
                break
        out[k] = y * np.sqrt(-2 * np.log(w) / w)
