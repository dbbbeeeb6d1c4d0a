"""Laser maps: read as map_server reads them, walls as boxes, cells and one closed solid."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from lirs_wct.errors import ConfigError, SourceError
from lirs_wct.formats.map_server import MapMetadata, read_map, read_map_picture, read_metadata, write_map
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.rectangles import merged_rectangles
from lirs_wct.geometry.walls import WallGrid
from lirs_wct.meshing.wall_solid import SLAB, wall_mesh
from lirs_wct.sources.laser_map import walls_of, without_small_walls

masks = hnp.arrays(np.bool_, hnp.array_shapes(min_dims=2, max_dims=2, max_side=9))
KEYS = "resolution: 0.5\norigin: [1.0, -2.0, 0.5]\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"


def a_map(folder: Path, pixels: np.ndarray, keys: str) -> OccupancyGrid:
    cv2.imwrite(str(folder / "m.png"), pixels)
    (folder / "m.yaml").write_text(f"image: m.png\n{KEYS}{keys}")
    return read_map(folder / "m.yaml")


def states(grid: OccupancyGrid) -> list[list[str]]:
    symbols = np.where(grid.occupied, "#", np.where(grid.free, ".", np.where(grid.known, "~", "?")))
    return [" ".join(row).split() for row in symbols[::-1]]


SHADES = np.array([[0, 89, 90, 205, 206, 254, 255]], np.uint8).repeat(2, axis=0)


def test_trinary_by_the_thresholds_of_the_yaml(tmp_path: Path) -> None:
    assert states(a_map(tmp_path, SHADES, "negate: 0\n"))[0] == ["#", "#", "?", "?", ".", ".", "."]
    assert states(a_map(tmp_path, SHADES, "negate: 1\n"))[0] == [".", "?", "?", "#", "#", "#", "#"]


def test_trinary_averages_alpha_and_scale_takes_it_as_unknown(tmp_path: Path) -> None:
    pixels = np.zeros((2, 3, 4), np.uint8)
    pixels[..., 3] = (0, 255, 255)
    pixels[:, 2, :3] = 255
    assert states(a_map(tmp_path, pixels, "negate: 0\n"))[0] == ["#", "#", "."]
    pixels[:, 1, 3] = 254
    assert states(a_map(tmp_path, pixels, "negate: 0\nmode: scale\n"))[0] == ["?", "?", "."]


def test_scale_and_raw_keep_what_lies_between(tmp_path: Path) -> None:
    scaled = a_map(tmp_path, SHADES, "negate: 0\nmode: scale\n").probability[0]
    p = (255 - 205) / 255
    assert scaled[3] == pytest.approx((p - 0.196) / (0.65 - 0.196), abs=1e-6)
    pixels = np.array([[0, 50, 100, 101, 255]], np.uint8).repeat(2, axis=0)
    raw = a_map(tmp_path, pixels, "negate: 0\nmode: raw\n").probability[0]
    np.testing.assert_allclose(raw, [0, 0.5, 1, np.nan, np.nan], atol=1e-5)


def test_row_0_is_the_south_and_the_origin_its_corner(tmp_path: Path) -> None:
    pixels = np.full((4, 6), 254, np.uint8)
    pixels[3, 0] = 0  # lower left of the picture
    grid = a_map(tmp_path, pixels, "negate: 0\n")
    np.testing.assert_allclose(grid.occupied_points(), [Pose2(1, -2, 0.5).apply((0.25, 0.25))])


@given(
    st.lists(st.lists(st.sampled_from((0.0, 1.0, np.nan)), min_size=4, max_size=4), min_size=2, max_size=6),
    st.floats(0.01, 1),
    st.floats(-9, 9),
)
@settings(max_examples=30)
def test_a_written_map_reads_back(
    tmp_path_factory: pytest.TempPathFactory, p: list[list[float]], resolution: float, yaw: float
) -> None:
    stem = tmp_path_factory.mktemp("map") / "room.v2"
    grid = OccupancyGrid.from_probability(p, np.float64(resolution), Pose2(-1.5, np.float64(2.25), yaw))
    write_map(stem, grid)
    again = read_map(stem.with_name("room.v2.yaml"))
    assert (again.resolution, again.origin) == (grid.resolution, grid.origin)
    assert states(again) == states(grid)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("image: m.png\n", "resolution, origin"),
        ("image: m.png\nresolution: 0\norigin: [0, 0, 0]\n", "resolution must be a finite number above 0"),
        (f"image: m.png\n{KEYS}mode: cubic\n", "trinary, scale, raw"),
        ("image: m.png\nresolution: 1\norigin: [0]\n", "origin must be [x, y, yaw]"),
        (f"image: m.png\n{KEYS}free_thresh: 0.9\n", "free_thresh"),
        ("- what\n", "line 1 is not `key: value`"),
        ("image: m.png\norigin: [0, 0\n", "line 3: while parsing a flow sequence, expected ',' or ']'"),
        ("image: 'm.png\n", "line 2: while scanning a quoted scalar, found unexpected end of stream"),
        ("image: a.png\n---\nimage: b.png\n", "line 2: expected a single document in the stream"),
        ("image: {a: b}\n", "image: a map has no use for nested values"),
        ("image: a\x01.png\n", "is not YAML: unacceptable character"),
        ("[" * 9999, "is not YAML: maximum recursion depth"),
        ("image: m.png\nresolution: [1]\norigin: [0, 0]\n", "resolution must be a number, got ['1']"),
        ("image: m.png\nresolution: 1\norigin: [a, b]\n", "origin must be [x, y, yaw], got ['a', 'b']"),
        ("image: !!python/object/apply:os.system [x]\n", "origin"),
        (f"image: gone.png\n{KEYS}", "gone.png"),
    ],
)  # fmt: skip
def test_a_bad_yaml_is_one_line_with_its_path(text: str, says: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    with pytest.raises(SourceError, match=r"bad\.yaml: ") as caught:
        read_map(path)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def read_text(text: str, folder: Path) -> MapMetadata:
    path = folder / "text.yaml"
    path.write_text(text)
    return read_metadata(path)


def test_yaml_takes_quotes_comments_and_block_lists(tmp_path: Path) -> None:
    text = "---\nimage: 'a # b.pgm'  # it\nresolution: 1e-2\norigin:\n- 1\n- -2.5\n- 3e-1\n"
    assert read_text(f'{text}negate: false\nmode: "raw"\nfree_thresh: 0.050000\n', tmp_path) == MapMetadata(
        image=tmp_path / "a # b.pgm",
        resolution=0.01,
        origin=Pose2(1.0, -2.5, 0.3),
        free_thresh=0.05,
        mode="raw",
    )


def test_names_that_look_like_other_things_stay_names(tmp_path: Path) -> None:
    for name in ("2020-01-01", "1.0", "yes", "null", "0x10", "12:30"):
        read = read_text(f"image: {name}\nresolution: 010\norigin: [1_0, 0, 0]\n", tmp_path)
        assert (read.image.name, read.resolution, read.origin.x) == (name, 10.0, 10.0)


@given(masks)
def test_boxes_cover_every_wall_cell_once(solid: np.ndarray) -> None:
    covered = np.zeros(solid.shape, int)
    for r0, c0, r1, c1 in merged_rectangles(solid):
        covered[r0:r1, c0:c1] += 1
    assert np.array_equal(covered, solid.astype(int))


@given(masks, st.floats(-3, 3))
def test_the_solid_is_closed_and_has_the_volume_of_its_cells(solid: np.ndarray, yaw: float) -> None:
    walls = WallGrid(solid, 0.5, Pose2(1, 2, yaw), 2.0)
    mesh = wall_mesh(walls)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(0.25 * (solid.size * SLAB + solid.sum() * 2.0), rel=1e-9)
    assert (np.linalg.norm(mesh.face_normals, axis=1) > 0.5).all()


kinds = hnp.arrays(np.int8, hnp.array_shapes(min_dims=2, max_dims=2, max_side=9), elements=st.integers(0, 2))


@given(kinds, st.floats(-3, 3))
def test_holes_go_through_and_leave_the_solid_closed(kind: np.ndarray, yaw: float) -> None:
    if not kind.any():
        return
    walls = WallGrid(kind == 2, 0.5, Pose2(1, 2, yaw), 2.0, kind == 0)
    mesh = wall_mesh(walls)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(0.25 * ((kind > 0).sum() * SLAB + (kind == 2).sum() * 2.0), rel=1e-9)
    assert (np.linalg.norm(mesh.face_normals, axis=1) > 0.5).all()
    below = mesh.face_normals[:, 2] < -0.5
    tops = mesh.vertices[mesh.faces[below]][:, :, 2]
    assert (tops == -SLAB).all()
    level = np.abs(mesh.face_normals[:, 2]) > 0.5
    centers = mesh.vertices[mesh.faces[level]].mean(axis=1)[:, :2]
    col, row = np.floor(walls.origin.inverse().apply(centers) / 0.5).astype(int).T
    assert (kind[row, col] > 0).all()


def test_unknown_cells_are_floor_wall_or_hole() -> None:
    p = np.array([[0.0, 1.0, np.nan], [np.nan, 0.5, 0.0]])
    grid = OccupancyGrid.from_probability(p, 0.1)
    assert walls_of(grid, 1.0).solid.tolist() == [[False, True, False], [False, False, False]]
    assert walls_of(grid, 1.0).hole is None
    assert walls_of(grid, 1.0, "wall").solid.tolist() == [[False, True, True], [True, False, False]]
    holed = walls_of(grid, 1.0, "hole")
    assert holed.hole is not None
    assert holed.hole.tolist() == [[False, False, True], [True, False, False]]
    assert holed.floor.tolist() == [[True, False, False], [False, True, True]]
    with pytest.raises(ConfigError, match="floor, hole, wall"):
        walls_of(grid, 1.0, "sea")  # type: ignore[arg-type]
    nothing = OccupancyGrid.from_probability(np.full((2, 2), np.nan), 0.1)
    with pytest.raises(ConfigError, match="every cell is a hole"):
        walls_of(nothing, 1.0, "hole")


def test_speckles_are_dropped_by_their_size() -> None:
    p = np.zeros((9, 9))
    p[0, 0] = p[1, 1] = p[2, 2] = 1.0  # three that touch at corners
    p[5, 5:7] = p[8, 0] = 1.0
    p[8, 8] = np.nan
    grid = OccupancyGrid.from_probability(p, 0.1)
    for least, left in ((0, 6), (1, 6), (2, 5), (3, 3), (4, 0)):
        cleaned = without_small_walls(grid, least)
        assert cleaned.occupied.sum() == left, least
        assert np.array_equal(cleaned.known, grid.known)
        assert cleaned.free.sum() == 80 - left
    assert without_small_walls(grid, 3).occupied[1, 1]


def test_yaml_is_read_as_pyyaml_reads_it(shared_data: Path, tmp_path: Path) -> None:
    texts = [path.read_text() for path in sorted(shared_data.glob("maps/*/*.yaml"))]
    texts += [
        "image: 'a # b.pgm'  # it\nresolution: 1\norigin:\n- 1\n- -2.5\n- 0.3\nnegate: 0\n",
        '---\nimage: "x y.png"\nresolution: 5.0e-2\norigin: [ -1.5,2 , .5 ]\nmode: scale\n',
        "image: it's.pgm\nresolution: 1\norigin: [0, 0]\nfree_thresh:   0.196\n\n# end\n",
    ]
    assert len(texts) > 12
    for text in texts:
        expected, ours = yaml.safe_load(text), read_text(text, tmp_path)
        assert ours.image == tmp_path / expected["image"]
        assert ours.origin == Pose2(*expected["origin"])
        for key in {"resolution", "occupied_thresh", "free_thresh", "negate", "mode"} & set(expected):
            assert getattr(ours, key) == expected[key], (key, text)


@pytest.mark.shared
def test_real_maps_become_closed_solids_of_few_boxes(shared_data: Path) -> None:
    """As many boxes as plain greedy rectangles give, or fewer; the plan's walls to the millimetre."""
    most = {"map": 214, "willow-2010-02-18-0.10": 453, "depot": 1307}
    read = 0
    for path in sorted(shared_data.glob("maps/*/*.yaml")):
        try:
            grid = read_map(path)
        except SourceError as error:
            assert "is not there" in str(error)  # noqa: PT017
            continue
        read += 1
        walls = walls_of(grid, 2.5)
        assert len(merged_rectangles(walls.solid)) <= most.get(path.stem, len(walls.solid) ** 2)
        mesh = wall_mesh(walls)
        assert mesh.is_watertight
        assert trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).is_watertight
        volume = walls.resolution**2 * (walls.solid.size * SLAB + walls.solid.sum() * 2.5)
        assert mesh.volume == pytest.approx(volume, rel=1e-9)
    assert read == 10


@pytest.mark.shared
def test_a_map_picture_alone(shared_data: Path) -> None:
    path = shared_data / "maps/navigation_tutorials/willow-full.pgm"
    grid = read_map_picture(path, 0.1)
    assert grid.occupied.any()
    assert grid.free.any()
    assert not grid.known.all()
