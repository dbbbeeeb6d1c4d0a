"""Vertices and faces of a PLY, text or binary."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lirs_wct.arrays import IntArray
from lirs_wct.formats.meshes.document import Document, numbers
from lirs_wct.formats.meshes.polygons import cut_polygons
from lirs_wct.geometry.mesh import TriangleMesh

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
    """Read the points and faces of a PLY.

    Raises:
        ValueError: the header is damaged, lacks x, y or z, or announces strips or more than there is.
    """
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
    """Return whether the data is text, which is read as float64, and the elements.

    Raises:
        ValueError: it is no PLY, or one of an unknown format.
    """
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
