"""A small room for the lidar's tests, and rings of beams."""

import math

import numpy as np

from lirs_envs.lidar.ray_casting import RayCaster
from lirs_wct.arrays import FloatArray
from lirs_wct.geometry import HeightField, WallGrid
from lirs_wct.geometry.pose import Pose2


def room() -> RayCaster:
    """8 m x 6 m inside."""
    solid = np.ones((80, 100), np.bool_)
    solid[10:70, 10:90] = False
    flat = HeightField.centered(np.zeros((2, 2), np.float32), (100.0, 100.0))
    return RayCaster(flat, WallGrid(solid, 0.1, Pose2(-5.0, -4.0, 0.0), 2.0))


def rings(count: int, beams: int, lowest: float, highest: float) -> FloatArray:
    """Return (count * beams, 3) unit directions of rings around z, from below; elevations in radians."""
    around = math.tau * np.arange(beams) / beams - math.pi
    up = np.repeat(np.linspace(lowest, highest, count), beams)
    around = np.tile(around, count)
    return np.stack((np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)), axis=1)
