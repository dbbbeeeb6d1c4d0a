"""Ranges and poses that no sensor should give: no compiled loop leaves its arrays, no map grows by them."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from lirs_extensions.search.twin.surface import fit_surfaces, scan_arrays
from lirs_validation.metrics.mapped_log import scan_consistency
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.pose import Pose2, Trajectory
from lirs_wct.geometry.scan import Imu, LaserScan
from slam_baselines.front_end import KnownPoseMapper
from slam_baselines.mapper import MAPPERS, make_mapper

HOSTILE = np.array([math.inf, math.nan, 0.0, -1.0, -math.inf, 3e3, 1e6, 3e38, 1e-30], np.float32)
LIMITS = [(math.inf, 0.0), (math.nan, 0.0), (3e38, math.nan), (0.0, -math.inf), (1e6, -1.0)]


def scans(range_max: float, range_min: float, n: int = 12) -> list[LaserScan]:
    """Return scans of a room of 6 x 4 m, of which a third of the beams is hostile."""
    rng, angles = np.random.default_rng(0), np.linspace(-math.pi, math.pi, 181)
    x, y = np.maximum(np.abs([np.cos(angles), np.sin(angles)]), 1e-9)
    walls = np.minimum(3 / x, 2 / y)
    return [
        LaserScan(
            np.where(rng.uniform(size=181) < 0.3, rng.choice(HOSTILE, 181), walls).astype(np.float32),
            -math.pi,
            math.radians(2),
            range_min,
            range_max,
            0.1 * k,
        )
        for k in range(n)
    ]


def mapper(name: str) -> Any:
    if name == "known poses":
        return KnownPoseMapper(0.05)
    return make_mapper(name, **({"particles": 3} if name == "gmapping" else {}))


@pytest.mark.parametrize("name", ["known poses", *MAPPERS])
@pytest.mark.parametrize(("range_max", "range_min"), LIMITS)
def test_mappers_survive(name: str, range_max: float, range_min: float) -> None:
    made = mapper(name)
    for k, scan in enumerate(scans(range_max, range_min)):
        made.update(scan, Pose2(0.03 * k, 0.0, 0.02 * k), Imu(0.01, 0.02, stamp=scan.stamp))
    assert max(made.map().shape) * made.map().resolution < 700


@pytest.mark.parametrize(("range_max", "range_min"), LIMITS)
def test_metrics_survive(range_max: float, range_min: float) -> None:
    read = scans(range_max, range_min, 60)
    trajectory = Trajectory.from_poses([s.stamp for s in read], [Pose2(0.03 * k) for k in range(60)])
    readings: list[Imu | None] = [None] * len(read)
    scan_consistency(read, readings, trajectory)
    if range_max:  # a log without any hit is refused
        fit_surfaces(scan_arrays(read, trajectory))
    assert all(scan.hits.sum() == 0 or scan.points.max() <= 300 for scan in read)


MOTIONS: list[Callable[[], tuple[Pose2, Imu | None]]] = [
    lambda: (Pose2(math.nan), None),
    lambda: (Pose2(0, math.inf), None),
    lambda: (Pose2(), Imu(math.nan)),
    lambda: (Pose2(), Imu(angular_velocity=(0.0, 0.0, math.nan))),
]


@pytest.mark.parametrize("name", MAPPERS)
@pytest.mark.parametrize("motion", MOTIONS)
def test_motion_that_is_not_finite_is_refused(
    name: str, motion: Callable[[], tuple[Pose2, Imu | None]]
) -> None:
    odometry, imu = motion()
    with pytest.raises(ConfigError, match="odometry and inertial readings must be finite"):
        mapper(name).update(scans(10.0, 0.1, 1)[0], odometry, imu)


@pytest.mark.parametrize("field", ["angle_min", "angle_increment", "time_increment"])
def test_angles_are_finite(field: str) -> None:
    given = {"angle_min": 0.0, "angle_increment": 0.1, "range_min": 0.1, "range_max": 9.0, "stamp": 0.0}
    with pytest.raises(ConfigError, match="angles and times of beams must be finite"):
        LaserScan(np.ones(3, np.float32), **{**given, field: math.nan})
