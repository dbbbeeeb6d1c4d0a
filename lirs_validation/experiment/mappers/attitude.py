"""What a mapper is told of the robot's attitude."""

from __future__ import annotations

from lirs_validation.config import Attitude
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.scan import Imu, LaserScan
from lirs_wct.geometry.trajectory import Trajectory
from slam_baselines.mapper import Mapper, MapperStats, requires_odometry


def with_attitude(mapper: Mapper, attitude: Attitude) -> Mapper:
    """Return the mapper itself (`imu`), or one that never learns how the robot is tilted (`none`)."""
    return mapper if attitude == "imu" else WithoutAttitude(mapper)


class WithoutAttitude:
    """A mapper that is given no inertial reading at all: None, as on a robot without an IMU.

    A reading less its roll and pitch would not do: its accelerations have the direction of gravity, its
    rates add up to the attitude, and zeros would say that the robot is level. The gyro's heading is in the
    odometry, which the mapper keeps.
    """

    def __init__(self, mapper: Mapper) -> None:
        """Take the attitude from a mapper."""
        self._mapper = mapper
        self.requires_odometry = requires_odometry(mapper)

    def update(self, scan: LaserScan, odometry: Pose2 | None, imu: Imu | None) -> Pose2:
        """Hand over scan and odometry; return the mapper's answer."""
        return self._mapper.update(scan, odometry, None)

    def map(self) -> OccupancyGrid:
        """Return the mapper's map."""
        return self._mapper.map()

    def trajectory(self) -> Trajectory:
        """Return the mapper's trajectory."""
        return self._mapper.trajectory()

    @property
    def stats(self) -> MapperStats:
        """What the mapper counted."""
        return self._mapper.stats

    @property
    def lost(self) -> bool:
        """Whether the mapper does not know its place."""
        return self._mapper.lost
