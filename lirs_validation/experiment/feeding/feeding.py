"""Interface of feeding, and direct feeding.

Scans go in, answers come out in the same order.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Protocol

from lirs_validation.experiment.mapper_guard import GuardedCloudMapper
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.pose import Pose2, Pose3
from slam_baselines.mapper import Mapper

if TYPE_CHECKING:
    from lirs_envs.sensing.sensors import Observation


class Feeding(Protocol):
    """Feeds a mapper scan by scan; answers come in the order of the scans."""

    @property
    def place(self) -> Place:
        """Place of the mapper."""
        ...

    @property
    def ready(self) -> bool:
        """Whether nothing is gained by waiting for the next answer."""
        ...

    def give(self, observation: Observation) -> None:
        """Hand a scan to the mapper.

        Raises:
            ConfigError: it reads point clouds, and the lidar has no rings.
            MapperError: its process has ended.
        """
        ...

    def answer(self) -> Answer:
        """Return the mapper's answer to the first unanswered scan.

        Raises:
            MapperError: the mapper failed.
        """
        ...

    def close(self) -> None:
        """Stop; the feeding cannot be used afterwards."""
        ...


class DirectFeeding:
    """Feeds a mapper when it is asked for its answer."""

    place: Place = "drive"
    ready = True

    def __init__(self, mapper: AnyMapper) -> None:
        self._mapper = mapper

    def give(self, observation: Observation) -> None:
        """Keep the scan (see `Feeding`)."""
        self._sensed = update_arguments(observation, clouds=isinstance(self._mapper, GuardedCloudMapper))

    def answer(self) -> Answer:
        """Feed the mapper (see `Feeding`)."""
        return update_mapper(self._mapper, self._sensed)

    def close(self) -> None:
        """Nothing goes on."""


def update_arguments(observation: Observation, *, clouds: bool) -> tuple[Any, ...]:
    """Return the arguments of `update` of a mapper.

    Raises:
        ConfigError: it takes a point cloud, and the lidar has no rings.
    """
    if not clouds:
        return observation.scan, observation.odometry, observation.imu
    if observation.cloud is None:
        raise ConfigError("a mapper of point clouds needs a lidar with rings")
    return observation.cloud, observation.imu


AnyMapper = Mapper | GuardedCloudMapper
Place = Literal["drive", "process"]
"""Location of a mapper: the drive's own process or another one."""


@dataclass(frozen=True, slots=True)
class Answer:
    """Answer of a mapper to a scan.

    Attributes:
        estimate: `T_map_base`, in the plane or in space.
        lost: whether it does not know its place.
        seconds: wall-clock time of its update.
    """

    estimate: Pose2 | Pose3
    lost: bool
    seconds: float


def update_mapper(mapper: AnyMapper, update: tuple[Any, ...]) -> Answer:
    """Call a mapper's `update` with its arguments; return the answer.

    Raises:
        MapperError: the mapper failed.
    """
    begun = time.perf_counter()
    estimate = mapper.update(*update)
    seconds = time.perf_counter() - begun
    return Answer(estimate, mapper.lost, seconds)
