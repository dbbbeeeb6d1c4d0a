"""Recording of a drive's bag: sensor data, true poses, the mapper's poses."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from lirs_envs.robot_model import CONTROL_PERIOD
from lirs_envs.sensing.sensors import Observation
from lirs_validation.config import RunConfig
from lirs_validation.experiment.scenario import sensor_noise
from lirs_validation.record.run_record import BAG
from lirs_wct import OccupancyGrid, Pose2, Pose3
from lirs_wct.files import scratch_folder

if TYPE_CHECKING:
    from lirs_wct.formats.rosbag.messages import BagTick, SensorErrors
    from lirs_wct.formats.rosbag.writer import BagWriter


class Recording:
    """The bag of a drive, with the mapper's results (`map` on /tf, /map) if `slam`."""

    def __init__(self, writer: BagWriter, folder: Path, *, slam: bool = True) -> None:
        self._writer, self._folder, self._slam = writer, folder, slam
        self._T_map_world: Pose3 | None = None

    def add(self, observation: Observation, T_world_base: Pose3, T_map_base: Pose2) -> None:
        """Record an observation, the true pose and the mapper's pose."""
        if self._T_map_world is None:
            self._T_map_world = Pose3.from_pose2(T_world_base.to_pose2().inverse())
        estimate = T_map_base if self._slam else None
        self._writer.add(bag_tick(observation, self._T_map_world @ T_world_base, estimate))

    def finish(self, grid: OccupancyGrid | None) -> Sequence[Path]:
        """Write the map (map frame) if any, close the bag, return its files."""
        self._writer.close(grid if self._slam else None)
        return sorted(self._folder.iterdir())


def bag_tick(observation: Observation, T_map_truth: Pose3, T_map_base: Pose2 | None) -> BagTick:
    """Return the messages' values of an observation, the true pose and the mapper's pose."""
    from lirs_wct.formats.rosbag.messages import BagTick  # prepares the layouts of all messages

    return BagTick(
        scan=observation.scan,
        odometry=observation.odometry,
        imu=observation.imu,
        truth=T_map_truth,
        estimate=T_map_base,
        cloud=observation.cloud,
        inertial=observation.inertial,
        odometry_track=observation.odometry_track,
    )


def sensor_errors(config: RunConfig) -> SensorErrors:
    """Return the standard deviations of a run's sensors, for the covariances of its bag."""
    from lirs_wct.formats.rosbag.messages import SensorErrors

    noise = sensor_noise(config)
    imu, wheels = noise.imu, noise.odometry
    return SensorErrors(
        scale=wheels.scale_sigma,
        scale_length=wheels.scale_length,
        rate=imu.rate_sigma,
        rate_bias=imu.rate_bias,
        update=CONTROL_PERIOD,
        attitude=math.hypot(imu.attitude_sigma, imu.attitude_bias),
        acceleration=math.hypot(imu.acceleration_sigma, imu.acceleration_bias),
    )


@contextmanager
def recording(config: RunConfig, out: Path, period: float) -> Iterator[Recording]:
    """Record a drive's bag; its files are deleted unless they were moved."""
    from lirs_wct.formats.rosbag.writer import BagWriter

    assert config.bag is not None
    with scratch_folder(out / "recording") as made:
        folder = made / BAG
        writer = BagWriter(folder, config.bag, period, sensor_errors(config))
        try:
            yield Recording(writer, folder, slam=not config.sensors_only)
        finally:
            writer.abort()
