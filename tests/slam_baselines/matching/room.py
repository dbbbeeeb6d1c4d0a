"""A map of one scan of the room."""

import numpy as np
from numpy.typing import NDArray

from lirs_wct.geometry.pose import Pose2
from slam_baselines.leveling import ScanLeveler
from slam_baselines.map_builder import BuilderConfig, MapBuilder
from tests.slam_baselines.synthetic import room_scan

Array = NDArray[np.float64]


def room_map(pose: Pose2) -> tuple[MapBuilder, Array]:
    """The map of one scan, and the scan's points."""
    level = ScanLeveler().level(room_scan(pose, 0.0, np.random.default_rng(0)), None)
    builder = MapBuilder(BuilderConfig())
    for _ in range(3):
        builder.enter(level, pose)
    return builder, level.hits
