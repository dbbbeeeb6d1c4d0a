"""Bundles of beams meet what each beam meets alone; rays go through holes of a floor."""

import numpy as np
import pytest

from lirs_envs.lidar.presets import ring_directions
from lirs_envs.lidar.ray_casting import RayCaster
from lirs_envs.lidar.terrain_rays import BUNDLE, SMALLEST_FIELD, safe_distance
from lirs_wct.arrays import FloatArray
from lirs_wct.geometry import HeightField, WallGrid
from lirs_wct.geometry.pose import Pose2
from tests.lirs_envs.lidar.room import rings

CELL = 0.05


@pytest.fixture(scope="module", params=[(1, SMALLEST_FIELD), (2, SMALLEST_FIELD + 37)])
def surface(request: pytest.FixtureRequest) -> HeightField:
    seed, cells = request.param
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: cells + 1, : cells + 11] * CELL
    z = 0.02 * rng.standard_normal(x.shape)
    for _ in range(12):
        kx, ky = rng.normal(scale=1.0, size=2)
        z += rng.uniform(0.1, 0.4) * np.sin(kx * x + ky * y + rng.uniform(0, 6))
    return HeightField.centered(z.astype(np.float32), (CELL, CELL))


def patterns() -> dict[str, FloatArray]:
    rng = np.random.default_rng(3)
    random = rng.standard_normal((200, 3))
    return {
        "fan": ring_directions(np.linspace(-2.3, 2.3, 541)),
        "rings": rings(8, 90, -0.4, 0.26),
        "random": random / np.linalg.norm(random, axis=1, keepdims=True),
        "down": np.tile((0.0, 0.0, -1.0), (BUNDLE + 3, 1)),
        "axes": np.concatenate((np.eye(3), -np.eye(3))),
    }


def test_a_fan_meets_what_its_beams_meet_alone(surface: HeightField) -> None:
    caster, rng = RayCaster(surface), np.random.default_rng(4)
    west, south, east, north = surface.bounds
    met = 0
    for above in (0.01, 0.4, 3.0, -0.5):
        for outside in (0.0, 5.0):
            x, y = rng.uniform((west, south), (east, north))
            origin = np.array((x, y, surface.height_at(x, y) + above))
            origin[0] += (east - x + outside) * bool(outside)
            for name, directions in patterns().items():
                turn = np.linalg.qr(rng.standard_normal((3, 3)))[0] if above == 3.0 else np.eye(3)
                tilted = directions @ turn
                fan = caster.cast(origin, tilted)
                alone = caster.cast(np.tile(origin, (len(tilted), 1)), tilted)
                np.testing.assert_array_equal(fan, alone, err_msg=f"{name}, {above} m above, at {x, y}")
                met += np.isfinite(fan).sum()
    assert met > 1000


def test_no_beam_of_a_bundle_meets_the_ground_within_its_safe_distance(surface: HeightField) -> None:
    caster, rng, gained = RayCaster(surface), np.random.default_rng(5), 0
    west, south, east, north = surface.bounds
    for _ in range(200):
        x, y = rng.uniform((west, south), (east, north))
        start = np.array((x, y, surface.height_at(x, y) + rng.uniform(0.05, 2.0)))
        angle = rng.uniform(-np.pi, np.pi) + np.linspace(0.0, 0.14, BUNDLE)
        bundle = ring_directions(angle, rng.uniform(-0.3, 0.3))
        cells = ((x - west) / CELL, (y - south) / CELL, start[2])
        safe = safe_distance(caster.terrain, cells, bundle, 20.0)
        alone = caster.cast(np.tile(start, (BUNDLE, 1)), bundle, 20.0)
        assert 0.0 <= safe <= min(20.0, alone.min())
        gained += safe > 1.0
    assert gained > 30


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
