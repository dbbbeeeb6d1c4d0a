"""Sensor readings: planar laser scan, point cloud of a lidar with rings, inertial reading."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lirs_wct.arrays import BoolArray, Float32Array, FloatArray, IntArray
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


IndexArray = NDArray[np.uint16]
POINT = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("ring", "<u2"), ("time", "<f4")],
    align=True,
)
"""A point with the names and types of Velodyne's driver."""


@dataclass(frozen=True, slots=True)
class PointCloud:
    """One sweep of a lidar with rings, after ROS `sensor_msgs/PointCloud2` as Velodyne's driver fills it.

    Beams without return have no point. Each point is in the sensor's frame at the time of its measurement.
    With times above 0, the robot's motion skews the sweep.

    Attributes:
        xyz: (n, 3) float32 meters in the sensor's frame, x ahead, z up; finite. Ring by ring from below,
            counter-clockwise in each.
        ring: (n,) uint16 ring of each point, 0 = the lowest.
        time: (n,) float32 seconds from `stamp` until the point was measured; all 0 = all at once.
        stamp: time of the first column of beams, seconds.
        T_base_laser: pose of the sensor on the robot.
        intensity: (n,) float32 strength of the return, 0 to 255; None = unknown.
        column: (n,) uint16 column of beams of each point; None = the cloud is not organized.
        shape: rings and columns of the sweep with its beams without return; (0, 0) = not organized.

    Raises:
        ConfigError: shapes or types differ from these.
    """

    xyz: Float32Array
    ring: IndexArray
    time: Float32Array
    stamp: float
    T_base_laser: Pose3 = field(default_factory=Pose3)
    intensity: Float32Array | None = None
    column: IndexArray | None = None
    shape: tuple[int, int] = (0, 0)

    def __post_init__(self) -> None:
        n = len(self.xyz)
        required = [("float32", (n, 3)), ("uint16", (n,)), ("float32", (n,))]
        arrays: list[NDArray[Any]] = [self.xyz, self.ring, self.time]
        for array, dtype in ((self.intensity, "float32"), (self.column, "uint16")):
            if array is not None:
                required.append((dtype, (n,)))
                arrays.append(array)
        found = [(str(a.dtype), a.shape) for a in arrays]
        if found != required:
            need, got = (", ".join(f"{d} {s}" for d, s in each) for each in (required, found))
            raise ConfigError(f"a cloud of {n} points needs {need}, got {got}")
        if self.column is not None and n:
            size = int(self.ring.max()) + 1, int(self.column.max()) + 1
            if size[0] > self.shape[0] or size[1] > self.shape[1]:
                raise ConfigError(f"a cloud of {size} rings and columns does not fit the shape {self.shape}")

    def __len__(self) -> int:
        return len(self.xyz)

    @property
    def rolling(self) -> bool:
        """Whether the points were measured one column after the other, and not all at once."""
        return len(self) > 0 and bool(self.time.max() > self.time.min())

    def select(self, points: BoolArray | IntArray) -> PointCloud:
        """Return the cloud of some points: a mask (n,), or their numbers."""
        return replace(
            self,
            xyz=self.xyz[points],
            ring=self.ring[points],
            time=self.time[points],
            intensity=None if self.intensity is None else self.intensity[points],
            column=None if self.column is None else self.column[points],
        )

    def by_time(self) -> PointCloud:
        """Return the points in the order of their times, not organized."""
        return replace(self.select(np.argsort(self.time, kind="stable")), column=None, shape=(0, 0))

    def records(self) -> NDArray[Any]:
        """Return the points (n,) as POINT; an unknown intensity is 0."""
        points = np.zeros(len(self), POINT)
        points["x"], points["y"], points["z"] = self.xyz.T
        points["ring"], points["time"] = self.ring, self.time
        if self.intensity is not None:
            points["intensity"] = self.intensity
        return points

    def organized(self) -> NDArray[Any]:
        """Return all beams (rings, columns) as POINT.

        x, y and z of beams without return are NaN.

        Raises:
            ConfigError: the cloud is not organized.
        """
        if self.column is None:
            raise ConfigError("the cloud is not organized: the columns of its points are unknown")
        points = np.zeros(self.shape, POINT)
        for axis in "xyz":
            points[axis] = np.nan
        rows, columns = np.indices(self.shape, dtype=np.uint16)
        points["ring"] = rows
        if self.rolling:
            last = int(self.column.argmax())
            points["time"] = columns * (float(self.time[last]) / float(self.column[last]))
        points[self.ring, self.column] = self.records()
        return points
