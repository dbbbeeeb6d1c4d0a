"""Mesh files of any common format, read upright (z up, meters) or with their texture.

trimesh reads real files wrongly: OBJ with relative indices, tabs or concave polygons, and STL with bytes
behind its triangles.
"""

from __future__ import annotations

import codecs
import logging
import re
import warnings
from bisect import bisect_left
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from PIL import Image

from lirs_wct.arrays import IntArray
from lirs_wct.errors import SourceError, reason_of
from lirs_wct.files import referenced_file
from lirs_wct.formats import MESHES
from lirs_wct.formats.meshes import STL_FACET, STL_HEAD, Document, cut_polygons, numbers
from lirs_wct.formats.meshes.scenes import collada_frame, read_collada, read_glb
from lirs_wct.geometry.mesh import TriangleMesh, weld

MAX_COORDINATE = 1e9
"""Largest coordinate of a vertex, in the file's unit."""
_UPRIGHT = {
    "X": np.array(((0.0, 0.0, 1.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0))),
    "Y": np.array(((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0))),
    "Z": np.eye(3),
}
"""Rotation of the file's axes by its up axis. X_UP: -y is right, z to the viewer. Y_UP: x is right, z to the
viewer. Z_UP: x is right, -y to the viewer (COLLADA 1.4.1, <up_axis>)."""


def read_upright(path: Path, up: Literal["y", "z"] | None = None) -> TriangleMesh:
    """Read a mesh with merged vertices, z up, in meters, without degenerate triangles.

    A GLB has y up by its standard. A COLLADA file states its up axis and unit. Other formats state neither,
    and count as z up in meters. `up` replaces the file's own axis.
    """
    if path.suffix.lower() not in MESHES:
        raise SourceError(f"{path}: not a mesh that is read; legal: {', '.join(MESHES)}")
    mesh = read_mesh(path)
    a, b, c = mesh.faces.T
    return upright(path, TriangleMesh(mesh.vertices, mesh.faces[(a != b) & (b != c) & (c != a)]), up)


def upright(path: Path, mesh: TriangleMesh, up: Literal["y", "z"] | None = None) -> TriangleMesh:
    """Convert the mesh of a file to z up and meters, with its normals."""
    if up == "y" or (up is None and path.suffix.lower() == ".glb"):
        mesh = mesh.rotated_x(90.0)
    if path.suffix.lower() == ".dae":
        axis, unit = collada_frame(path)
        turn = _UPRIGHT["Z" if up else axis]
        normals = None if mesh.normals is None else mesh.normals @ turn
        return replace(mesh, vertices=mesh.vertices @ turn * unit, normals=normals)
    return mesh


def read_mesh(path: Path) -> TriangleMesh:
    """Read a mesh file in its own frame, equal vertices merged; warn of parts that are left out."""
    document = read_document(path)
    for note in dict.fromkeys(document.notes):
        warnings.warn(f"{path}: {note}", stacklevel=3)
    whole = document.whole
    used, faces = np.unique(whole.faces, return_inverse=True)
    return weld(TriangleMesh(whole.vertices[used], faces.reshape(-1, 3).astype(np.int32)))


@np.errstate(invalid="ignore", over="ignore")  # such numbers are refused
def read_document(path: Path) -> Document:
    """Read the shapes of a mesh file as it states them; errors are those of `read_mesh`."""
    if not path.is_file():
        raise SourceError(f"{path}: no such file")
    suffix = path.suffix.lower()
    try:
        data = path.read_bytes()
        if suffix == ".glb":
            document = read_glb(data, lambda name: referenced_file(path, name).read_bytes())
        else:
            document = _READERS[suffix](data)
        whole = document.whole
    except SourceError:
        raise
    except Exception as error:  # damaged bytes raise different errors
        raise SourceError(f"{path}: cannot be read as a mesh: {reason_of(error)}") from error
    if len(whole.faces) == 0:
        raise SourceError(f"{path}: holds no triangles, at least one is needed")
    if not (np.abs(whole.vertices[whole.faces]) <= MAX_COORDINATE).all():
        raise SourceError(
            f"{path}: has vertices that are not finite, or farther than {MAX_COORDINATE:g} units"
        )
    return document


_CORNER = re.compile(rb"\bvertex\s+((?:[-+.\d]\S*|nan|inf)\s+\S+\s+\S+)")  # names may hold the word
_END = re.compile(rb"\bend *(facet|solid)")


def read_stl(data: bytes) -> Document:
    """Read the triangles of an STL."""
    count = int.from_bytes(data[STL_HEAD - 4 : STL_HEAD], "little")
    need = STL_HEAD + STL_FACET.itemsize * count
    text = data.removeprefix(codecs.BOM_UTF8).lstrip()
    if len(data) != need and text[:5].lower() == b"solid" and b"\0" not in data:
        text = text.lower()
        corners = numbers(b" ".join(_CORNER.findall(text)), np.float64).reshape(-1, 3)
        ends = _END.findall(text)
        if len(corners) != 3 * ends.count(b"facet") or ends[-1:] != [b"solid"]:
            raise ValueError(f"is cut off or damaged: {len(corners)} corners, {ends.count(b'facet')} facets")
    elif len(data) < need:
        raise ValueError(f"is cut off: {count} triangles need {need} bytes, it has {len(data)}")
    else:
        facets = np.frombuffer(data, STL_FACET, count, STL_HEAD) if count else np.empty(0, STL_FACET)
        corners = facets["floats"][:, 3:].reshape(-1, 3).astype(np.float64)
    return Document([TriangleMesh(corners, np.arange(len(corners), dtype=np.int32).reshape(-1, 3))])


_POINT = re.compile(rb"^v +(\S+\s+\S+\s+\S+)", re.M)
_FACE = re.compile(rb"^f +([^#\n]*)", re.M)


def read_obj(data: bytes) -> Document:
    """Read the faces of an OBJ; negative indices count back from the last vertex."""
    text = data.removeprefix(codecs.BOM_UTF8).replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if b"\\\n" in text:  # continued lines
        text = re.sub(rb"^[ \t]*#.*", b"", text, flags=re.M).replace(b"\\\n", b" ")
    if b"\t" in text or b"\n " in text or text[:1] == b" ":
        text = re.sub(rb"^[ \t]*(\w+)[ \t]+", rb"\1 ", text, flags=re.M).replace(b"\t", b" ")
    points = numbers(b" ".join(_POINT.findall(text)), np.float64).reshape(-1, 3)
    lines = _FACE.findall(text)
    block = b"\n".join(lines)
    if b"-" in block:
        lines = _FACE.findall(_count_forward(text))
        block = b"\n".join(lines)
    counts = np.array([len(line.split()) for line in lines], np.int64)
    corners = numbers(re.sub(rb"/\S*", b"", block) if b"/" in block else block, np.int64) - 1
    mesh = TriangleMesh(points, corners[cut_polygons(points, corners, counts)].astype(np.int32))
    return Document([mesh], b"usemtl" in text or b"\nvt " in text)


def _count_forward(text: bytes) -> bytes:
    """Return the text with positive indices only."""
    places = [[m.start() for m in re.finditer(rb"^%s " % word, text, re.M)] for word in (b"v", b"vt", b"vn")]

    def positive(line: re.Match[bytes]) -> bytes:
        before = [bisect_left(starts, line.start()) for starts in places]
        corners = [corner.split(b"/") for corner in line[1].split()]
        return b"f " + b" ".join(
            b"/".join(
                b"%d" % (n + 1 + int(i)) if i[:1] == b"-" else i for i, n in zip(corner, before, strict=False)
            )
            for corner in corners
        )

    return _FACE.sub(positive, text)


_KINDS = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"},
}
"""Type of numpy by its name in a header."""
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_LOOKS = {"red", "texcoord", "u", "s", "texture_u"}


@dataclass
class PlyElement:
    """Header of a PLY's table: properties by name, type, and type of a list's length."""

    name: str
    rows: int
    properties: list[tuple[str, np.dtype[Any], np.dtype[Any] | None]] = field(default_factory=list)


def read_ply(data: bytes) -> Document:
    """Read the points and faces of a PLY."""
    is_text, elements = ply_header(data)
    body = data[data.index(b"\n", data.index(b"end_header")) + 1 :]
    names = next((tuple(n for n, _, _ in e.properties) for e in elements if e.name == "vertex"), ())
    if missing := [axis for axis in "xyz" if axis not in names]:
        got = ", ".join(names) or "none"
        raise ValueError(f"points need x, y and z; missing: {', '.join(missing)}; got: {got}")
    if any(element.rows for element in elements if element.name == "tristrips"):
        raise ValueError("holds tristrips, which are not read; export it with faces")
    if is_text:
        body = numbers(body, np.float64).tobytes()
    points, at = np.empty((0, 3)), 0
    corners = counts = np.empty(0, np.int64)
    for element in elements:
        if any(length for _, _, length in element.properties):
            try:
                found, sizes, at = _lists(body, at, element)
            except ValueError as error:
                raise ValueError(f"is damaged or cut off in its {element.name} list: {error}") from error
            corners, counts = (found, sizes) if element.name == "face" else (corners, counts)
            continue
        kind = np.dtype([(name, kind) for name, kind, _ in element.properties])
        if at + element.rows * kind.itemsize > len(body):
            raise ValueError(f"is damaged or cut off: {element.rows} of {element.name} are not in it")
        table = np.ndarray(element.rows, kind, body, at)
        at += table.nbytes
        if element.name == "vertex":
            points = np.column_stack([table[axis] for axis in "xyz"]).astype(np.float64)
    triangles = cut_polygons(points, corners, counts)
    looks = any(name in _LOOKS for element in elements for name, _, _ in element.properties)
    return Document([TriangleMesh(points, corners[triangles].astype(np.int32))], looks)


def ply_header(data: bytes) -> tuple[bool, list[PlyElement]]:
    """Return whether the data is text, which is read as float64, and the elements."""
    head, end, _ = data.partition(b"end_header")
    if not (head.startswith(b"ply") and end):
        raise ValueError("has no header of a PLY")
    order, elements = "<", list[PlyElement]()
    for line in head.decode("ascii", errors="replace").splitlines():
        match line.split():
            case ["format", kind, *_]:
                if kind not in _ORDERS:
                    raise ValueError(f"has the unknown format {kind!r}; legal: {', '.join(_ORDERS)}")
                order = _ORDERS[kind]
            case ["element", name, rows]:
                elements.append(PlyElement(name, int(rows)))
            case ["property", *kinds, name]:
                each, *length = [
                    np.dtype(order + _KINDS[k] if order else "f8") for k in kinds[::-1] if k != "list"
                ]
                elements[-1].properties.append((name, each, length[0] if length else None))
    return not order, elements


def _lists(body: bytes, begin: int, element: PlyElement) -> tuple[IntArray, IntArray, int]:
    """Return the vertex indices of rows, their counts, and the end of the rows."""
    starts, counts, kind, at, rows = list[int](), list[int](), np.dtype("i4"), begin, element.rows
    lengths = list[tuple[int, np.dtype[Any], int]]()
    for row in range(rows):
        for name, each, length in element.properties:
            n = 1
            if length is not None:
                n = int(np.frombuffer(body, length, 1, at)[0])
                if n < 0:
                    raise ValueError("a length is negative")
                lengths += [] if row else [(at, length, n)]
                at += length.itemsize
            if name in ("vertex_index", "vertex_indices"):
                starts.append(at)
                counts.append(n)
                kind = each
            at += n * each.itemsize
        size = at - begin
        if row or begin + size * rows > len(body) or not starts:
            continue
        if all((np.ndarray(rows, each, body, place, (size,)) == n).all() for place, each, n in lengths):
            table = np.ndarray((rows, counts[0]), kind, body, starts[0], (size, kind.itemsize))
            return table.ravel().astype(np.int64), np.full(rows, counts[0]), begin + size * rows
    found = [np.frombuffer(body, kind, n, start) for n, start in zip(counts, starts, strict=True)]
    return np.concatenate([np.empty(0, np.int64), *found]).astype(np.int64), np.array(counts, np.int64), at


_READERS = {".obj": read_obj, ".stl": read_stl, ".dae": read_collada, ".ply": read_ply}


logging.getLogger("trimesh").addHandler(logging.NullHandler())
"""Without a handler, trimesh prints a traceback for each texture that it cannot read."""
_AREA_TOLERANCE, _COORDINATE_TOLERANCE = 1e-3, 1e-5
"""Shares of the area, and of the largest coordinate (in float32), by which another reading may differ."""
TEXTURED = (".dae", ".obj", ".glb")
"""Files that hold texture coordinates."""


@dataclass(frozen=True)
class TexturedMesh:
    """A mesh in its file's frame, with its texture.

    Attributes:
        mesh: Triangles with normals, and texture coordinates (origin lower left) where the file has them.
        picture: Texture; None = not found.
        vertex_colors: Whether the file has colors of vertices or faces.
    """

    mesh: TriangleMesh
    picture: Image.Image | None
    vertex_colors: bool


def read_textured(path: Path) -> TexturedMesh:
    """Read a mesh with its texture; vertices with different texture coordinates stay separate.

    Where trimesh reads other faces than the file states, its looks are left out, which a warning says.
    """
    import trimesh

    document = read_document(path)
    files = _References(path)
    try:
        loaded = trimesh.load_mesh(path, resolver=files)
    except Exception:  # every loader of trimesh raises different errors
        loaded = None
    else:
        visual = loaded.visual
        uv = getattr(visual, "uv", None) if visual.kind == "texture" else None
        mesh = TriangleMesh(
            np.asarray(loaded.vertices, np.float64),
            np.asarray(loaded.faces, np.int32),
            None if uv is None else np.asarray(uv, np.float64)[:, :2],
            np.asarray(loaded.vertex_normals, np.float64),
        )
        for reason in files.refused:
            warnings.warn(f"{reason}; left out", stacklevel=3)
    if loaded is None or document.odd_looks or not _is_same(document.whole, mesh):
        if document.looks:
            warnings.warn(f"{path}: its materials and colors cannot be read and are left out", stacklevel=3)
        return TexturedMesh(document.whole, None, vertex_colors=False)
    material = getattr(visual, "material", None)
    picture = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    return TexturedMesh(mesh, picture, visual.kind in ("vertex", "face"))


class _References:
    """Reader of referenced files for trimesh, with the reasons why some are not read."""

    def __init__(self, path: Path) -> None:
        self._path, self.refused = path, list[str]()

    def get(self, name: str) -> bytes:
        """Return the content of a file, unless it lies outside the mesh's package."""
        try:
            return referenced_file(self._path, name).read_bytes()
        except SourceError as error:
            self.refused += [] if str(error) in self.refused else [str(error)]
            raise

    __getitem__ = get


def _is_same(mesh: TriangleMesh, other: TriangleMesh) -> bool:
    """Return whether two readings of a file agree on triangles, extent and area."""
    if len(mesh.faces) != len(other.faces):
        return False
    corners, others = mesh.vertices[mesh.faces], other.vertices[other.faces]
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    noise = _COORDINATE_TOLERANCE * float(np.abs((low, high)).max())
    off = np.abs((low - others.min(axis=(0, 1)), high - others.max(axis=(0, 1)))).max()
    area = float(mesh.face_areas.sum())
    return bool(off <= noise and abs(area - other.face_areas.sum()) <= _AREA_TOLERANCE * area)
