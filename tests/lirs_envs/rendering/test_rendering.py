"""What pictures of a simulation show, and what they say where they cannot be made."""

import math
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest

from lirs_envs.generators.terrain import generate
from lirs_envs.rendering import (
    CHASE,
    GOAL,
    MAX_ERROR,
    PATH,
    ROBOT,
    SCAN,
    WALKER,
    Camera,
    MapView,
    RenderScene,
    Snapshot,
)
from lirs_envs.robots.robot import Robot, make_robot
from lirs_envs.sensing.sensors import SensorNoise
from lirs_envs.simulation import Simulation
from lirs_wct.errors import SimulationError
from lirs_wct.geometry.pose import Pose2
from lirs_wct.sources.build import build_world
from lirs_wct.world import World
from tests.kit import started

Array = np.ndarray[Any, np.dtype[Any]]


def simulation(world: World, robot: Robot, **config: Any) -> Simulation:
    return started(world, robot=robot, noise=SensorNoise(lidar="none"), **config)


def drawn(make: Callable[[], Any], in_ci: bool) -> Any:
    try:
        return make()
    except SimulationError as error:
        if in_ci:
            raise
        pytest.skip(str(error))


def of_color(picture: Array, color: tuple[int, int, int], slack: int = 25) -> Array:
    """(n, 2) rows and columns."""
    return np.argwhere((np.abs(picture.astype(int) - color) < slack).all(axis=-1))


@pytest.mark.render
@pytest.mark.slow
def test_a_picture_shows_robot_goal_and_walkers(plane: World, husky: Robot, in_ci: bool) -> None:
    sim, camera = simulation(plane, husky, actors=5), Camera((240, 320))
    snapshot = Snapshot.of(sim)
    here = sim.pose().to_pose2()
    ahead = Pose2(here.x + 3 * math.cos(here.yaw), here.y + 3 * math.sin(here.yaw))
    bare = drawn(lambda: camera.rgb(snapshot), in_ci)
    assert bare.shape == (240, 320, 3)
    yellow = (bare[..., 0] > 120) & (bare[..., 2] < 0.45 * bare[..., 0])
    assert 0.005 < yellow.mean() < 0.5
    marked = camera.rgb(Snapshot.of(sim, goal=ahead))
    red = (marked[..., 0] > 100) & (marked[..., 1] < 60)
    assert red.mean() > 0.0005 + ((bare[..., 0] > 100) & (bare[..., 1] < 60)).mean()
    walkers = np.array([(ahead.x, ahead.y, sim.pose().z + 0.8)] * 5)
    with_walker = camera.rgb(Snapshot(world=plane, config=sim.config, qpos=snapshot.qpos, walkers=walkers))
    blue = (with_walker[..., 2] > with_walker[..., 0].astype(int) + 30) & (with_walker[..., 2] < 180)
    assert blue.mean() > 0.003
    assert np.array_equal(camera.rgb(snapshot), bare)
    camera.close()
    assert np.array_equal(camera.rgb(snapshot), bare)
    camera.close()


@pytest.mark.render
def test_depths_are_those_of_the_plane(plane: World, husky: Robot, in_ci: bool) -> None:
    sim, camera = simulation(plane, husky), Camera((120, 160))
    snapshot = Snapshot.of(sim)
    depth = drawn(lambda: camera.depth(snapshot), in_ci)
    camera.close()
    assert depth.dtype == np.float32
    scene = RenderScene(plane, sim.config)
    scene.place(snapshot)
    eye = scene.data.camera(CHASE)
    tangent = math.tan(math.radians(scene.model.camera(CHASE).fovy[0]) / 2)
    rows, cols = np.mgrid[110:120, 0:40]
    up, right = (59.5 - rows) / 60 * tangent, (cols - 79.5) / 60 * tangent
    axes = eye.xmat.reshape(3, 3)
    rays = right[..., None] * axes[:, 0] + up[..., None] * axes[:, 1] - axes[:, 2]
    assert depth[110:, :40] == pytest.approx(-eye.xpos[2] / rays[..., 2], rel=0.01)


def test_the_drawn_ground_is_the_true_one_within_its_error(rough: World, husky: Robot) -> None:
    sim = simulation(rough, husky)
    scene = RenderScene(rough, sim.config)
    scene.place(Snapshot.of(sim))
    rng, geom, missed = np.random.default_rng(1), np.zeros(1, np.int32), 0
    # Just beside nodes, at which the error is bounded: a ray may slip between triangles at the node itself.
    x, y = 0.1 * rng.integers(-95, 96, (2, 300)) + 1e-4 * np.array(((2.0,), (1.0,)))
    for east, north, z in zip(x, y, rough.surface.height_at(x, y), strict=True):
        start, down = np.array((east, north, 100.0)), np.array((0.0, 0.0, -1.0))
        far = mujoco.mj_ray(scene.model, scene.data, start, down, None, True, -1, geom, None)
        missed += abs(100.0 - far - z) > MAX_ERROR + 0.005
    # Where the robot stands.
    assert missed <= 3


@pytest.mark.render
@pytest.mark.parametrize("source", ["terrain", "office"])
def test_the_ground_wears_its_texture_where_it_belongs(source: str, in_ci: bool) -> None:
    """From straight above, the picture is the map."""
    terrain = generate("gaps", 0.9, np.random.default_rng(4)).world()
    world = terrain if source == "terrain" else build_world("examples/data/office.yaml")
    sim = simulation(world, make_robot("turtlebot2"))
    scene = RenderScene(world, sim.config)
    scene.place(Snapshot.of(sim))
    west, south, east, north = world.surface.bounds
    above = mujoco.MjvCamera()
    above.lookat[:] = (west + east) / 2, (south + north) / 2, 0.0
    above.azimuth, above.elevation, above.distance = 90.0, -90.0, 400.0
    side = max(east - west, north - south)
    scene.model.vis.global_.fovy = 2 * math.degrees(math.atan(side / 2 / above.distance))
    renderer = drawn(lambda: mujoco.Renderer(scene.model, 200, 200), in_ci)
    renderer.update_scene(scene.data, camera=above)
    picture = renderer.render()
    renderer.close()
    expected = MapView(200).picture(Snapshot.of(sim))
    margin = (200 - expected.shape[0]) // 2
    part = picture[margin : margin + expected.shape[0]]
    turned = [part, part[::-1], part[:, ::-1], part[::-1, ::-1]]
    alike = [np.corrcoef(one.ravel(), expected.ravel())[0, 1] for one in turned]
    assert alike[0] > 0.6
    assert alike[0] > max(alike[1:]) + 0.05


def test_a_map_shows_all_where_it_is(plane: World, husky: Robot) -> None:
    """The plane is 20 m square with its middle at the origin; 400 pixels are 20 a meter."""
    sim = simulation(plane, husky)
    view = MapView(400)
    walkers, goal = np.array(((-5.0, 6.0, 0.9),)), Pose2(7.0, -4.0)
    sim.reset(Pose2(2.0, 3.0, math.pi / 2))
    snapshot = Snapshot(
        world=plane, config=sim.config, qpos=sim.body.data.qpos.copy(), walkers=walkers, goal=goal
    )
    path = [Pose2(-8.0, -8.0), Pose2(-2.0, -8.0)]
    picture = view.picture(snapshot, path=path)
    assert picture.shape == (400, 400, 3)
    assert picture.dtype == np.uint8
    for color, (x, y) in (
        (ROBOT, (2.0, 3.0)),
        (WALKER, (-5.0, 6.0)),
        (GOAL, (7.0, -4.0)),
        (PATH, (-5.0, -8.0)),
    ):
        found = of_color(picture, color)
        assert len(found) > 4
        row, col = found.mean(axis=0)
        assert (col / 20 - 10, 10 - row / 20) == pytest.approx((x, y), abs=0.3), color
    # The arrowhead is longer than wide, and points north.
    rows, cols = of_color(picture, ROBOT).T
    assert np.ptp(rows) > np.ptp(cols)
    assert np.array_equal(view.picture(snapshot, path=path), picture)


def test_a_scan_lies_on_what_it_met(husky: Robot) -> None:
    world = generate("mazes", 0.0, np.random.default_rng(1)).world()
    sim = simulation(world, husky)
    scan = sim.reset().scan
    picture = MapView(512).picture(Snapshot.of(sim), scan=scan)
    rows, cols = of_color(picture, SCAN, 40).T
    assert len(rows) > 100
    x, y = cols / 20 - 12.8, 12.8 - rows / 20
    near = [
        np.nanmax(
            world.surface.height_at(a + np.linspace(-0.3, 0.3, 13)[:, None], b + np.linspace(-0.3, 0.3, 13))
        )
        for a, b in zip(x, y, strict=True)
    ]
    assert np.mean(np.array(near) > 0.5) > 0.97
