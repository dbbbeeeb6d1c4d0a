"""A file reads others in its own folder or package only, and nothing from a network."""

import json
import socket
import struct
import threading
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import rasterio
import trimesh
from PIL import Image

from lirs_wct.errors import SourceError
from lirs_wct.export.package import write_package
from lirs_wct.files import referenced_file
from lirs_wct.formats.elevation import read_raster
from lirs_wct.formats.map_server import read_map
from lirs_wct.formats.meshes.reader import read_textured
from lirs_wct.formats.meshes.writers import MeshPart, write_parts
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.sources.build import build_world
from tests.kit import refused

RAW = """<VRTDataset rasterXSize="4" rasterYSize="4"><VRTRasterBand dataType="Byte" band="1" {kind}>
{source}</VRTRasterBand></VRTDataset>"""
RAW_BAND = 'subClass="VRTRawRasterBand"'
WMS = """<GDAL_WMS><Service name="TMS"><ServerUrl>{url}/${{z}}/${{x}}/${{y}}.png</ServerUrl></Service>
<DataWindow><UpperLeftX>0</UpperLeftX><UpperLeftY>4</UpperLeftY><LowerRightX>4</LowerRightX><LowerRightY>0
</LowerRightY><TileLevel>0</TileLevel></DataWindow><BandsCount>1</BandsCount></GDAL_WMS>"""


@pytest.fixture
def listener() -> Iterator[tuple[str, list[str]]]:
    """Yield the URL of a server on this machine, and the connections it saw."""
    seen: list[str] = []
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer() -> None:
            while True:
                try:
                    caller, _ = server.accept()
                except OSError:
                    return
                with caller:
                    seen.append(repr(caller.recv(1000)))
                    caller.sendall(b"HTTP/1.0 404 Not Found\r\n\r\n")

        threading.Thread(target=answer, daemon=True).start()
        yield f"http://127.0.0.1:{server.getsockname()[1]}", seen
        server.shutdown(socket.SHUT_RDWR)


def refuse_raster(path: Path, text: str, reason: str) -> None:
    path.write_text(text)
    with refused(path.parent, reason):
        read_raster(path)


@pytest.mark.parametrize(
    ("name", "legal"),
    [
        ("a.png", "a.png"),
        ("sub/a.png", "sub/a.png"),
        ("sub/../a.png", "a.png"),
        ("../a.png", None),
        ("/etc/passwd", None),
        ("file:///etc/passwd", None),
        ("link.png", None),
        ("linked/hostname", None),
        ("http://127.0.0.1/a.png", None),
        ("/vsicurl/http://127.0.0.1/a.png", None),
        ("NETCDF:/etc/passwd:z", None),
        ("vrt:///etc/passwd", None),
        ("<VRTDataset/>", None),
        ("model://other/a.png", None),
    ],
)
def test_names_in_the_folder_are_legal(name: str, legal: str | None, tmp_path: Path) -> None:
    (tmp_path / "link.png").symlink_to("/etc/passwd")
    (tmp_path / "linked").symlink_to("/etc")
    owner = tmp_path / "a.obj"
    if legal is None:
        with pytest.raises(SourceError, match=rf"^{owner}: names .*only files in"):
            referenced_file(owner, name)
    else:
        assert referenced_file(owner, name) == tmp_path / legal


@pytest.mark.parametrize("mark", ["model.config", "world.json"])
def test_a_package_is_one_folder(mark: str, tmp_path: Path) -> None:
    (tmp_path / "one" / "meshes").mkdir(parents=True)
    (tmp_path / "one" / mark).write_text("")
    owner = tmp_path / "one" / "meshes" / "a.dae"
    assert referenced_file(owner, "../materials/a.png") == tmp_path / "one" / "materials" / "a.png"
    assert referenced_file(owner, "model://two/a.png") == tmp_path / "two" / "a.png"
    for name in (
        "../../two/a.png",
        "model://../a.png",
        "https://fuel.gazebosim.org/1.0/a",
        "package://two/a",
    ):
        with pytest.raises(SourceError, match="only files in"):
            referenced_file(owner, name)


@pytest.mark.parametrize("suffix", ["vrt", "tif", "png", "nc"])
def test_what_refers_to_other_rasters_is_refused(
    listener: tuple[str, list[str]], tmp_path: Path, suffix: str
) -> None:
    url, seen = listener
    source = f'<SourceFilename relativeToVRT="0">/vsicurl/{url}/a.tif</SourceFilename>'
    path = tmp_path / f"a.{suffix}"
    refuse_raster(path, RAW.format(kind=RAW_BAND, source=source), "is a VRT, which refers to other files")
    refuse_raster(path, WMS.format(url=url), "is neither a picture nor elevation data")
    assert seen == []


@pytest.mark.parametrize("driver", ["HFA", "GTiff"])
def test_sidecars_lead_nowhere_else(listener: tuple[str, list[str]], tmp_path: Path, driver: str) -> None:
    url, seen = listener
    path = tmp_path / "a.img"
    profile = {"driver": driver, "width": 4, "height": 4, "count": 1, "dtype": "float32"}
    with rasterio.open(path, "w", **profile) as file:
        file.write(np.eye(4, dtype=np.float32), 1)
    (tmp_path / "a.img.msk").write_text(WMS.format(url=url))
    (tmp_path / "a.img.ovr").write_text(RAW.format(kind=RAW_BAND, source=f"/vsicurl/{url}/b.tif"))
    np.testing.assert_array_equal(read_raster(path).pixels, np.eye(4))
    for name in (f"/vsicurl/{url}/a.ovr", f"/vsis3/{url}/a.ovr", f"WMS:{url}", "a.img.msk"):
        (tmp_path / "a.img.aux.xml").write_text(
            f'<PAMDataset><Metadata domain="OVERVIEWS"><MDI key="OVERVIEW_FILE">{name}</MDI></Metadata>'
            f'<Metadata domain="GEOLOCATION"><MDI key="X_DATASET">{name}</MDI></Metadata></PAMDataset>'
        )
        np.testing.assert_array_equal(read_raster(path).pixels, np.eye(4))
    assert seen == []


def quad(texture: str, folder: Path, kind: str) -> Path:
    """Write a square of two triangles that names a picture; return its path."""
    path = folder / f"a.{kind}"
    corners = "0 0 0 1 0 0 1 1 0 0 1 0"
    if kind == "obj":
        v = "\n".join(f"v {corners[i : i + 5]}" for i in range(0, 24, 6))
        path.write_text(f"mtllib a.mtl\n{v}\nvt 0 0\nusemtl m\nf 1/1 2/1 3/1\nf 1/1 3/1 4/1\n")
        (folder / "a.mtl").write_text(f"newmtl m\nmap_Kd {texture}\n")
    elif kind == "ply":
        path.write_text(
            f"ply\nformat ascii 1.0\ncomment TextureFile {texture}\nelement vertex 4\nproperty float x\n"
            "property float y\nproperty float z\nproperty float s\nproperty float t\nelement face 2\n"
            "property list uchar int vertex_indices\nend_header\n0 0 0 0 0\n1 0 0 1 0\n1 1 0 1 1\n0 1 0 0 1\n"
            "3 0 1 2\n3 0 2 3\n"
        )
    elif kind == "dae":
        vertices = np.array(corners.split(), float).reshape(4, 3)
        faces, up = np.array([[0, 1, 2], [0, 2, 3]], np.int32), np.tile((0.0, 0.0, 1.0), (4, 1))
        part = MeshPart("m", TriangleMesh(vertices, faces, vertices[:, :2], up), texture)
        write_parts(path, [part])
    else:
        Image.new("RGB", (2, 2)).save(folder / "inner.png")
        material = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.open(folder / "inner.png"))
        vertices = np.array(corners.split(), float).reshape(4, 3)
        visual = trimesh.visual.TextureVisuals(uv=vertices[:, :2], material=material)
        mesh = trimesh.Trimesh(vertices, [[0, 1, 2], [0, 2, 3]], visual=visual, process=False)
        path.write_bytes(naming(mesh.export(file_type="glb"), texture))
    return path


def naming(glb: bytes, texture: str) -> bytes:
    """Return a GLB whose picture is a file."""
    size = struct.unpack_from("<I", glb, 12)[0]
    tree, rest = json.loads(glb[20 : 20 + size]), glb[20 + size :]
    tree["images"] = [{"uri": texture}]
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text) + len(rest), len(text), b"JSON")
    return head + text + rest


@pytest.mark.parametrize("kind", ["obj", "dae", "glb", "ply"])
def test_a_mesh_takes_its_picture_from_its_folder(
    kind: str, listener: tuple[str, list[str]], tmp_path: Path
) -> None:
    url, seen = listener
    folder = tmp_path / "mesh"
    folder.mkdir()
    for place in (tmp_path, folder):
        Image.new("RGB", (3, 5)).save(place / "t.png")
    (folder / "link.png").symlink_to(tmp_path / "t.png")
    with warnings.catch_warnings(action="error"):
        warnings.simplefilter("ignore", DeprecationWarning)  # pycollada's with NumPy 2.5
        picture = read_textured(quad("t.png", folder, kind)).picture
    assert picture.size == (3, 5)
    for name in ("../t.png", str(tmp_path / "t.png"), "link.png", f"{url}/t.png"):
        path = quad(name, folder, kind)
        with pytest.warns(UserWarning, match=rf"^{path}: names .*left out$") as told:
            picture = read_textured(path).picture
        assert picture is None or picture.size != (3, 5)
        assert any(name in str(warning.message) for warning in told)
    assert seen == []


def test_buffers_and_material_files_elsewhere(listener: tuple[str, list[str]], tmp_path: Path) -> None:
    url, seen = listener
    path = quad("t.png", tmp_path, "obj")
    path.write_text(path.read_text().replace("a.mtl", "../a.mtl"))
    with pytest.warns(UserWarning, match=r"names '\.\./a\.mtl'.*left out$"):
        read_textured(path)
    for uri in (f"{url}/a.bin", "/etc/passwd"):
        text = json.dumps({"asset": {"version": "2.0"}, "buffers": [{"uri": uri, "byteLength": 9}]}).encode()
        text += b" " * (-len(text) % 4)
        glb = tmp_path / "a.glb"
        glb.write_bytes(struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text), len(text), b"JSON") + text)
        with pytest.raises(SourceError, match=rf"^{glb}: "):
            build_world(glb)
    assert seen == []


def test_the_map_of_a_yaml_may_lie_elsewhere(tmp_path: Path) -> None:
    (tmp_path / "maps").mkdir()
    Image.fromarray(np.full((4, 4), 254, np.uint8)).save(tmp_path / "a.png")
    yaml = tmp_path / "maps" / "a.yaml"
    for name in ("../a.png", str(tmp_path / "a.png")):
        yaml.write_text(f"image: {name}\nresolution: 0.1\norigin: [0, 0, 0]\n")
        assert read_map(yaml).shape == (4, 4)


def test_a_built_folder_names_its_own_files(tmp_path: Path) -> None:
    picture = tmp_path / "hill.png"
    Image.fromarray(np.add.outer(np.arange(9), np.arange(9)).astype(np.uint8) * 9).save(picture)
    folder = write_package(build_world(picture), tmp_path / "built", formats=("stl",))
    path = folder / "world.json"
    entry = json.loads(path.read_text())
    path.write_text(json.dumps(entry | {"arrays": "../world.npz"}))
    with pytest.raises(SourceError, match=rf"^{path}: names '\.\./world\.npz'"):
        build_world(folder)
