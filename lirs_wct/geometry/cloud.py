"""One sweep of a lidar with rings as a point cloud."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lirs_wct.arrays import BoolArray, Float32Array
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.pose import Pose3

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

    def select(self, points: BoolArray) -> PointCloud:
        """Return the cloud of some points, (n,)."""
        return replace(
            self,
            xyz=self.xyz[points],
            ring=self.ring[points],
            time=self.time[points],
            intensity=None if self.intensity is None else self.intensity[points],
            column=None if self.column is None else self.column[points],
        )

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
