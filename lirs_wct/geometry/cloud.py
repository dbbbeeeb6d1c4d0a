"""One sweep of a lidar with rings as a point cloud."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lirs_wct.arrays import Float32Array
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.pose import Pose3

RingArray = NDArray[np.uint16]


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

    Raises:
        ConfigError: shapes or types differ from these.
    """

    xyz: Float32Array
    ring: RingArray
    time: Float32Array
    stamp: float
    T_base_laser: Pose3 = field(default_factory=Pose3)

    def __post_init__(self) -> None:
        n = len(self.xyz)
        required = ("float32", (n, 3)), ("uint16", (n,)), ("float32", (n,))
        found = tuple((str(a.dtype), a.shape) for a in (self.xyz, self.ring, self.time))
        if found != required:
            got = ", ".join(f"{dtype} {shape}" for dtype, shape in found)
            raise ConfigError(f"a cloud needs float32 (n, 3), uint16 (n,), float32 (n,), got {got}")

    def __len__(self) -> int:
        return len(self.xyz)

    @property
    def rolling(self) -> bool:
        """Whether the points were measured one column after the other, and not all at once."""
        return len(self) > 0 and bool(self.time.max() > self.time.min())
