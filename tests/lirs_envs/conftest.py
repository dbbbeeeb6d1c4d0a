"""Small synthetic worlds for the simulation's tests."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from lirs_envs.robots.robot import Robot, make_robot
from lirs_wct.geometry import HeightField, WallGrid
from lirs_wct.geometry.pose import Pose2
from lirs_wct.ground import LaserMap, Terrain
from lirs_wct.world import World

Array = NDArray[np.float64]
HeightFunction = Callable[[Array, Array], Array]


def terrain_world(z: HeightFunction, nodes: int = 201, cell: float = 0.1) -> World:
    """A square terrain of heights z(x, y) with its center at the origin."""
    axis = (np.arange(nodes) - (nodes - 1) / 2) * cell
    x, y = np.meshgrid(axis, -axis)
    heights = np.broadcast_to(z(x, y), x.shape).astype(np.float32)
    return World("synthetic", Terrain(HeightField.centered(heights, (cell, cell))), spawn_poses=(Pose2(),))


@pytest.fixture(scope="session")
def make_world() -> Callable[..., World]:
    return terrain_world


@pytest.fixture(scope="session")
def husky() -> Robot:
    return make_robot("husky")


@pytest.fixture(scope="session")
def plane() -> World:
    return terrain_world(lambda x, y: np.zeros_like(x))


@pytest.fixture(scope="session")
def flat_field() -> World:
    """Level, but for one corner: a height field and not a plane."""
    return terrain_world(lambda x, y: 0.01 * ((x > 9.85) & (y > 9.85)))


@pytest.fixture(scope="session")
def rough() -> World:
    """Hills of 2 m with steep blocks and pillars, 1 to 2 m tall."""

    def z(x: Array, y: Array) -> Array:
        hills = np.sin(x / 3) * np.cos(y / 2.5) + 0.05 * np.sin(x * 3) * np.sin(y * 4)
        rng = np.random.default_rng(5)
        for _ in range(40):
            cx, cy, turn = rng.uniform(-14, 14), rng.uniform(-14, 14), rng.uniform(0, math.pi)
            if math.hypot(cx, cy) < 2.5:
                continue
            u = (x - cx) * math.cos(turn) + (y - cy) * math.sin(turn)
            v = (y - cy) * math.cos(turn) - (x - cx) * math.sin(turn)
            block = (abs(u) < rng.uniform(0.2, 1.0)) & (abs(v) < rng.uniform(0.2, 1.0))
            hills = np.where(block, hills.max() + rng.uniform(1, 2), hills)
        # A rim, so that nobody drives off.
        rim = np.maximum(abs(x), abs(y)) > 14
        return np.where(rim, 5.0, hills)

    return terrain_world(z, nodes=301)


@pytest.fixture(scope="session")
def T_world_wall() -> Pose2:
    """The frame of `walled`'s wall: its face is at x = 3."""
    return Pose2(0.5, -0.3, 0.4)


@pytest.fixture(scope="session")
def walled(T_world_wall: Pose2) -> World:
    """A floor with one wall, 0.1 m thick, 10 m long and 2 m high, turned as maps may be."""
    solid = np.zeros((200, 200), np.bool_)
    solid[:, 160:162] = True
    floor = HeightField.centered(np.zeros((2, 2), np.float32), (24.0, 24.0))
    walls = WallGrid(solid, 0.05, T_world_wall @ Pose2(3.0 - 8.0, -5.0), 2.0)
    return World("walled", LaserMap(floor, walls), spawn_poses=(Pose2(),))
