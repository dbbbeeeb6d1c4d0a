"""What is written looks as it should, in the pictures that MuJoCo draws and in files that trimesh reads."""

from pathlib import Path

import cv2
import mujoco
import numpy as np
import pytest
import trimesh
import yaml

from lirs_wct import BuildOptions, World, build_world
from lirs_wct.errors import ConfigError
from lirs_wct.export.mjcf import NEAR_PLANE
from lirs_wct.export.package import write_package

RED, GREEN, BLUE, YELLOW = (220, 40, 30), (40, 190, 60), (40, 90, 220), (230, 200, 30)
CORNERS = {(-1, 1): RED, (1, 1): GREEN, (-1, -1): BLUE, (1, -1): YELLOW}
"""Color of each quadrant of the orthophoto, by the signs of x and y."""


@pytest.fixture
def peak(tmp_path: Path) -> Path:
    """A steep hill, 3 : 2."""
    y, x = np.mgrid[-1:1:81j, -1:1:121j]
    path = tmp_path / "peak.png"
    cv2.imwrite(str(path), (255 * np.exp(-3 * (x**2 + y**2))).astype(np.uint8))
    return path


@pytest.fixture
def ortho(tmp_path: Path) -> Path:
    rgb = np.empty((120, 180, 3), np.uint8)
    for (east, north), color in CORNERS.items():
        top, left = 0 if north > 0 else 60, 90 if east > 0 else 0
        rgb[top : top + 60, left : left + 90] = color
    path = tmp_path / "ortho.jpg"
    cv2.imwrite(str(path), rgb[..., ::-1], (cv2.IMWRITE_JPEG_QUALITY, 100))
    return path


@pytest.fixture
def room(tmp_path: Path) -> Path:
    """4 x 3 m, a wall around it and a block in its north-east, its frame turned."""
    cells = np.full((30, 40), 254, np.uint8)
    cells[0], cells[-1], cells[:, 0], cells[:, -1], cells[3:9, 30:37] = 0, 0, 0, 0, 0
    cv2.imwrite(str(tmp_path / "room.png"), cells)
    said = {"image": "room.png", "resolution": 0.1, "origin": [1.0, -2.0, 0.4], "negate": 0}
    (tmp_path / "room.yaml").write_text(yaml.safe_dump(said | {"occupied_thresh": 0.65, "free_thresh": 0.2}))
    return tmp_path / "room.yaml"


def like(pixel: np.ndarray, color: tuple[int, int, int]) -> bool:
    """Whether a pixel has a color, however bright."""
    a, b = pixel.astype(float), np.array(color, float)
    return float(a @ b / (np.linalg.norm(a) * np.linalg.norm(b) + 1e-9)) > 0.98


def textured(folder: Path, kind: str) -> tuple[trimesh.Trimesh, np.ndarray]:
    """Return a package's mesh file as trimesh reads it, and its picture, RGB."""
    shape = trimesh.load(next((folder / "meshes").glob(f"*.{kind}")), force="mesh")
    (file,) = (folder / "materials/textures").iterdir()
    return shape, cv2.imread(str(file))[..., ::-1]


def seen_colors(folder: Path, kind: str) -> dict[tuple[int, int], np.ndarray]:
    """Return the color in the texture at the middle of each quadrant of a mesh file, from above."""
    shape, pixels = textured(folder, kind)
    low, high = shape.bounds
    found = {}
    for east, north in CORNERS:
        x, y = (low + high)[:2] / 2 + np.array((east, north)) * (high - low)[:2] / 4
        up = shape.face_normals[:, 2] > 0.01
        centers = shape.triangles_center[up]
        face = shape.faces[up][np.hypot(centers[:, 0] - x, centers[:, 1] - y).argmin()]
        u, v = shape.visual.uv[face].mean(axis=0)
        found[east, north] = pixels[int((1 - v) * len(pixels)), int(u * pixels.shape[1])]
    return found


@pytest.mark.parametrize("kind", ["dae", "obj"])
def test_an_orthophoto_fits_what_is_not_square(kind: str, peak: Path, ortho: Path, tmp_path: Path) -> None:
    world = build_world(peak, BuildOptions(size=(30, 20), height=15, texture=ortho, drape=True))
    folder = write_package(world, tmp_path / "out", formats=(kind,))
    for place, pixel in seen_colors(folder, kind).items():
        assert like(pixel, CORNERS[place])
    again = build_world(folder).export_options
    assert again.drape
    assert again.texture is not None


def test_the_summit_is_white_and_the_foot_green(peak: Path, tmp_path: Path) -> None:
    """Of a steep hill in the mesh file, where cube projection took the colors of other heights."""
    world = build_world(peak, BuildOptions(size=20, height=15))
    shape, picture = textured(write_package(world, tmp_path / "out", formats=("dae",)), "dae")
    picture = picture.astype(int)
    ground = shape.vertex_normals[:, 2] > 0.02
    z, uv = shape.vertices[ground, 2], shape.visual.uv[ground]
    rows, cols = picture.shape[:2]
    color = picture[((1 - uv[:, 1]) * rows).astype(int), (uv[:, 0] * cols).astype(int)]
    summit, foot = color[z > 0.93 * z.max()], color[z < 0.15 * z.max()]
    # The share of green over red: more than 1 in meadows, less on scree.
    assert (summit[:, 1] / summit[:, 0]).max() < 1.0
    assert (foot[:, 1] / foot[:, 0]).min() > 1.0


def picture(model: mujoco.MjModel, camera: str | mujoco.MjvCamera = "overview") -> np.ndarray:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    with mujoco.Renderer(model, 240, 320) as renderer:
        renderer.update_scene(data, camera=camera)
        drawn: np.ndarray = renderer.render().copy()
    return drawn


def from_above(model: mujoco.MjModel) -> np.ndarray:
    """North up, the whole world across the picture or nearly."""
    camera = mujoco.MjvCamera()
    camera.lookat[:], camera.distance = model.stat.center, 2.0 * model.stat.extent
    camera.azimuth, camera.elevation = 90, -90
    return picture(model, camera)


def written(world: World, folder: Path) -> mujoco.MjModel:
    package = write_package(world, folder, formats=("mjcf",))
    return mujoco.MjModel.from_xml_path(str(package / f"{world.name}.xml"))


@pytest.mark.render
@pytest.mark.parametrize("as_mesh", [False, True], ids=["height field", "mesh"])
def test_mujoco_shows_the_orthophoto_upright(as_mesh: bool, peak: Path, ortho: Path, tmp_path: Path) -> None:
    source = peak
    if as_mesh:
        flat = cv2.imread(str(peak), cv2.IMREAD_GRAYSCALE) * 0
        source = tmp_path / "flat.png"
        cv2.imwrite(str(source), flat)
    world = build_world(source, BuildOptions(size=(30, 20), height=2, texture=ortho, drape=True))
    seen = from_above(written(world, tmp_path / "out"))
    for (east, north), color in CORNERS.items():
        assert like(seen[120 - north * 20, 160 + east * 30], color), (east, north)


@pytest.mark.render
@pytest.mark.parametrize(
    "size", [50.0, pytest.param(3.0, marks=pytest.mark.slow), pytest.param(900.0, marks=pytest.mark.slow)]
)
def test_the_overview_shows_all_and_the_near_plane_is_centimeters(
    size: float, peak: Path, tmp_path: Path
) -> None:
    world = build_world(peak, BuildOptions(size=size, height=size / 8, name=f"w{size:g}"))
    model = written(world, tmp_path / "out")
    assert NEAR_PLANE * 0.999 <= model.vis.map.znear * model.stat.extent < 0.05
    seen = picture(model).astype(int)
    sky = (seen.min(axis=2) > 170) & (seen[..., 2] >= seen[..., 0])
    assert 0.1 < 1 - sky.mean() < 0.9
    for border in (sky[0], sky[-1], sky[:, 0], sky[:, -1]):
        assert border.all()


@pytest.mark.parametrize(
    "size", [3.0, *(pytest.param(size, marks=pytest.mark.slow) for size in (50.0, 2_000.0)), 100_000.0]
)
def test_the_far_plane_leaves_the_sky(size: float, peak: Path, tmp_path: Path) -> None:
    """A sky at 4e6 times the near plane is clipped: black, and so are the ground's far ends."""
    world = build_world(peak, BuildOptions(size=size, height=size / 8))
    model = written(world, tmp_path / "out")
    assert model.vis.map.zfar / model.vis.map.znear <= 4.001e5
    # From the overview all of the world is nearer than the far plane.
    position, middle = model.cam("overview").pos, model.stat.center
    assert np.linalg.norm(position - middle) + model.stat.extent < model.vis.map.zfar * model.stat.extent


@pytest.mark.render
@pytest.mark.parametrize("size", [pytest.param(5_000.0, marks=pytest.mark.slow), 100_000.0])
def test_the_sky_over_kilometers_is_not_black(size: float, peak: Path, tmp_path: Path) -> None:
    world = build_world(peak, BuildOptions(size=size, height=size / 8, name="wide"))
    seen = picture(written(world, tmp_path / "out")).astype(int)
    assert seen.max(axis=2).min() > 20
    for border in (seen[0], seen[-1], seen[:, 0], seen[:, -1]):
        assert border.min() > 170


@pytest.mark.render
def test_a_thing_before_the_camera_is_seen(peak: Path, tmp_path: Path) -> None:
    """At 1 % of the world's extent, MuJoCo's default, a robot's camera saw through it."""
    package = write_package(build_world(peak, BuildOptions(size=50)), tmp_path, formats=("mjcf",))
    spec = mujoco.MjSpec.from_file(str(package / "peak.xml"))
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX, size=(0.01, 0.2, 0.2), pos=(0.06, 0, 30), rgba=(1, 0, 0, 1)
    )
    spec.worldbody.add_camera(name="eye", pos=(0, 0, 30), quat=(0.5, 0.5, -0.5, -0.5))
    middle = picture(spec.compile(), "eye")[120, 160]
    assert middle[0] > 3 * max(middle[1], middle[2])


@pytest.mark.render
def test_a_laser_map_wears_textures_on_floor_and_walls(room: Path, tmp_path: Path) -> None:
    for name, color in (("floor", BLUE), ("wall", RED)):
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.full((8, 8, 3), color[::-1], np.uint8))
    floor, wall = tmp_path / "floor.png", tmp_path / "wall.png"
    world = build_world(room, BuildOptions(texture=floor, wall_texture=wall, wall_height=0.05))
    model = written(world, tmp_path / "out")
    seen, counts = np.unique(from_above(model).reshape(-1, 3), axis=0, return_counts=True)
    red, blue = (
        sum(n for pixel, n in zip(seen, counts, strict=True) if like(pixel, color)) for color in (RED, BLUE)
    )
    assert world.walls is not None
    assert red / (red + blue) == pytest.approx(world.walls.solid.mean(), abs=0.02)
    # What is touched stands in the group that the viewer hides, and is not drawn a second time.
    touched = {int(model.geom_group[g]) for g in range(model.ngeom) if model.geom_contype[g]}
    assert touched == {3}
    kept = build_world(tmp_path / "out" / "room").export_options.wall_texture
    assert kept is not None
    assert kept.name == "room-walls.png"


@pytest.mark.render
def test_a_mesh_with_overhangs_is_seen_in_mujoco(tmp_path: Path) -> None:
    """It stood in a group that neither viewer nor renderer shows."""
    ring = trimesh.creation.annulus(1.0, 2.0, 1.5)
    ring.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0)))
    ring.export(tmp_path / "ring.stl")
    world = build_world(tmp_path / "ring.stl")
    assert world.overhangs
    seen = picture(written(world, tmp_path / "out")).astype(int)
    ground = seen[..., 2] < seen[..., 0]
    assert ground.mean() > 0.1


def test_floor_and_walls_are_two_materials_of_one_mesh_file(room: Path, tmp_path: Path) -> None:
    folder = write_package(build_world(room), tmp_path / "out", formats=("dae", "obj"))
    for kind in ("dae", "obj"):
        scene = trimesh.load_scene(folder / "meshes" / f"room.{kind}")
        tops = sorted(float(shape.bounds[1, 2]) for shape in scene.geometry.values())
        assert tops == pytest.approx([0.0, 2.5], abs=1e-6)
        whole = trimesh.load(folder / "meshes" / f"room.{kind}", force="mesh")
        whole.merge_vertices(merge_tex=True, merge_norm=True, digits_vertex=5)
        assert whole.is_watertight
    used = {path.name for path in (folder / "materials/textures").iterdir()}
    assert used == {"room.png", "room-walls.png"}


def test_options_that_cannot_be_kept_are_refused(peak: Path, ortho: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="give --texture FILE"):
        build_world(peak, BuildOptions(drape=True))
    with pytest.raises(ConfigError, match="leave out --option texture-size"):
        BuildOptions(drape=True, texture=ortho, texture_size=3)
    with pytest.raises(ConfigError, match="has no walls"):
        build_world(peak, BuildOptions(wall_texture=ortho))


def test_a_heightmap_wears_a_square_picture_and_flat_normals(peak: Path, ortho: Path, tmp_path: Path) -> None:
    options = BuildOptions(size=(30, 20), height=5, texture=ortho, drape=True)
    folder = write_package(build_world(peak, options), tmp_path, formats=("sdf",), terrain="heightmap")
    square = cv2.imread(str(folder / "materials/textures/peak-square.png"))[..., ::-1]
    assert square.shape[0] == square.shape[1]
    # The world lies in the lower two thirds.
    n = len(square)
    assert like(square[n - 5, 5], BLUE)
    assert like(square[n - int(n * 0.6), 5], RED)
    assert like(square[n - int(n * 0.6), n - 5], GREEN)
    sdf = (folder / "model.sdf").read_text()
    assert "peak-normal.png</normal>" in sdf
    assert "peak-square.png</diffuse>" in sdf
