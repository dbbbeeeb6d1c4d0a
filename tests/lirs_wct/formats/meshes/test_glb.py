"""GLB: numbers of every kind, extensions, and instances."""

import io
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from lirs_wct.errors import SourceError
from lirs_wct.formats.meshes.reader import read_textured, read_upright
from tests.kit import refused

PLACES = np.array([(x, y, z) for z in (0, 1) for y in (0, 3) for x in (0, 2)], "<f4")
QUADS = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
BOX = np.array([t for a, b, c, d in QUADS for t in ((a, b, c), (a, c, d))], "<u2").ravel()
CODES = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
WIDTHS = {1: "SCALAR", 2: "VEC2", 3: "VEC3"}


class Glb:
    """A GLB in the making: one box; y is up."""

    def __init__(self) -> None:
        self.binary = b""
        self.tree: dict[str, Any] = {"asset": {"version": "2.0"}, "bufferViews": [], "accessors": []}
        self.tree |= {"scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}]}
        primitive = {"attributes": {"POSITION": self.add(PLACES)}, "indices": self.add(BOX)}
        self.tree["meshes"] = [{"name": "box", "primitives": [primitive]}]
        self.primitive: dict[str, Any] = primitive

    def view(self, values: np.ndarray) -> int:
        self.binary += bytes(-len(self.binary) % 4)
        self.tree["bufferViews"].append(
            {"buffer": 0, "byteOffset": len(self.binary), "byteLength": values.nbytes}
        )
        self.binary += values.tobytes()
        return len(self.tree["bufferViews"]) - 1

    def add(self, values: np.ndarray, **more: object) -> int:
        """Return the accessor of numbers."""
        kind = {"componentType": CODES[values.dtype.str[1:]], "type": WIDTHS[values[:1].size]}
        self.tree["accessors"].append({"bufferView": self.view(values), "count": len(values), **kind, **more})
        return len(self.tree["accessors"]) - 1

    def write(self, path: Path) -> Path:
        self.tree.setdefault("buffers", [{"byteLength": len(self.binary)}])
        text = json.dumps(self.tree).encode()
        text += b" " * (-len(text) % 4)
        binary = self.binary + bytes(-len(self.binary) % 4)
        body = struct.pack("<II", len(text), 0x4E4F534A) + text
        body += struct.pack("<II", len(binary), 0x004E4942) + binary
        path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body)
        return path


def size(path: Path) -> list[float]:
    mesh = read_upright(path)
    assert mesh.is_watertight
    assert mesh.volume > 0
    sides: list[float] = np.ptp(mesh.bounds, axis=0).round(3).tolist()
    return sides


@pytest.mark.parametrize(("kind", "largest"), [("<i1", 127), ("<u1", 255), ("<i2", 32767), ("<u2", 65535)])
def test_normalized_integers(tmp_path: Path, kind: str, largest: int) -> None:
    glb = Glb()
    glb.primitive["attributes"]["POSITION"] = glb.add(
        (PLACES / 3 * largest).round().astype(kind), normalized=True
    )
    glb.tree["nodes"] = [{"mesh": 0, "scale": [3, 3, 3]}]
    glb.tree["extensionsRequired"] = ["KHR_mesh_quantization"]
    assert np.allclose(size(glb.write(tmp_path / "a.glb")), (2, 1, 3), atol=3 / largest)


@pytest.mark.parametrize("base", [True, False])
def test_sparse_numbers(tmp_path: Path, base: bool) -> None:
    glb, kept = Glb(), np.flatnonzero(PLACES.any(axis=1)) if not base else np.array([1, 3, 5, 7])
    values = PLACES * (0.5, 1, 1) if base else np.zeros_like(PLACES)
    entry = glb.tree["accessors"][glb.add(values.astype("<f4"))]
    indices = {"bufferView": glb.view(kept.astype("<u2")), "componentType": CODES["u2"]}
    entry["sparse"] = {
        "count": len(kept), "indices": indices, "values": {"bufferView": glb.view(PLACES[kept])}
    }  # fmt: skip
    if not base:
        del entry["bufferView"]
    glb.primitive["attributes"]["POSITION"] = len(glb.tree["accessors"]) - 1
    assert size(glb.write(tmp_path / "a.glb")) == [2, 1, 3]


def test_normalized_texture_coordinates_are_left_out(tmp_path: Path) -> None:
    glb, png = Glb(), io.BytesIO()
    Image.new("RGB", (2, 2), "red").save(png, "PNG")
    uv = (PLACES[:, :2] / 3 * 65535).round().astype("<u2")
    glb.primitive["attributes"]["TEXCOORD_0"] = glb.add(uv, normalized=True)
    glb.primitive["material"] = 0
    glb.tree["images"] = [
        {"bufferView": glb.view(np.frombuffer(png.getvalue(), "<u1")), "mimeType": "image/png"}
    ]
    glb.tree |= {"textures": [{"source": 0}]}
    glb.tree["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
    with pytest.warns(UserWarning, match="materials and colors cannot be read and are left out"):
        found = read_textured(glb.write(tmp_path / "a.glb"))
    assert (found.picture, found.mesh.uv) == (None, None)


@pytest.mark.parametrize("required", [True, False])
@pytest.mark.parametrize("name", ["KHR_draco_mesh_compression", "EXT_meshopt_compression", "ACME_shapes"])
def test_an_extension_that_is_not_read(tmp_path: Path, name: str, required: bool) -> None:
    glb = Glb()
    if "meshopt" in name:
        glb.tree["buffers"] = [{"byteLength": len(glb.binary)}, {"byteLength": 1}]
        glb.tree["bufferViews"][0] |= {"buffer": 1, "extensions": {name: {"buffer": 0}}}
    elif "draco" in name:
        del glb.tree["accessors"][0]["bufferView"]
        glb.primitive["extensions"] = {name: {"bufferView": 0, "attributes": {}}}
    elif not required:
        assert size(Glb().write(tmp_path / "a.glb")) == [2, 1, 3]
        return
    glb.tree["extensionsUsed"] = [name]
    if required:
        glb.tree["extensionsRequired"] = [name, "KHR_materials_unlit"]
    with pytest.raises(SourceError, match=rf"a\.glb: .*needs the extension {name}, which is not read"):
        read_upright(glb.write(tmp_path / "a.glb"))


@pytest.mark.parametrize(
    "name",
    [
        "KHR_materials_unlit",
        "KHR_texture_transform",
        "KHR_texture_basisu",
        "KHR_lights_punctual",
        "EXT_texture_webp",
    ],
)
def test_an_extension_that_changes_no_shape(tmp_path: Path, name: str) -> None:
    glb = Glb()
    glb.tree["extensionsRequired"] = [name]
    assert size(glb.write(tmp_path / "a.glb")) == [2, 1, 3]


@pytest.mark.parametrize(("mode", "corners"), [(5, [0, 1, 3, 2]), (6, [0, 1, 2, 3])])
def test_strips_and_fans(tmp_path: Path, mode: int, corners: list[int]) -> None:
    glb = Glb()
    places = np.array([(0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0)], "<f4")
    glb.primitive |= {"attributes": {"POSITION": glb.add(places)}, "mode": mode}
    glb.primitive["indices"] = glb.add(np.array(corners, "<u2"))
    mesh = read_upright(glb.write(tmp_path / "a.glb"))
    assert len(mesh.faces) == 2
    np.testing.assert_allclose(mesh.face_normals, [(0, -1, 0)] * 2, atol=1e-9)


def test_places_of_instances(tmp_path: Path) -> None:
    glb, half = Glb(), 0.5**0.5
    glb.tree["scenes"] = [{"nodes": [0, 1, 3]}]
    glb.tree["nodes"] = [
        {"mesh": 0},
        {"translation": [10, 0, 0], "rotation": [0, 0, half, half], "scale": [2, 1, 1], "children": [2]},
        {"mesh": 0, "matrix": [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1], "camera": 0},
        {"camera": 0, "translation": [0, 0, 7], "children": [4]},
        {"mesh": 0},
    ]
    glb.tree["cameras"] = [{"type": "perspective", "perspective": {"yfov": 1, "znear": 1}}]
    assert size(glb.write(tmp_path / "a.glb")) == [10, 8, 7]


def test_a_skin_and_morph_targets_are_named(tmp_path: Path) -> None:
    glb = Glb()
    glb.tree["nodes"][0]["skin"] = 0
    glb.tree["skins"] = [{"joints": [0]}]
    with pytest.warns(UserWarning, match=r"a\.glb: mesh `box` is read as its plain shape, without skin and"):
        assert size(glb.write(tmp_path / "a.glb")) == [2, 1, 3]


@pytest.mark.parametrize("start", [-200, 4, 10**6])
def test_a_view_beyond_its_buffer(tmp_path: Path, start: int) -> None:
    glb = Glb()
    glb.tree["accessors"][1]["byteOffset"] = start
    with pytest.raises(
        SourceError, match=rf"a\.glb: .*36 numbers at byte {96 + start} are not in its buffer"
    ):
        read_upright(glb.write(tmp_path / "a.glb"))


@pytest.mark.parametrize(
    ("nodes", "reason"),
    [
        ([{"mesh": 0, "children": [1]}, {"children": [0]}], "is nested too deeply"),
        ([{"mesh": 0, "children": [0, 0]}], "is nested too deeply"),
        ([{"mesh": 7}], "names entry 7 of its meshes, there are 1"),
        ([{"mesh": -1}], "names entry -1 of its meshes, there are 1"),
        ([{"mesh": 0, "children": [5]}], "names entry 5 of its nodes, there are 1"),
    ],
)
def test_one_line_says_the_fault(tmp_path: Path, nodes: list[dict[str, Any]], reason: str) -> None:
    glb = Glb()
    glb.tree["nodes"] = nodes
    with refused(f"{tmp_path / 'a.glb'}: ", reason):
        read_upright(glb.write(tmp_path / "a.glb"))
