"""One world, consumers that agree: Gazebo's mesh, MuJoCo's ground, contact grid and laser see one source."""

import math
from pathlib import Path

import cv2
import mujoco
import numpy as np
import pytest

from lirs_envs.lidar.ray_casting import RayCaster
from lirs_wct import BuildOptions, World, build_world
from lirs_wct.contact.spec import contact_grid, world_spec
from lirs_wct.export.package import write_package
from lirs_wct.formats.meshes.reader import read_upright
from lirs_wct.geometry.mesh import rasterize_heights

POINTS = 1000
BUDGET = 0.02
ROUNDING = 1e-4
"""Meters: COLLADA writes float32 and decimals."""


@pytest.fixture(scope="module")
def picture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Smooth octaves, 16 bit, wider than high."""
    rng = np.random.default_rng(6)
    z = sum(
        cv2.GaussianBlur(rng.random((241, 321)).astype(np.float32), (0, 0), s) * s**2 for s in (6, 15, 40)
    )
    path = tmp_path_factory.mktemp("source") / "dunes.png"
    cv2.imwrite(str(path), np.rint((z - z.min()) / np.ptp(z) * 65535).astype(np.uint16))
    return path


@pytest.fixture(scope="module", params=["dunes", pytest.param("medium", marks=pytest.mark.slow)])
def world(request: pytest.FixtureRequest, picture: Path) -> World:
    if request.param == "medium":
        return build_world("medium", BuildOptions(max_error=BUDGET))
    return build_world(picture, BuildOptions(size=40, height=5, max_error=BUDGET))


@pytest.fixture(scope="module")
def folder(world: World, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_package(world, tmp_path_factory.mktemp("worlds"))


def test_gazebos_mesh_is_within_the_budget_of_the_source(world: World, folder: Path) -> None:
    """At random pixels of the source, which are its nodes; in between at smooth ground too."""
    rng = np.random.default_rng(1)
    surface = world.surface
    for kind in ("dae", "stl"):
        mesh = read_upright(folder / "meshes" / f"{world.name}.{kind}")
        top = rasterize_heights(mesh, (*surface.origin, *surface.cell), surface.shape)[::-1]
        row, col = (rng.integers(0, n, POINTS) for n in surface.shape)
        assert np.abs(top[row, col] - surface.z[row, col]).max() <= BUDGET + ROUNDING
        west, south, east, north = surface.bounds
        x, y = rng.uniform(west, east, POINTS), rng.uniform(south, north, POINTS)
        heights = [
            rasterize_heights(mesh, (px, py, 1.0, 1.0), (1, 1))[0, 0] for px, py in zip(x, y, strict=True)
        ]
        error = np.abs(np.array(heights) - surface.height_at(x, y))
        # Upright sides of obstacles are one cell wide: between nodes a line is as far off as it is steep.
        gentle = np.ones(POINTS, np.bool_)
        for dx in (-1, 0, 1):
            for dy in (-1, 0, 1):
                px = np.clip(x + dx * surface.cell[0], west, east)
                py = np.clip(y + dy * surface.cell[1], south, north)
                gentle &= np.abs(surface.height_at(px, py) - surface.height_at(x, y)) < 2 * max(surface.cell)
        assert gentle.mean() > 0.8
        assert error[gentle].max() <= BUDGET + ROUNDING


def test_the_exported_hfield_is_the_source(world: World, folder: Path) -> None:
    model = mujoco.MjModel.from_xml_path(str(folder / f"{world.name}.xml"))
    stored = model.hfield_data.reshape(model.hfield_nrow[0], model.hfield_ncol[0])
    heights = model.geom("ground").pos[2] + model.hfield_size[0, 2] * stored.astype(np.float64)
    assert np.abs(heights[::-1] - world.surface.z).max() <= 1e-6 * world.surface.relief


def test_the_contact_grid_is_within_its_stated_budget(world: World) -> None:
    grid = contact_grid(world.surface)
    contact = grid.heights(world.surface)
    assert grid.vertical_budget == 0.01
    assert grid.vertical <= grid.vertical_budget
    assert grid.horizontal <= grid.horizontal_budget
    rng = np.random.default_rng(2)
    west, south, east, north = world.surface.bounds
    x, y = rng.uniform(west, east, POINTS), rng.uniform(south, north, POINTS)
    error = np.abs(contact.height_at(x, y) - world.surface.height_at(x, y))
    reach = max(grid.cell)
    flat = np.ones(POINTS, np.bool_)
    for dx, dy in ((0, 0), (reach, 0), (-reach, 0), (0, reach), (0, -reach)):
        px, py = np.clip(x + dx, west, east), np.clip(y + dy, south, north)
        flat &= np.abs(world.surface.height_at(px, py) - world.surface.height_at(x, y)) < 0.6 * reach
    assert flat.mean() > 0.6
    # Nodes keep the budget; on the diagonals between them the two triangulations differ a little more.
    assert error[flat].max() <= 1.5 * grid.vertical_budget


def test_the_laser_is_on_the_source_itself(world: World) -> None:
    caster = RayCaster(world.surface, world.walls)
    rng = np.random.default_rng(3)
    west, south, east, north = world.surface.bounds
    top = float(world.surface.z.max()) + 1.0
    for x, y in zip(rng.uniform(west, east, POINTS), rng.uniform(south, north, POINTS), strict=True):
        down = caster.cast((x, y, top), [(0.0, 0.0, -1.0)])[0]
        assert top - down == pytest.approx(float(world.surface.height_at(x, y)), abs=1e-5)


def test_what_is_touched_in_mujoco_is_what_the_contact_grid_says(world: World) -> None:
    grid = contact_grid(world.surface)
    model = world_spec(world, contact=grid).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    coarse = grid.heights(world.surface)
    rng = np.random.default_rng(4)
    west, south, east, north = world.surface.bounds
    hit = np.zeros(1, np.int32)
    for x, y in zip(rng.uniform(west, east, 200), rng.uniform(south, north, 200), strict=True):
        down = mujoco.mj_ray(model, data, np.array((x, y, 50.0)), np.array((0, 0, -1.0)), None, 1, -1, hit)
        assert 50.0 - down == pytest.approx(float(coarse.height_at(x, y)), abs=1e-4)


def test_a_map_is_the_same_walls_for_all(tmp_path: Path) -> None:
    pixels = np.full((60, 90), 254, np.uint8)
    pixels[10:14, 20:60] = pixels[30:55, 70:72] = 0
    cv2.imwrite(str(tmp_path / "room.pgm"), pixels)
    (tmp_path / "room.yaml").write_text(
        "image: room.pgm\nresolution: 0.1\norigin: [-3, -2, 0.4]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    world = build_world(tmp_path / "room.yaml")
    folder = write_package(world, tmp_path / "out")
    mesh = read_upright(folder / "meshes/room.dae")
    model = mujoco.MjModel.from_xml_path(str(folder / "room.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert world.walls is not None
    caster = RayCaster(world.surface, world.walls)
    rng = np.random.default_rng(7)
    hit = np.zeros(1, np.int32)
    walls = 0
    local = np.column_stack((rng.uniform(0, 9, POINTS), rng.uniform(0, 6, POINTS)))
    for (x, y), (u, v) in zip(world.walls.origin.apply(local), local, strict=True):
        height = 2.5 if world.walls.solid[math.floor(v / 0.1), math.floor(u / 0.1)] else 0.0
        walls += height > 0
        assert rasterize_heights(mesh, (x, y, 1.0, 1.0), (1, 1))[0, 0] == pytest.approx(height, abs=1e-6)
        ray = np.array((x, y, 9.0)), np.array((0.0, 0.0, -1.0))
        assert 9.0 - mujoco.mj_ray(model, data, *ray, None, 1, -1, hit) == pytest.approx(height, abs=1e-5)
        assert 9.0 - caster.cast(ray[0], [ray[1]])[0] == pytest.approx(height, abs=1e-6)
    assert walls > 20
