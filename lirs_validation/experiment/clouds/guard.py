"""A guard before a mapper of point clouds, as `GuardedMapper` is before a planar one; who gets which."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import astuple, replace
from typing import cast

from lirs_envs.lidar.presets import RING_LIDARS, make_lidar_preset
from lirs_envs.robots.catalog import make_robot
from lirs_validation.config import DRIVERS, RunConfig, driver_parts
from lirs_validation.experiment.mappers.attitude import with_attitude
from lirs_validation.experiment.mappers.checks import kind_of
from lirs_validation.experiment.mappers.guard import GuardedMapper, MapperGuard, imu_copy, mapper_failure
from lirs_wct.errors import ConfigError, MapperError
from lirs_wct.geometry.cloud import PointCloud
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.pose import Pose3
from lirs_wct.geometry.scan import Imu
from slam_baselines.mapper import CloudMapper, Mapper, reads_clouds


class GuardedCloudMapper(MapperGuard):
    """A mapper that is handed read-only copies, and whose every failure becomes a `MapperError`.

    Args:
        mapper: that is guarded.
        name: what messages call it.
        attitude: whether it is given inertial readings.
    """

    reads_clouds = True
    _mapper: CloudMapper

    def __init__(self, mapper: CloudMapper, name: str, *, attitude: bool = True) -> None:
        super().__init__(mapper, name)
        self._attitude = attitude

    def update(self, cloud: PointCloud, imu: Imu | None) -> Pose3:
        """Hand over copies; return the mapper's answer, a finite pose.

        Raises:
            MapperError: the mapper fails, writes into what it was given, or answers with something else.
        """
        stamp = cloud.stamp
        try:
            estimate = self._mapper.update(cloud_copy(cloud), imu_copy(imu) if self._attitude else None)
        except BaseException as error:
            mapper_failure(self._name, "update()", error, f" for the scan at {stamp:.3f} s")
        check_pose3(estimate, stamp)
        return estimate


def guarded(mapper: Mapper | CloudMapper, config: RunConfig) -> GuardedMapper | GuardedCloudMapper:
    """Return the guard of a run's mapper, which is told of the attitude what the config says."""
    if reads_clouds(mapper):
        return GuardedCloudMapper(mapper, config.mapper, attitude=config.attitude == "imu")
    return GuardedMapper(with_attitude(cast("Mapper", mapper), config.attitude), config.mapper)


def check_sensors(mapper: Mapper | CloudMapper, config: RunConfig) -> None:
    """Tell whether a run's lidar and driver suit its mapper.

    Any lidar suits a planar mapper: of one with rings it gets the ring nearest the horizon.

    Raises:
        ConfigError: a mapper of point clouds has a planar lidar, or a driver that needs an occupancy map.
    """
    if not reads_clouds(mapper):
        return
    lidar = make_lidar_preset(config.lidar or make_robot(config.robot).lidar)
    if lidar.rings == 1:
        raise ConfigError(
            f"mapper {config.mapper} needs a lidar with rings, got {lidar.name}; "
            f"legal: --lidar {' or '.join(RING_LIDARS)}"
        )
    if driver_parts(config.driver)[0] == "frontier":
        raise ConfigError(
            f"driver frontier plans on the mapper's occupancy map, and {config.mapper} has none; "
            f"legal: {', '.join(name for name in DRIVERS if name != 'frontier')}"
        )


def occupancy_map(mapper: GuardedMapper | GuardedCloudMapper) -> Callable[[], OccupancyGrid]:
    """Return what gives the mapper's present occupancy map; of one that has none, it raises ConfigError."""
    return mapper.map if isinstance(mapper, GuardedMapper) else _no_map


def _no_map() -> OccupancyGrid:
    raise ConfigError("a mapper of point clouds has no occupancy map")


def cloud_copy(cloud: PointCloud) -> PointCloud:
    """Return a copy of a cloud whose arrays are read-only, with a copy of its mount."""
    xyz, ring, time = cloud.xyz.copy(), cloud.ring.copy(), cloud.time.copy()
    for array in (xyz, ring, time):
        array.flags.writeable = False
    return PointCloud(xyz, ring, time, cloud.stamp, replace(cloud.T_base_laser))


def check_pose3(estimate: object, stamp: float) -> None:
    """Tell whether an answer is a finite pose in space.

    Raises:
        MapperError: it is not; the message names the scan's stamp.
    """
    if not isinstance(estimate, Pose3):
        raise MapperError(
            f"update() must return a Pose3, got {kind_of(estimate)} for the scan at {stamp:.3f} s"
        )
    if not all(math.isfinite(value) for value in astuple(estimate)):
        raise MapperError(f"update() must return a finite pose, got {estimate} for the scan at {stamp:.3f} s")
