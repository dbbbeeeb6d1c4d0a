"""What a mapper answers to a scan; known in its process too, where there is no simulation."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any, Literal

from lirs_validation.experiment.clouds.guard import GuardedCloudMapper
from lirs_wct.geometry.pose import Pose2, Pose3
from slam_baselines.mapper import Mapper

AnyMapper = Mapper | GuardedCloudMapper
Place = Literal["drive", "thread", "process"]
"""Where a mapper works: in the drive's own thread, in another one, or in another process."""


@dataclass(frozen=True, slots=True)
class Answer:
    """What a mapper answered to a scan.

    Attributes:
        estimate: `T_map_base`, in the plane or in space.
        lost: whether it does not know its place.
        seconds: wall-clock time of its update.
    """

    estimate: Pose2 | Pose3
    lost: bool
    seconds: float


def answered(mapper: AnyMapper, update: tuple[Any, ...]) -> Answer:
    """Give a mapper what its `update` takes; return its answer.

    Raises:
        MapperError: the mapper failed.
    """
    begun = time.perf_counter()
    estimate = mapper.update(*update)
    seconds = time.perf_counter() - begun
    return Answer(estimate, mapper.lost, seconds)
