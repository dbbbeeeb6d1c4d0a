"""Mesh files as text and bytes: COLLADA, OBJ, STL and GLB.

COLLADA documents are streamed a few thousand rows at a time. Z_UP data with a Z_UP tag and meters is upright
in Gazebo (which ignores the tag) and in other programs. All parts are one geometry: one layer of texture
coordinates in Blender, and no seams between objects. VERTEX, NORMAL and TEXCOORD have separate offsets.
Gazebo merges equal positions, and keeps different normals and texture coordinates only with separate indices.

Indices make up most of a large file. There, two triangles of a grid cell become one quad, and frequent
normals have small indices.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from lirs_wct.arrays import ByteArray, Float32Array, FloatArray, Int32Array, IntArray, njit
from lirs_wct.errors import ConfigError
from lirs_wct.files import atomic_write
from lirs_wct.formats.meshes import STL_FACET
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.progress import Progress, no_progress, track

CREATED = "2020-01-01T00:00:00"
"""Constant creation time, so that the same world gives the same bytes."""
GROUND = (0.62, 0.57, 0.5, 1.0)
"""Color of a world without texture, RGBA."""
_UV_DECIMALS = 5

_ROWS = 1 << 14
"""Rows of numbers that are converted to text at a time."""

_HEAD = """<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><created>{created}</created><modified>{created}</modified>
<unit name="meter" meter="1"/><up_axis>Z_UP</up_axis></asset>
{images}<library_effects>{effects}</library_effects>
<library_materials>{materials}</library_materials>
<library_geometries><geometry id="mesh" name="mesh"><mesh>
"""
_IMAGES = "<library_images>{}</library_images>\n"
_IMAGE = '<image id="{name}-texture" name="{name}-texture"><init_from>{texture}</init_from></image>'
_EFFECT = """<effect id="{name}-effect"><profile_COMMON>{parameters}
<technique sid="common"><lambert><diffuse>{diffuse}</diffuse></lambert></technique>
</profile_COMMON></effect>
"""
_PARAMETERS = """<newparam sid="surface{k}"><surface type="2D"><init_from>{name}-texture</init_from></surface>
</newparam>
<newparam sid="sampler{k}"><sampler2D><source>surface{k}</source></sampler2D></newparam>"""
_MATERIAL = '<material id="{name}" name="{name}"><instance_effect url="#{name}-effect"/></material>\n'
_SOURCE = """<source id="{id}"><float_array id="{id}-array" count="{size}">
"""
_SOURCE_END = """</float_array><technique_common><accessor source="#{id}-array" count="{n}" stride="{k}">
{params}</accessor></technique_common></source>
"""
_VERTICES = """<vertices id="vertices"><input semantic="POSITION" source="#positions"/></vertices>
"""
_FACES = """<{kind} count="{count}" material="{name}">
<input semantic="VERTEX" source="#vertices" offset="0"/>
<input semantic="NORMAL" source="#normals" offset="1"/>
<input semantic="TEXCOORD" source="#UV" offset="2" set="0"/>
"""
_BOUND = """<instance_material symbol="{name}" target="#{name}"><bind_vertex_input semantic="UV" \
input_semantic="TEXCOORD" input_set="0"/></instance_material>
"""
_SCENE = """</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="scene"><node id="world" name="world">
<instance_geometry url="#mesh"><bind_material><technique_common>
{bound}</technique_common></bind_material></instance_geometry>
</node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#scene"/></scene></COLLADA>
"""


@dataclass(frozen=True)
class MeshPart:
    """Triangles of one material in the world frame, with the path of its picture relative to the file."""

    name: str
    mesh: TriangleMesh
    texture: str | None = None

    def __post_init__(self) -> None:
        if self.mesh.uv is None or self.mesh.normals is None:
            raise ConfigError("a mesh needs texture coordinates and normals to be written as COLLADA")

    @property
    def uv(self) -> FloatArray:
        """(n, 2) texture coordinates."""
        assert self.mesh.uv is not None
        return self.mesh.uv

    @property
    def normals(self) -> FloatArray:
        """(n, 3) unit normals."""
        assert self.mesh.normals is not None
        return self.mesh.normals


NORMAL_DIGITS, BRIEF_NORMAL_DIGITS = 3, 2
"""Decimals of normals in usual and in brief files (shading exact to 0.5 deg)."""


BULK = 500_000
"""Triangles above which a COLLADA file is compact: fewer digits, and quads."""


def write_parts(path: Path, parts: Sequence[MeshPart], progress: Progress = no_progress) -> None:
    """Write parts of one texture each as one geometry of a COLLADA file.

    In a compact file, two consecutive triangles with a shared edge become a quad whose fan from the first
    corner gives the two triangles again.
    """
    for part in parts:
        if part.texture is not None and any(c.isspace() for c in part.texture):
            raise ConfigError(f"path of a texture must not hold spaces, got {part.texture!r}")
    total, done = sum(len(part.mesh.faces) for part in parts), 0

    def passed(count: int) -> None:
        nonlocal done
        done += count
        progress(path.name, done / max(total, 1))

    brief = total > BULK
    digits = BRIEF_NORMAL_DIGITS if brief else NORMAL_DIGITS
    farthest = np.abs([part.mesh.bounds for part in parts]).max(axis=(0, 1))
    normals, numbers = _distinct([part.normals for part in parts], digits)
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        file.write(_head(parts).encode())
        positions = [part.mesh.vertices for part in parts]
        _write_source(file, "positions", positions, _position_decimals(farthest), "XYZ")
        _write_source(file, "normals", [normals], (digits,) * 3, "XYZ")
        _write_source(file, "UV", [part.uv for part in parts], (_UV_DECIMALS,) * 2, "ST")
        file.write(_VERTICES.encode())
        before = 0
        for part in parts:
            _write_faces(file, part, before, numbers, brief, passed)
            before += len(part.mesh.vertices)
        bound = "".join(_BOUND.format(name=part.name) for part in parts)
        file.write(_SCENE.format(bound=bound).encode())


def _distinct(tables: Sequence[FloatArray], decimals: int) -> tuple[FloatArray, Int32Array]:
    """Return the distinct rounded normals, most frequent first, and each vertex's index."""
    scale = 10**decimals
    x, y, z = (np.rint(np.concatenate([t[:, k] for t in tables]) * scale).astype(np.int64) for k in range(3))
    wide = 2 * scale + 1
    key, number, count = np.unique(
        ((x + scale) * wide + y + scale) * wide + z + scale, return_inverse=True, return_counts=True
    )
    order = np.argsort(-count, kind="stable")
    rank = np.empty(len(key), np.int32)
    rank[order] = np.arange(len(key), dtype=np.int32)
    parts = np.stack((key // wide**2, key // wide % wide, key % wide), axis=1)[order]
    return (parts - scale) / scale, rank[number]


def _write_faces(
    file: BinaryIO,
    part: MeshPart,
    before: int,
    normals: Int32Array,
    brief: bool,
    passed: Callable[[int], None],
) -> None:
    """Write the faces of a part whose vertices follow `before` others."""
    triangles = part.mesh.faces
    quads = triangles[:0]
    if brief:  # consecutive triangles (abc, bdc) become quads
        pairs = triangles[: len(triangles) // 2 * 2].reshape(-1, 2, 3)
        first, second = pairs[:, 0], pairs[:, 1]
        cell = (first[:, 1] == second[:, 0]) & (first[:, 2] == second[:, 2])
        quads = np.column_stack((second[cell], first[cell, 0]))
        triangles = np.concatenate((pairs[~cell].reshape(-1, 3), triangles[2 * len(pairs) :]))
    kind, count = ("polylist" if len(quads) else "triangles"), len(quads) + len(triangles)
    file.write(_FACES.format(kind=kind, count=count, name=part.name).encode())
    if len(quads):
        file.write(b"<vcount>" + b"4 " * len(quads) + b"3 " * len(triangles) + b"</vcount>")
    file.write(b"<p>\n")
    for polygons, each in ((quads, 2), (triangles, 1)):
        for chunk in _chunks(polygons):
            corners = chunk + before
            rows = np.stack((corners, normals[corners], corners), axis=2).reshape(len(chunk), -1)
            file.write(fixed_text(rows, 0))
            passed(each * len(chunk))
    file.write(f"</p></{kind}>\n".encode())


def _head(parts: Sequence[MeshPart]) -> str:
    color = f"<color>{' '.join(map(str, GROUND))}</color>"
    images, effects = [], []
    for k, part in enumerate(parts):
        parameters, diffuse = "", color
        if part.texture is not None:
            images.append(_IMAGE.format(name=part.name, texture=escape(part.texture)))
            parameters = _PARAMETERS.format(name=part.name, k=k or "")  # Gazebo takes the first of a name
            diffuse = f'<texture texture="sampler{k or ""}" texcoord="UV"/>'
        effects.append(_EFFECT.format(name=part.name, parameters=parameters, diffuse=diffuse))
    return _HEAD.format(
        created=CREATED,
        images=_IMAGES.format("".join(images)) if images else "",
        effects="".join(effects),
        materials="".join(_MATERIAL.format(name=part.name) for part in parts),
    )


def _write_source(
    file: BinaryIO, name: str, tables: Sequence[FloatArray], decimals: tuple[int, ...], axes: str
) -> None:
    n = sum(map(len, tables))
    params = "".join(f'<param name="{axis}" type="float"/>' for axis in axes)
    file.write(_SOURCE.format(id=name, size=n * len(axes)).encode())
    for table in tables:
        file.writelines(fixed_text(chunk, decimals) for chunk in _chunks(table))
    file.write(_SOURCE_END.format(id=name, n=n, k=len(axes), params=params).encode())


def _chunks(table: NDArray[Any]) -> Iterator[NDArray[Any]]:
    return (table[i : i + _ROWS] for i in range(0, len(table), _ROWS))


def _position_decimals(farthest: FloatArray) -> tuple[int, int, int]:
    """Return the decimals that distinguish float32 coordinates, given the largest absolute ones (3,).

    Fewer would break the error budget: a millimeter sideways is meters of height on rough ground.
    """
    step = np.spacing(farthest.astype(np.float32)).astype(np.float64)
    x, y, z = np.clip(np.ceil(-np.log10(step)), 0, 9).astype(int).tolist()
    return x, y, z


_METER_DECIMALS, _UNIT_DECIMALS = 6, 5


def write_obj(path: Path, parts: Sequence[tuple[str, TriangleMesh, str | None]]) -> None:
    """Write named meshes, with their texture coordinates and normals where they have them.

    A part with texture coordinates may have a picture, a path relative to the file. Each has a material in
    STEM.mtl in the same folder.
    """
    textured = [(name, mesh, file) for name, mesh, file in parts if file is not None and mesh.uv is not None]
    if textured:
        with atomic_write(path.with_suffix(".mtl")) as temporary:
            entries = (f"newmtl {name}\nKa 1 1 1\nKd 1 1 1\nmap_Kd {file}\n" for name, _, file in textured)
            temporary.write_text("".join(entries), encoding="utf-8")
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        file.write(b"# LIRS-WCT, meters, z up\n")
        if textured:
            file.write(f"mtllib {path.stem}.mtl\n".encode())
        written = 0
        for name, mesh, picture in parts:
            if picture is not None and mesh.uv is not None:
                file.write(f"usemtl {name}\n".encode())
            _write_part(file, mesh, written)
            written += len(mesh.vertices)


def _write_part(file: BinaryIO, mesh: TriangleMesh, written: int) -> None:
    """Write the vertices and faces of a part that follow `written` vertices."""
    for word, values, decimals in (
        (b"v", mesh.vertices, _METER_DECIMALS),
        (b"vt", mesh.uv, _UNIT_DECIMALS),
        (b"vn", mesh.normals, _UNIT_DECIMALS),
    ):
        for start in range(0, 0 if values is None else len(values), _ROWS):
            assert values is not None
            file.write(_lines(word, fixed_text(values[start : start + _ROWS], decimals)))
    numbers = 1 + (mesh.uv is not None) + (mesh.normals is not None)
    between = (b"/" * (numbers - 1) + b" ") * 3
    for start in range(0, len(mesh.faces), _ROWS):
        # Position, texture and normal of a corner share an index.
        corners = np.repeat(mesh.faces[start : start + _ROWS] + 1 + written, numbers, axis=1)
        text = fixed_text(corners, 0, between[:-1])
        # Without texture coordinates, the field between the slashes stays empty.
        file.write(_lines(b"f", text if mesh.uv is not None else text.replace(b"/", b"//")))


def _lines(word: bytes, rows: bytes) -> bytes:
    return word + b" " + rows[:-1].replace(b"\n", b"\n" + word + b" ") + b"\n"


def write_stl(path: Path, mesh: TriangleMesh, progress: Progress = no_progress) -> None:
    """Write a mesh as binary STL."""
    starts = range(0, len(mesh.faces), _ROWS)
    chunks = (mesh.vertices[mesh.faces[i : i + _ROWS]] for i in starts)
    write_triangles(path, len(mesh.faces), chunks, progress)


def write_triangles(
    path: Path, count: int, chunks: Iterable[FloatArray], progress: Progress = no_progress
) -> None:
    """Write triangles from parts of their corners (n, 3, 3), so that a surface may exceed the memory."""
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        # The header must not begin with "solid", which marks ASCII.
        file.write(struct.pack("<80sI", b"LIRS-WCT, meters, z up", count))
        for corners in track(chunks, count, len, path.name, progress):
            record = np.zeros(len(corners), dtype=STL_FACET)
            record["floats"] = _facets(np.ascontiguousarray(corners))
            file.write(record.data)


@njit
def _facets(corners: FloatArray) -> Float32Array:
    """Return (n, 12) unit normal and corners of each triangle; zero normal without area."""
    out = np.empty((len(corners), 12), np.float32)
    for i in range(len(corners)):
        a, b, c = corners[i]
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        scale = 1 / length if length > 0 else 0.0
        out[i, 0], out[i, 1], out[i, 2] = nx * scale, ny * scale, nz * scale
        for k in range(3):
            out[i, 3 + k], out[i, 6 + k], out[i, 9 + k] = a[k], b[k], c[k]
    return out


def write_glb(path: Path, parts: Sequence[tuple[str, TriangleMesh, Image.Image | None]]) -> None:
    """Write a GLB of named z-up meshes with their pictures inside; y is up, as its standard requires."""
    import trimesh

    scene = trimesh.Scene()
    for name, mesh, picture in parts:
        turned, visual = mesh.rotated_x(-90.0), None
        if mesh.uv is not None:
            material = trimesh.visual.material.PBRMaterial(
                name=name, baseColorTexture=picture, metallicFactor=0.0, roughnessFactor=1.0
            )
            visual = trimesh.visual.TextureVisuals(uv=mesh.uv, material=material)
        shape = trimesh.Trimesh(
            turned.vertices, turned.faces, vertex_normals=turned.normals, visual=visual, process=False
        )
        scene.add_geometry(shape, node_name=name, geom_name=name)
    normals = all(mesh.normals is not None for _, mesh, _ in parts)
    with atomic_write(path) as temporary:
        temporary.write_bytes(trimesh.exchange.gltf.export_glb(scene, include_normals=normals))


_NUMBER_WIDTH = 22
"""Characters of a sign, 19 digits, a point and a separator."""


def fixed_text(table: ArrayLike, decimals: ArrayLike, between: bytes = b" ") -> bytes:
    """Return a table as decimal text: columns separated, rows ended by newlines.

    Redundant zeros are omitted (`.5`, `-3`), as XML Schema's double allows.

    Args:
        table: (rows, columns) Finite numbers below 9e18 / 10**decimals.
        decimals: Digits after the point, 0 to 9, for each column.
        between: Character that separates columns, or one for each gap between two.
    """
    values = np.ascontiguousarray(table, dtype=np.float64)
    digits = np.broadcast_to(np.asarray(decimals, dtype=np.int64), values.shape[1:]).copy()
    out = np.empty(values.size * _NUMBER_WIDTH, dtype=np.uint8)
    ends = np.full(values.shape[1], ord("\n"), np.uint8)
    ends[:-1] = np.frombuffer(between, np.uint8)
    return out[: _write(values, digits, ends, out)].tobytes()


@njit
def _write(values: FloatArray, decimals: IntArray, ends: ByteArray, out: ByteArray) -> int:
    """Write the text into `out`, with a character after each column; return its length."""
    at = 0
    reverse = np.empty(24, np.uint8)
    rows, cols = values.shape
    for row in range(rows):
        for col in range(cols):
            places = decimals[col]
            scale = 10**places
            v = np.int64(np.floor(abs(values[row, col]) * scale + 0.5))
            if values[row, col] < 0 and v > 0:
                out[at] = 45
                at += 1
            while places > 0 and v % 10 == 0:
                v //= 10
                places -= 1
            n = 0
            while n < places or v > 0:
                reverse[n] = 48 + v % 10
                v //= 10
                n += 1
            if n == 0:
                out[at] = 48
                at += 1
            for k in range(n - 1, -1, -1):
                if k == places - 1:
                    out[at] = 46
                    at += 1
                out[at] = reverse[k]
                at += 1
            out[at] = ends[col]
            at += 1
    return at
