"""Point clouds of a scene whose ground is known: hills with houses, trees, wrong points and a gap."""

import resource
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import trimesh
from pyproj import CRS

from lirs_wct.errors import ConfigError, SourceError
from lirs_wct.formats.point_clouds import read_points
from lirs_wct.sources.build import build_world
from lirs_wct.sources.point_cloud import NodeGrid, Smrf, fill_gaps, ground_points
from lirs_wct.sources.source import BuildOptions, SourceKind, find_source
from lirs_wct.world import World
from tests.kit import refused

SIDE = 60.0
POND = (42.0, 16.0, 11.0)
"""x, y, radius without points."""
UTM = (583_990.0, 4_507_553.0)


def ground(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return 40 + 3 * np.sin(x / 25) + 2 * np.cos(y / 30) + 0.03 * x


@dataclass(frozen=True)
class Scene:
    xyz: np.ndarray
    bare: np.ndarray


def hills(seed: int) -> Scene:
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0, SIDE, (10_000, 2))
    xy = xy[np.hypot(xy[:, 0] - POND[0], xy[:, 1] - POND[1]) > POND[2]]
    z = ground(*xy.T) + rng.normal(0, 0.03, len(xy))
    bare = np.ones(len(xy), np.bool_)
    for _ in range(3):  # houses with flat roofs
        corner, size = rng.uniform(5, 42, 2), rng.uniform(6, 12, 2)
        inside = ((xy >= corner) & (xy <= corner + size)).all(axis=1)
        z[inside] = ground(*(corner + size / 2)) + rng.uniform(4, 9)
        bare[inside] = False
    tree = rng.random(len(xy)) < 0.15
    z[tree & bare] += rng.uniform(1.0, 12, int((tree & bare).sum()))
    bare[tree] = False
    wrong = rng.choice(len(xy), 5, replace=False)
    z[wrong] -= rng.uniform(15, 60, 5)
    bare[wrong] = False
    return Scene(np.column_stack((xy, z)), bare)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return hills(1)


def truth(world: World) -> np.ndarray:
    rows, cols = world.surface.shape
    west, _, _, north = world.surface.bounds
    x, y = west + np.arange(cols) * world.surface.cell[0], north - np.arange(rows) * world.surface.cell[1]
    return ground(*np.meshgrid(x, y))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_smrf_tells_ground_from_objects(seed: int) -> None:
    """The paper's mean over its 15 samples: 97 % right (table 4); here steep ground is missing."""
    scene = hills(seed)
    found, mountains = ground_points(scene.xyz, Smrf())
    assert mountains == 0
    assert (found == scene.bare).mean() > 0.97
    assert found[scene.bare].mean() > 0.98
    assert found[~scene.bare].mean() < 0.06


def volcano() -> Scene:
    """A cone of slope .7 with a crater, in a plain, with trees of a canopy and houses in the plain."""
    rng = np.random.default_rng(2)
    xy = rng.uniform(-54, 54, (9000, 2))
    r = np.hypot(*xy.T)
    z = 0.7 * np.clip(40 - np.where(r < 10, 20 - r, r), 0, None) + rng.normal(0, 0.03, len(xy))
    bare = np.ones(len(xy), np.bool_)
    for _ in range(20):
        crown = np.hypot(*(xy - rng.uniform(-54, 54, 2)).T) < rng.uniform(1.5, 4)
        crown &= (rng.random(len(xy)) < 0.7) & bare
        z[crown] += rng.uniform(4, 15)
        bare[crown] = False
    for corner in np.array(((-52, -52), (36, 40))):
        house = ((xy >= corner) & (xy <= corner + np.array((16, 11)))).all(axis=1)
        z[house], bare[house] = 7.0, False
    return Scene(np.column_stack((xy, z)), bare)


@pytest.mark.slow
def test_a_volcano_keeps_its_summit(tmp_path: Path) -> None:
    cone = volcano()
    summit = cone.bare & (np.abs(np.hypot(*cone.xyz[:, :2].T) - 10) < 6)
    fixed, _ = ground_points(cone.xyz, Smrf(mountain=np.inf))
    found, mountains = ground_points(cone.xyz, Smrf())
    assert fixed[summit].mean() < 0.6
    assert found[summit].mean() > 0.9
    assert found[~cone.bare].mean() < 0.06
    assert 0.2 < mountains < 0.5
    trimesh.PointCloud(cone.xyz).export(tmp_path / "a.ply")
    with pytest.warns(UserWarning, match=r"a\.ply: \d\d% of the area is steeper .* --option ground-slope"):
        world = build_world(tmp_path / "a.ply")
    assert world.surface.height_at(10, 0) == pytest.approx(0.7 * 30, abs=1.5)


def test_the_world_is_the_ground_and_gaps_are_named(scene: Scene, tmp_path: Path) -> None:
    trimesh.PointCloud(scene.xyz).export(tmp_path / "a.ply")
    with pytest.warns(
        UserWarning,
        match=r"a\.ply: \d+ of 3844 nodes at 0\.98\d* m have no point .* gap is \d\d\.\d m; \d+ of them",
    ):
        world = build_world(tmp_path / "a.ply", BuildOptions(resolution=SIDE / 61 * 1.0005))
    assert world.kind == "terrain"
    assert "SMRF" in world.scale
    error = world.surface.z - truth(world)
    assert np.sqrt((error**2).mean()) < 0.1
    assert np.percentile(np.abs(error), 99) < 0.4
    assert 0.2 < world.no_ground.sum() * world.surface.cell[0] ** 2 / (np.pi * POND[2] ** 2) < 0.9
    assert world.place is None


def test_the_top_is_a_surface_too(scene: Scene, tmp_path: Path) -> None:
    trimesh.PointCloud(scene.xyz).export(tmp_path / "a.ply")
    with pytest.warns(UserWarning, match="have no point"):
        world = build_world(tmp_path / "a.ply", BuildOptions(cloud_surface="top", resolution=1.0))
    assert (world.surface.z - truth(world)).max() > 4
    assert world.scale.endswith("the highest points")


@pytest.mark.filterwarnings("ignore:.*have no point")
@pytest.mark.parametrize("suffix", [".las", pytest.param(".laz", marks=pytest.mark.slow)])
def test_las_brings_its_place_and_its_classes(suffix: str, scene: Scene, tmp_path: Path) -> None:
    laspy = pytest.importorskip("laspy")
    path = tmp_path / f"a{suffix}"
    las = laspy.create(point_format=6, file_version="1.4")
    las.header.offsets, las.header.scales = (*UTM, 0.0), (0.001,) * 3
    las.header.add_crs(CRS.from_epsg(32618))
    las.x, las.y, las.z = scene.xyz[:, 0] + UTM[0], scene.xyz[:, 1] + UTM[1], scene.xyz[:, 2]
    las.write(path)
    by_filter = build_world(path, BuildOptions(resolution=1.0))
    las.classification = np.where(scene.bare, 2, 5).astype(np.uint8)
    las.write(path)
    by_class = build_world(path, BuildOptions(resolution=1.0))
    assert "SMRF" in by_filter.scale
    assert by_class.scale.endswith("the ground by the file's classes")
    assert np.sqrt(np.mean((by_filter.surface.z - by_class.surface.z) ** 2)) < 0.2
    place = by_class.place
    assert place.system.name == "EPSG:32618"
    assert by_class.surface.z.min() == 0
    at = np.array(place.coordinates(-10.0, -14.0)) - UTM
    height = by_class.surface.height_at(-10.0, -14.0) + (place.height or 0.0)
    assert float(height) == pytest.approx(float(ground(*at)), abs=0.15)
    latitude, longitude = by_class.to_geographic(0.0, 0.0)
    assert (float(latitude), float(longitude)) == pytest.approx((40.714889, -74.005254), abs=1e-5)
    # UTM's scale at this place, 1 m of it is 1.000313 m on the ground, is taken out.
    along = place.coordinates(100.0, 0.0)[0] - place.coordinates(0.0, 0.0)[0]
    assert along == pytest.approx(100 / 1.000313, abs=1e-3)


@pytest.mark.filterwarnings("ignore:.*have no point")
def test_windows_of_a_cloud_fit_with_one_zero(scene: Scene, tmp_path: Path) -> None:
    trimesh.PointCloud(scene.xyz[scene.bare]).export(tmp_path / "a.ply")
    west, east = (
        build_world(
            tmp_path / "a.ply",
            BuildOptions(cloud_surface="top", resolution=1.0, zero=30.0, window=(x, 30, 40)),
        )
        for x in (20, 40)
    )
    assert abs(float(west.surface.height_at(30, 30) - east.surface.height_at(30, 30))) < 0.3


@pytest.mark.filterwarnings("ignore:.*have no point")
def test_a_pcd_keeps_its_frame(scene: Scene, tmp_path: Path) -> None:
    pypcd4 = pytest.importorskip("pypcd4")
    pypcd4.PointCloud.from_xyz_points(scene.xyz.astype(np.float32)).save(tmp_path / "a.pcd")
    world = build_world(tmp_path / "a.pcd", BuildOptions(resolution=1.0))
    assert world.surface.bounds == pytest.approx((0, 0, SIDE, SIDE), abs=1.01)
    assert np.sqrt(((world.surface.z - truth(world)) ** 2).mean()) < 0.12
    trimesh.PointCloud(scene.xyz.astype(np.float32)).export(tmp_path / "a.ply")
    same = build_world(tmp_path / "a.ply", BuildOptions(resolution=1.0))
    np.testing.assert_allclose(same.surface.z, world.surface.z, atol=1e-5)


def test_a_pcd_without_counts_has_one_of_each(tmp_path: Path) -> None:
    header = (PCD % (1, 4, 4, b"ascii")).replace(b"COUNT 1 1 1\n", b"")
    for end in (b"\n", b"\r\n"):
        rows = b"0 0 1\n2 0 1\n0 2 1\n2 2 3\n"
        (tmp_path / "a.pcd").write_bytes((header + rows).replace(b"\n", end))
        np.testing.assert_array_equal(read_points(tmp_path / "a.pcd").xyz[3], (2, 2, 3))


def test_a_ply_with_faces_is_a_mesh(tmp_path: Path) -> None:
    trimesh.creation.box((1, 2, 3)).export(tmp_path / "box.ply")
    trimesh.PointCloud(np.eye(3)).export(tmp_path / "points.ply")
    kinds = [find_source(tmp_path / name, BuildOptions()).kind for name in ("box.ply", "points.ply")]
    assert kinds == [SourceKind.MESH, SourceKind.CLOUD]


def las_header(offset: int = 227, records: int = 0, points: int = 0, compressed: bool = False) -> bytes:
    """Return a LAS 1.2 header without what it announces."""
    head = bytearray(227)
    head[:4], head[24:26] = b"LASF", bytes((1, 2))
    struct.pack_into("<HIIBHI", head, 94, 227, offset, records, 0x80 * compressed, 20, points)
    return bytes(head)


@pytest.mark.parametrize(("suffix", "package"), [("las", "laspy"), ("laz", "laspy"), ("pcd", "pypcd4")])
def test_a_missing_package_is_named(
    suffix: str, package: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / f"a.{suffix}"
    path.write_bytes(las_header() if package == "laspy" else PCD % (1, 1, 1, b"ascii") + b"1 2 3\n")
    monkeypatch.setattr("lirs_wct.formats.point_clouds.find_spec", lambda _: None)
    with pytest.raises(SourceError, match=rf"a\.{suffix}: needs the package {package}: .*lirs-wct\[clouds\]"):
        build_world(path)


PCD = b"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT %d 1 1\nWIDTH %d\nHEIGHT 1\nPOINTS %d\nDATA %s\n"
MANY = 4_000_000_000


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("a.las", las_header(points=MANY), "needs more than 512 MiB of memory"),
        pytest.param(
            "a.laz",
            las_header(records=MANY),
            "cannot be read: its reader takes more than 5 s",
            marks=pytest.mark.slow,
        ),
        ("a.laz", las_header(offset=MANY), "needs more than 512 MiB of memory"),
        (
            "a.laz",
            las_header(points=MANY, compressed=True) + bytes(600),
            "VLR 'LasZipVlr' could not be found",
        ),
        ("a.pcd", PCD % (1, MANY, MANY, b"binary"), "is cut off: 4000000000 points announced, 0 there"),
        ("a.pcd", PCD % (1, MANY, MANY, b"ascii"), "is cut off: 4000000000 points announced, 0 there"),
        ("a.pcd", PCD % (MANY, 1, 1, b"binary"), "needs more than 512 MiB of memory"),
        (
            "a.pcd",
            PCD % (1, 9, 9, b"binary_compressed") + struct.pack("<II", 4, MANY) + bytes(4),
            "needs more than 512 MiB of memory",
        ),
        (
            "a.ply",
            b"ply\nformat ascii 1.0\nelement vertex 4000000000\nproperty float x\nproperty float y\n"
            b"property float z\nend_header\n",
            "cannot be read as a point cloud: is damaged or cut off: 4000000000 of vertex are not in it",
        ),
    ],
)
def test_counts_are_checked_against_the_size(name: str, content: bytes, reason: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss  # of a PLY: the reader of others has a limit
    with refused(f"{path}: {reason}"):
        build_world(path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000  # kilobytes


def test_clouds_that_are_none(tmp_path: Path) -> None:
    trimesh.PointCloud(np.eye(3)[:2]).export(tmp_path / "two.ply")
    trimesh.PointCloud(np.arange(9.0).reshape(3, 3) * (0, 1, 1)).export(tmp_path / "line.ply")
    (tmp_path / "cut.ply").write_bytes((tmp_path / "line.ply").read_bytes()[:-20])
    for name, reason in (
        ("two", "holds 2 points, a ground needs at least 3"),
        ("line", "a terrain needs an extent along x and y"),
        ("cut", "cannot be read as a point cloud"),
    ):
        with pytest.raises(SourceError, match=rf"{name}\.ply: {reason}"):
            build_world(tmp_path / f"{name}.ply")


@pytest.mark.parametrize(
    ("system", "keys", "unit"),
    [
        ("EPSG:2263", False, 1200 / 3937),
        ("EPSG:2263", True, 1200 / 3937),
        ("EPSG:2263+5703", False, 1.0),
        ("EPSG:2263+8228", False, 0.3048),
    ],
)
def test_a_las_in_feet(system: str, keys: bool, unit: float, tmp_path: Path) -> None:
    """Its extent was in meters, its heights were not."""
    laspy = pytest.importorskip("laspy")
    las = laspy.create(point_format=6, file_version="1.4")
    las.header.offsets, las.header.scales = (980_000, 200_000, 0), (0.001,) * 3
    if keys:
        directory = laspy.vlrs.known.GeoKeyDirectoryVlr()
        directory.geo_keys = [laspy.vlrs.known.GeoKeyEntryStruct(id=3072, count=1, value_offset=2263)]
        las.header.vlrs.append(directory)
    else:
        text = CRS(system).to_wkt("WKT1_GDAL")
        las.header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(text))
    x, y = np.random.default_rng(0).uniform(0, 300, (2, 2000))
    las.x, las.y, las.z = 980_000 + x, 200_000 + y, 50 + 0.1 * x
    las.write(tmp_path / "a.las")
    with pytest.warns(UserWarning, match="have no point"):
        world = build_world(tmp_path / "a.las")
    assert world.surface.size == pytest.approx((91.44, 91.44), abs=4)
    assert world.surface.relief == pytest.approx(30 * unit, rel=0.03)


PLY = "ply\nformat ascii 1.0\nelement {} 3\nproperty float x\nproperty uchar y\nproperty float {}\n"
FACES = "element face 1\nproperty list uchar int vertex_indices\n"
ROWS = "end_header\n1 2 3\n4 5 6\n7 8 8\n"


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (PLY.format("vertex", "red") + ROWS, "points need x, y and z; missing: z; got: x, y, red"),
        (PLY.format("vertex", "Z") + FACES + ROWS + "3 0 1 2\n", "missing: z; got: x, y, Z"),
        (PLY.format("point", "z") + ROWS, "points need x, y and z; missing: x, y, z; got: none"),
    ],
)
def test_a_ply_without_positions_says_what_it_has(text: str, reason: str, tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_text(text)
    with pytest.raises(SourceError, match=rf"a\.ply: .*{reason}"):
        build_world(tmp_path / "a.ply")


def test_a_window_beside_the_cloud(scene: Scene, tmp_path: Path) -> None:
    trimesh.PointCloud(scene.xyz).export(tmp_path / "a.ply")
    with pytest.raises(
        ConfigError, match=r"a\.ply: window 500,0,20 holds 0 points; the cloud has x 0\.\d+ to 59"
    ):
        build_world(tmp_path / "a.ply", BuildOptions(window=(500, 0, 20)))


def test_gaps_of_a_plane_are_the_plane() -> None:
    rows, cols = np.mgrid[0:40, 0:50].astype(float)
    plane = 3 + 0.7 * rows - 0.2 * cols
    holed = plane.copy()
    holed[10:25, 12:30] = np.nan
    holed[5, 40] = np.nan
    np.testing.assert_allclose(fill_gaps(holed), plane, atol=1e-9)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_slope_adds_no_roughness(seed: int) -> None:
    """A mean of points alone is off by the slope times the way to their middle: here 90 mm."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0, 60, (14_000, 2))
    grid = NodeGrid.over(xy, 1.0)
    x, y = grid.west + np.arange(grid.shape[1]), grid.south + np.arange(grid.shape[0])
    off = grid.mean(np.column_stack((xy, 0.5 * xy[:, 0] - 0.3 * xy[:, 1]))) - (0.5 * x - 0.3 * y[:, None])
    assert np.sqrt(np.nanmean(off**2)) < 0.02


@pytest.mark.parametrize("suffix", ["las", "laz"])
@pytest.mark.parametrize("content", [b"", b"\x89PNG\r\n\x1a\n", bytes(range(200))])
def test_what_is_no_las_file_says_so_and_asks_for_no_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str, content: bytes
) -> None:
    monkeypatch.setattr("lirs_wct.formats.point_clouds.find_spec", lambda _: None)
    path = tmp_path / f"a.{suffix}"
    path.write_bytes(content)
    with pytest.raises(SourceError, match=rf"a\.{suffix}: is (empty|not a LAS file: .*b'LASF')"):
        build_world(path)


def test_a_stray_point_far_off_is_refused_at_once(tmp_path: Path) -> None:
    xyz = np.random.default_rng(1).uniform(0, 20, (2000, 3))
    xyz[0, :2] = 9000.0
    path = tmp_path / "stray.ply"
    trimesh.PointCloud(xyz).export(path)
    with pytest.raises(SourceError, match=r"stray\.ply: 99.7% of the nodes .* have no point: .*--window"):
        build_world(str(path))


@pytest.mark.parametrize("count", [3, 4, 9, 400])
@pytest.mark.parametrize(
    "shape",
    [
        lambda t, z: (t, t, z),
        lambda t, z: (t, 0 * t, z),
        lambda t, z: (3 * t, 1e-7 * z, z),
        lambda t, z: (t + 1e-3 * z, t - 1e-3 * z, z),
        lambda t, z: (t, 2 * t, 0 * t),
    ],
    ids=["diagonal wall", "wall along x", "thin sheet", "diagonal sheet", "line"],
)
def test_lines_and_sheets_are_refused_in_one_line(
    shape: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, ...]], count: int, tmp_path: Path
) -> None:
    rng = np.random.default_rng(count)
    xyz = np.stack(shape(np.linspace(0, 20, count), rng.uniform(0, 3, count)), axis=1)
    trimesh.PointCloud(xyz).export(tmp_path / "sheet.ply")
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(SourceError, match=r"^\S+sheet\.ply: a terrain needs an extent .*in plan$"):
        build_world(tmp_path / "sheet.ply")
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # kilobytes
