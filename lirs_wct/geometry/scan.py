"""Sensor readings: the planar laser scan and the inertial reading."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from lirs_wct.arrays import BoolArray, Float32Array, FloatArray
from lirs_wct.display import ShownAsPicture
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.pose import Pose3

NEAREST, FARTHEST = 0.001, 300.0
"""Smallest and largest range that counts, meters; a map must not grow by a wrong reading, nor by infinity."""


@dataclass(frozen=True, slots=True)
class LaserScan(ShownAsPicture):
    """One sweep of a planar laser range finder, after ROS `sensor_msgs/LaserScan` and REP 117.

    Attributes:
        ranges: (n,) float32 meters. +inf = nothing in range, -inf = too near, NaN = invalid.
        angle_min: angle of the first beam about the sensor's z, radians, counter-clockwise from its x.
        angle_increment: angle between beams, radians.
        range_min: smallest range that the sensor measures, meters.
        range_max: largest range that the sensor measures, meters.
        stamp: time of the first beam, seconds.
        T_base_laser: pose of the sensor on the robot.
        time_increment: time between beams, seconds; 0 = all at once.

    Raises:
        ConfigError: ranges are not a vector of float32, or angles are not finite.
    """

    ranges: Float32Array
    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float
    stamp: float
    T_base_laser: Pose3 = field(default_factory=Pose3)
    time_increment: float = 0.0

    def __post_init__(self) -> None:
        if self.ranges.ndim != 1 or self.ranges.dtype != np.float32:
            raise ConfigError(
                f"ranges must be a vector of float32, got {self.ranges.dtype} {self.ranges.shape}"
            )
        if not math.isfinite(self.angle_min + self.angle_increment + self.time_increment):
            raise ConfigError(
                f"angles and times of beams must be finite, got {self.angle_min}, {self.angle_increment}, "
                f"{self.time_increment}"
            )

    def __repr__(self) -> str:
        fov = np.degrees(self.angle_increment * (len(self.ranges) - 1))
        reach = f"{self.range_min:g} to {self.range_max:g} m"
        beams, hits = len(self.ranges), self.hits.sum()
        return f"LaserScan({beams} beams over {fov:.4g} deg, {reach}, {hits} hits, stamp {self.stamp:g} s)"

    @property
    def angles(self) -> FloatArray:
        """(n,) beam angles in the sensor frame, radians."""
        return self.angle_min + self.angle_increment * np.arange(len(self.ranges), dtype=np.float64)

    @property
    def limits(self) -> tuple[float, float]:
        """Smallest and largest range of a hit, meters, finite."""
        return max(NEAREST, self.range_min), min(FARTHEST, self.range_max)

    @property
    def hits(self) -> BoolArray:
        """(n,) whether each beam has a return within the sensor's range."""
        nearest, farthest = self.limits
        return (self.ranges >= nearest) & (self.ranges <= farthest)

    @property
    def points(self) -> FloatArray:
        """(hits, 3) end points of the beams with a return, sensor frame, meters."""
        hits = self.hits
        ranges, angles = self.ranges[hits].astype(np.float64), self.angles[hits]
        return np.column_stack((ranges * np.cos(angles), ranges * np.sin(angles), np.zeros_like(ranges)))


@dataclass(frozen=True, slots=True)
class Imu:
    """An inertial reading in the base frame, without yaw, which needs a compass.

    Attributes:
        roll: attitude about x (fixed axes, REP 103), radians.
        pitch: attitude about y, radians; positive = nose down.
        angular_velocity: rates about x, y, z of the base, rad/s.
        linear_acceleration: specific force along x, y, z of the base, m/s^2 (+9.81 on z at rest).
        stamp: seconds.
    """

    roll: float = 0.0
    pitch: float = 0.0
    angular_velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    linear_acceleration: tuple[float, float, float] = (0.0, 0.0, 9.81)
    stamp: float = 0.0

    @property
    def row(self) -> tuple[float, ...]:
        """The reading as nine numbers: stamp, roll, pitch, rates (3), specific force (3)."""
        return (self.stamp, self.roll, self.pitch, *self.angular_velocity, *self.linear_acceleration)

    @staticmethod
    def from_row(stamp: float, roll: float, pitch: float, *vectors: float) -> Imu:
        """Build a reading from the nine numbers of `row`."""
        p, q, r, x, y, z = vectors
        return Imu(roll, pitch, (p, q, r), (x, y, z), stamp)


@dataclass(frozen=True, eq=False, slots=True)
class ImuReadings:
    """Inertial readings in the base frame, without attitude; each is the mean over its interval.

    Attributes:
        stamps: (n,) ends of the intervals, seconds.
        angular_velocity: (n, 3) rates about x, y, z of the base, rad/s.
        linear_acceleration: (n, 3) specific force along x, y, z of the base, m/s^2.
        rate_sigma: standard deviation of the white noise of each rate, rad/s.
        acceleration_sigma: standard deviation of the white noise of each acceleration, m/s^2.
    """

    stamps: FloatArray
    angular_velocity: FloatArray
    linear_acceleration: FloatArray
    rate_sigma: float = 0.0
    acceleration_sigma: float = 0.0

    def __len__(self) -> int:
        return len(self.stamps)

    def between(self, after: float, until: float) -> ImuReadings:
        """Return the readings with `after` < stamp <= `until`, seconds."""
        some = slice(*np.searchsorted(self.stamps, (after, until), side="right"))
        rates, force = self.angular_velocity[some], self.linear_acceleration[some]
        return replace(self, stamps=self.stamps[some], angular_velocity=rates, linear_acceleration=force)
