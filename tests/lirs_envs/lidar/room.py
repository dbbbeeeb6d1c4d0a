"""A small room for the lidar's tests."""

from __future__ import annotations

import numpy as np

from lirs_envs.lidar.ray_casting import RayCaster
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.walls import WallGrid


def room() -> RayCaster:
    """8 m x 6 m inside."""
    solid = np.ones((80, 100), np.bool_)
    solid[10:70, 10:90] = False
    flat = HeightField.centered(np.zeros((2, 2), np.float32), (100.0, 100.0))
    return RayCaster(flat, WallGrid(solid, 0.1, Pose2(-5.0, -4.0, 0.0), 2.0))
