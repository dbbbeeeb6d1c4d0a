"""RKO-LIO in the authors' package.

Malladi et al., "A Robust Approach for LiDAR-Inertial Odometry Without Sensor-Specific Modeling" (RA-L 2026).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from lirs_extensions.clouds.timed_odometry import TimedOdometry, TimedSystem, matrix_of
from lirs_wct.arrays import FloatArray
from lirs_wct.checks import Checked, limited
from lirs_wct.geometry import ImuReadings, PointCloud

BEGIN = 1.0
"""Seconds that are added to all stamps: RKO-LIO takes the time 0 for "not yet"."""


@dataclass(frozen=True, kw_only=True)
class RkoLioConfig(Checked, of="rko-lio"):
    """Configurable parameters of RKO-LIO; the defaults are the authors'.

    Attributes:
        max_range: points beyond are left out, meters.
        min_range: points nearer are left out, meters.
        voxel_size: edge of the map's voxels, meters.
        double_downsample: whether the scan is thinned twice, which the authors advise against for lidars
            with few rings.
        initialization_phase: whether gravity and biases come from the time between the first two sweeps, in
            which the robot must stand still; the authors' default is no.
        max_num_threads: Threads of the registration; 1 = as every other mapper here, 0 = all.
    """

    max_range: float = limited(100.0, "(0, inf)", "m")
    min_range: float = limited(1.0, "[0, inf]")
    voxel_size: float = limited(1.0, "(0, inf)", "m")
    double_downsample: bool = True
    initialization_phase: bool = True
    max_num_threads: int = limited(1, "[0, inf]")


class RkoLio(TimedSystem):
    """RKO-LIO as a `TimedSystem`; the inertial unit's frame is the base's."""

    inertial = True

    def __init__(self, config: RkoLioConfig) -> None:
        from rko_lio.config import LIOConfig
        from rko_lio.lio import LIO

        self._lio = LIO(LIOConfig(**asdict(config)))

    def add_readings(self, readings: ImuReadings) -> None:
        """Add inertial readings one by one."""
        stamps = nanoseconds(readings.stamps).tolist()
        rows = zip(readings.linear_acceleration, readings.angular_velocity, stamps, strict=True)
        for acceleration, rates, stamp in rows:
            self._lio.add_imu_measurement(acceleration, rates, stamp)

    def register(self, cloud: PointCloud) -> list[tuple[float, FloatArray]]:
        """Register a sweep; return the pose of its end."""
        times = cloud.stamp + cloud.time.astype(np.float64)
        self._lio.register_scan(cloud.xyz, nanoseconds(times), matrix_of(cloud.T_base_laser))
        return [(float(times.max()), self._lio.pose())]


def nanoseconds(stamps: FloatArray) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
    """Return stamps (n,) in seconds as RKO-LIO's times."""
    return np.rint((stamps + BEGIN) * 1e9).astype(np.int64)


def make_rko_lio(config: RkoLioConfig) -> TimedOdometry:
    """Return RKO-LIO as a mapper."""
    return TimedOdometry(RkoLio(config))
