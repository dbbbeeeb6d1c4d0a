"""OBJ as programs write it: relative indices, tabs, continued lines, any polygons."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from lirs_wct.formats.meshes.reader import read_textured, read_upright

PLACES = [(x, y, z) for z in (0, 1) for y in (0, 3) for x in (0, 2)]
QUADS = [(1, 3, 4, 2), (5, 6, 8, 7), (1, 2, 6, 5), (3, 7, 8, 4), (1, 5, 7, 3), (2, 4, 8, 6)]


def box(corner: str = "{}", shift: float = 0) -> str:
    """Return the text of a box of 2 x 3 x 1 m."""
    lines = [f"v {x + shift} {y} {z}" for x, y, z in PLACES]
    return "\n".join([*lines, *("f " + " ".join(corner.format(i) for i in q) for q in QUADS)]) + "\n"


def area(path: Path) -> float:
    return float(read_upright(path).face_areas.sum())


WRITTEN = {
    "tabs": box().replace(" ", "\t"),
    "indented": "".join(f"  {line}\n" for line in box().splitlines()),
    "CRLF": box().replace("\n", "\r\n"),
    "CR": box().replace("\n", "\r"),
    "continued": box().replace("f 1 3 ", "f 1 3\\\n"),
    "comments": "# C:\\models\\\n" + box().replace("f 1 3 4 2", "f 1 3 4 2 # floor"),
    "byte order mark": "\ufeff" + box(),
    "trailing spaces": box().replace("\n", "  \n"),
    "mixed forms": "vn 0 0 1\nvt 0 0\n" + box("{}//1").replace("f 1//1 3//1 4//1 2//1", "f 1/1 3/1/1 4 2"),
}


@pytest.mark.parametrize("kind", WRITTEN)
def test_a_box_however_it_is_written(tmp_path: Path, kind: str) -> None:
    (tmp_path / "a.obj").write_text(WRITTEN[kind], newline="")
    mesh = read_upright(tmp_path / "a.obj")
    np.testing.assert_array_equal(mesh.bounds, [(0, 0, 0), (2, 3, 1)])
    assert len(mesh.faces) == 12
    assert mesh.is_watertight
    assert area(tmp_path / "a.obj") == pytest.approx(22)


def test_relative_indices_count_from_the_vertices_so_far(tmp_path: Path) -> None:
    lines = []
    for shift, material in ((0, "a"), (5, "b"), (10, "a")):
        lines += [f"v {x + shift} {y} {z}" for x, y, z in PLACES] + [
            "vt 0 0",
            "vn 0 0 1",
            f"usemtl {material}",
        ]
        lines += ["f " + " ".join(f"{i - 9}/-1/-1" for i in quad) for quad in QUADS]
    (tmp_path / "a.obj").write_text("\n".join(lines))
    mesh = read_upright(tmp_path / "a.obj")
    np.testing.assert_array_equal(mesh.bounds, [(0, 0, 0), (12, 3, 1)])
    assert len(mesh.faces) == 36
    assert mesh.is_watertight


def test_a_triangle_with_textures_is_no_hexagon(tmp_path: Path) -> None:
    """Both have six numbers; the loader of looks reads them as the first face says."""
    places = "v 0 0 0\nv 2 0 0\nv 3 1 0\nv 2 2 0\nv 0 2 0\nv -1 1 0\n"
    (tmp_path / "a.obj").write_text(f"{places}vt 0 0\nf 1/1 2/1 3/1\nf 1 2 3 4 5 6\n")
    assert area(tmp_path / "a.obj") == pytest.approx(1 + 6)
    with pytest.warns(UserWarning, match="materials and colors cannot be read"):
        assert read_textured(tmp_path / "a.obj").mesh.face_areas.sum() == pytest.approx(1 + 6)


def test_the_texture_of_a_concave_polygon_is_left_out(tmp_path: Path) -> None:
    Image.new("RGB", (2, 2), "red").save(tmp_path / "t.png")
    (tmp_path / "a.mtl").write_text("newmtl m\nmap_Kd t.png\n")
    ring = [(0, 0), (1.5, 0), (1.5, 2), (2.5, 2), (2.5, 0), (4, 0), (4, 3), (0, 3)]
    places = "".join(f"v {x} {y} 0\nvt {x / 4} {y / 3}\n" for x, y in ring)
    face = "f " + " ".join(f"{i}/{i}" for i in range(1, 9))
    (tmp_path / "a.obj").write_text(f"mtllib a.mtl\n{places}usemtl m\n{face}\n")
    with pytest.warns(UserWarning, match="materials and colors cannot be read and are left out"):
        found = read_textured(tmp_path / "a.obj")
    assert (found.picture, found.mesh.uv) == (None, None)
    assert found.mesh.face_areas.sum() == pytest.approx(10)
