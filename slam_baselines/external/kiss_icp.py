"""KISS-ICP and GenZ-ICP, which extends it, in the authors' packages.

Vizzo et al., "KISS-ICP: In Defense of Point-to-Point ICP" (RA-L 2023); Lee et al., "GenZ-ICP: Generalizable
and Degeneracy-Robust LiDAR Odometry Using an Adaptive Weighting" (RA-L 2025).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from lirs_wct.arrays import FloatArray
from lirs_wct.field_validators import require_above, require_at_least
from slam_baselines.external.cloud_odometry import CloudOdometry


@dataclass(frozen=True, kw_only=True)
class KissIcpConfig:
    """Configurable parameters of KISS-ICP; the defaults are the authors'.

    Attributes:
        max_range: points beyond are left out, meters.
        min_range: points nearer are left out, meters.
        voxel_size: edge of the map's voxels, meters; None = `max_range` / 100, as the authors do.
        threads: of the registration; 1 = as every other mapper here, 0 = all.

    Raises:
        ConfigError: a value is not legal.
    """

    mapper: ClassVar[str] = "kiss-icp"
    max_range: float = 100.0
    min_range: float = 0.0
    voxel_size: float | None = None
    threads: int = 1

    def __post_init__(self) -> None:
        require_above(self, 0, "max_range", of=self.mapper, unit="m", finite=True)
        require_at_least(self, 0, "min_range", "threads", of=self.mapper)
        if self.voxel_size is not None:
            require_above(self, 0, "voxel_size", of=self.mapper, unit="m", finite=True)


def make_kiss_icp(config: KissIcpConfig) -> CloudOdometry:
    """Return KISS-ICP as a mapper."""
    from kiss_icp.config import KISSConfig
    from kiss_icp.kiss_icp import KissICP

    settings = KISSConfig()
    configure(settings.data, settings.mapping, settings.registration, config)
    odometry = KissICP(settings)

    def register(points: FloatArray, times: FloatArray) -> FloatArray:
        odometry.register_frame(points, times)
        return pose_at_start(odometry, times)

    return CloudOdometry(register)


def configure(data: Any, mapping: Any, registration: Any, config: KissIcpConfig) -> None:
    """Fill in the parts of KISS-ICP's configuration, in place."""
    data.max_range, data.min_range = config.max_range, config.min_range
    mapping.voxel_size = config.max_range / 100 if config.voxel_size is None else config.voxel_size
    registration.max_num_threads = config.threads


def pose_at_start(odometry: Any, times: FloatArray) -> FloatArray:
    """Return the (4, 4) pose of the sensor when the last sweep began.

    KISS-ICP's pose is that of the last point: a rolling sweep began one motion earlier.
    """
    pose: FloatArray = odometry.last_pose
    return pose if len(times) == 0 else pose @ np.linalg.inv(odometry.last_delta)


@dataclass(frozen=True, kw_only=True)
class GenzIcpConfig:
    """Configurable parameters of GenZ-ICP; the defaults are the authors'.

    Its native code sums in another order each time: two runs of the same clouds differ by millimeters.

    Attributes:
        max_range: points beyond are left out, meters.
        min_range: points nearer are left out, meters.
        voxel_size: edge of the map's voxels at the start, meters; the method adapts it.

    Raises:
        ConfigError: a value is not legal.
    """

    max_range: float = 100.0
    min_range: float = 0.3
    voxel_size: float = 0.3

    def __post_init__(self) -> None:
        require_above(self, 0, "max_range", "voxel_size", of="genz-icp", unit="m", finite=True)
        require_at_least(self, 0, "min_range", of="genz-icp", unit="m")


def make_genz_icp(config: GenzIcpConfig) -> CloudOdometry:
    """Return GenZ-ICP as a mapper; like the authors' program, it ignores times in a sweep."""
    from genz_icp.config import GenZConfig
    from genz_icp.genz_icp import GenZICP

    settings = GenZConfig()
    settings.data.max_range, settings.data.min_range = config.max_range, config.min_range
    settings.mapping.voxel_size = config.voxel_size
    odometry = GenZICP(settings)

    def register(points: FloatArray, times: FloatArray) -> FloatArray:
        odometry.register_frame(points, np.empty(0))
        pose: FloatArray = odometry.last_pose.copy()
        return pose

    return CloudOdometry(register)
