"""Wavefront OBJ as text, with a material file for textures."""

from __future__ import annotations

import re
from bisect import bisect_left
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np

from lirs_wct.arrays import Int32Array
from lirs_wct.files import atomic_write
from lirs_wct.formats.meshes.document import Document, numbers
from lirs_wct.formats.meshes.polygons import cut_polygons
from lirs_wct.formats.meshes.text import fixed_text
from lirs_wct.geometry.mesh import TriangleMesh

_ROWS = 1 << 16
_METER_DECIMALS, _UNIT_DECIMALS = 6, 5
_MARK = b"\xef\xbb\xbf"
_POINT = re.compile(rb"^v +(\S+\s+\S+\s+\S+)", re.M)
_FACE = re.compile(rb"^f +([^#\n]*)", re.M)


def read_obj(data: bytes) -> Document:
    """Read the faces of an OBJ; negative indices count back from the last vertex.

    Raises:
        ValueError: a word is not a number.
    """
    text = _plain(data)
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


def _plain(data: bytes) -> bytes:
    """Return the text without continued, indented or tabbed lines."""
    text = data.removeprefix(_MARK).replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if b"\\\n" in text:
        text = re.sub(rb"^[ \t]*#.*", b"", text, flags=re.M).replace(b"\\\n", b" ")
    if b"\t" in text or b"\n " in text or text[:1] == b" ":
        text = re.sub(rb"^[ \t]*(\w+)[ \t]+", rb"\1 ", text, flags=re.M).replace(b"\t", b" ")
    return text


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


def write_obj(path: Path, mesh: TriangleMesh, texture: str | None = None) -> None:
    """Write a mesh, with its texture coordinates and normals where it has them.

    Args:
        path: file; the material is STEM.mtl in the same folder.
        mesh: in the world frame, z up, meters.
        texture: path of a picture relative to the file; needs texture coordinates.

    Raises:
        OutputError: a file cannot be written.
    """
    write_obj_parts(path, [("ground", mesh, texture)])


def write_obj_parts(path: Path, parts: Sequence[tuple[str, TriangleMesh, str | None]]) -> None:
    """Write (name, mesh, picture) parts, one material each (see `write_obj`)."""
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
    for start in range(0, len(mesh.faces), _ROWS):
        file.write(_faces(mesh.faces[start : start + _ROWS] + 1 + written, mesh))


def _lines(word: bytes, rows: bytes) -> bytes:
    return word + b" " + rows[:-1].replace(b"\n", b"\n" + word + b" ") + b"\n"


def _faces(corners: Int32Array, mesh: TriangleMesh) -> bytes:
    """Return the lines of faces; position, texture and normal of a corner share an index."""
    numbers = 1 + (mesh.uv is not None) + (mesh.normals is not None)
    between = (b"/" * (numbers - 1) + b" ") * 3
    text = fixed_text(np.repeat(corners, numbers, axis=1), 0, between[:-1])
    # Without texture coordinates, the field between the slashes stays empty.
    return _lines(b"f", text if mesh.uv is not None else text.replace(b"/", b"//"))
