"""Where a laser map's floor has a hole, a ray goes through it."""

import numpy as np
import pytest

from lirs_envs.lidar.ray_casting import RayCaster
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.walls import WallGrid


@pytest.mark.parametrize("yaw", [0.0, 0.6])
def test_rays_meet_the_floor_but_not_its_hole(yaw: float) -> None:
    solid = np.zeros((30, 50), np.bool_)
    hole = solid.copy()
    hole[10:20, 15:40] = True
    solid[:, 45] = True
    origin = Pose2(-1.0, 0.5, yaw)
    floor = HeightField(np.zeros((2, 2), np.float32), (20.0, 20.0), (-10.0, -10.0))
    caster = RayCaster(floor, WallGrid(solid, 0.1, origin, 2.0, hole))
    rng = np.random.default_rng(5)
    target = np.column_stack((rng.uniform(0, 4.4, 500), rng.uniform(0, 3, 500)))
    eye = np.array((*origin.apply((0.5, 1.5)), 1.0))
    towards = np.column_stack((origin.apply(target), np.zeros(500))) - eye
    distance = np.linalg.norm(towards, axis=1)
    ranges = caster.cast(eye, towards / distance[:, None], 50.0)
    col, row = np.floor(target / 0.1).astype(int).T
    inside = hole[row, col]
    assert 50 < inside.sum() < 200
    np.testing.assert_allclose(ranges[~inside], distance[~inside], atol=1e-6)
    assert np.isposinf(ranges[inside]).all()


def test_a_wall_above_the_hole_is_still_met() -> None:
    hole = np.zeros((10, 40), np.bool_)
    hole[:, 10:30] = True
    solid = np.zeros_like(hole)
    solid[:, 35] = True
    floor = HeightField(np.zeros((2, 2), np.float32), (4.0, 1.0), (0.0, 0.0))
    caster = RayCaster(floor, WallGrid(solid, 0.1, height=1.0, hole=hole))
    level = caster.cast((0.5, 0.5, 0.5), [(1.0, 0.0, 0.0)], 50.0)
    np.testing.assert_allclose(level, 3.0)
