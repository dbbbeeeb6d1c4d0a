"""Elevation maps of a drive's point clouds, and the clouds kept for them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from lirs_validation.metrics.alignment import associated
from lirs_validation.metrics.elevation import (
    ElevationMap,
    ElevationScores,
    elevation_map,
    elevation_scores,
)
from lirs_validation.metrics.trajectory import spatial_alignment
from lirs_wct.arrays import BoolArray, FloatArray
from lirs_wct.geometry.cloud import PointCloud
from lirs_wct.geometry.pose import Pose3
from lirs_wct.geometry.trajectory import Trajectory
from lirs_wct.world import World

NARROW = 0.1
"""A path whose width is a smaller share of its length does not say how it is turned about itself."""


@dataclass(frozen=True)
class Elevations:
    """Elevation maps of a run in the world frame, on one grid.

    Attributes:
        built: by the mapper's poses, moved by the true start pose.
        true_pose: by the true poses.
    """

    built: ElevationMap
    true_pose: ElevationMap


def evaluate_elevation(
    world: World, sample: CloudSample, truth: Trajectory, estimate: Trajectory
) -> tuple[Elevations | None, ElevationScores]:
    """Return elevation maps and metrics of a run.

    A world with overhangs has none.

    Args:
        world: where it took place.
        sample: clouds that were kept.
        truth: true poses of all scans, world frame.
        estimate: the mapper's final poses, world frame (moved by the true start pose).
    """
    if world.overhangs:
        return None, ElevationScores(
            elevation_rmse=None,
            elevation_rmse_aligned=None,
            elevation_seen=None,
            reference_elevation_rmse=None,
        )
    bounds = _bounds(world, sample, truth)
    made = Elevations(
        elevation_map(_place_clouds(sample, truth, estimate), bounds),
        elevation_map(_place_clouds(sample, truth, truth), bounds),
    )
    T = _alignment(truth, estimate)
    aligned = None if T is None else elevation_map(_place_clouds(sample, truth, estimate.moved(T)), bounds)
    scores = elevation_scores(made.built, made.true_pose, aligned, surface=world.surface, walls=world.walls)
    return made, scores


def _place_clouds(sample: CloudSample, truth: Trajectory, poses: Trajectory) -> Iterator[FloatArray]:
    """Yield the points (n, 3) of each cloud, placed by its pose.

    Clouds without a pose at their stamp are left out.
    """
    i, j = associated(truth.stamps[sample.scans], poses.stamps)
    for k, pose in zip(i.tolist(), j.tolist(), strict=True):
        cloud = sample.clouds[k]
        T_world_base = Pose3.from_arrays(poses.positions[pose], poses.quaternions[pose])
        yield (T_world_base @ cloud.T_base_laser).apply(cloud.xyz)


def _bounds(world: World, sample: CloudSample, truth: Trajectory) -> tuple[float, float, float, float]:
    """Return west, south, east, north of the world in the clouds' reach, meters."""
    reach = max((float(np.linalg.norm(c.xyz, axis=1).max()) for c in sample.clouds if len(c)), default=0.0)
    west, south, east, north = world.surface.bounds
    low, high = truth.xy.min(axis=0) - reach, truth.xy.max(axis=0) + reach
    return max(west, low[0]), max(south, low[1]), min(east, high[0]), min(north, high[1])


def _alignment(truth: Trajectory, estimate: Trajectory) -> Pose3 | None:
    """Return the spatial alignment of the estimate with the truth.

    None if the path leaves a rotation undetermined.
    """
    i, j = associated(truth.stamps, estimate.stamps)
    if len(i) < 3:
        return None
    true = truth.positions[i]
    spread = np.linalg.svd(true - true.mean(axis=0), compute_uv=False)
    if spread[1] < NARROW * spread[0]:
        return None
    return spatial_alignment(estimate.positions[j], true)


MOST = 240
"""Clouds that are kept at a time, some 100 MB of them; beyond, every second one is dropped."""


@dataclass
class CloudSample:
    """Sample of clouds spread evenly over a drive.

    One per second; fewer on longer drives.

    Attributes:
        clouds: that are kept, without the points on walkers.
        scans: number of the scan that each belongs to.
        period: seconds from one to the next.
    """

    clouds: list[PointCloud] = field(default_factory=list)
    scans: list[int] = field(default_factory=list)
    period: float = 1.0

    def offer(self, scan: int, cloud: PointCloud, walkers: BoolArray | None = None) -> None:
        """Keep a cloud if it is due.

        Args:
            scan: its number; each larger than the last.
            cloud: of that scan.
            walkers: (n,) which of its points lie on a walker.
        """
        if self.clouds and cloud.stamp < self.clouds[-1].stamp + self.period - 1e-9:
            return
        self.clouds.append(cloud if walkers is None else without(cloud, walkers))
        self.scans.append(scan)
        if len(self.clouds) > MOST:
            self.clouds, self.scans, self.period = self.clouds[::2], self.scans[::2], 2 * self.period


def without(cloud: PointCloud, points: BoolArray) -> PointCloud:
    """Return a cloud without some of its points, (n,)."""
    kept = ~points
    return replace(cloud, xyz=cloud.xyz[kept], ring=cloud.ring[kept], time=cloud.time[kept])
