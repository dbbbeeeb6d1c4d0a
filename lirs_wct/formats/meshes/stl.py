"""STL: triangles without names, materials or units, binary."""

from __future__ import annotations

import codecs
import re
import struct
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from lirs_wct.arrays import Float32Array, FloatArray, njit
from lirs_wct.files import atomic_write
from lirs_wct.formats.meshes.document import Document, numbers
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.progress import Progress, no_progress, track

_CHUNK = 1 << 14
_RECORD = np.dtype([("floats", "<f4", 12), ("attribute", "<u2")])
_HEAD = 84
_CORNER = re.compile(rb"\bvertex\s+((?:[-+.\d]\S*|nan|inf)\s+\S+\s+\S+)")  # names may hold the word
_END = re.compile(rb"\bend *(facet|solid)")


def read_stl(data: bytes) -> Document:
    """Read the triangles of an STL.

    Raises:
        ValueError: the file is cut off, or a word is not a number.
    """
    count = int.from_bytes(data[_HEAD - 4 : _HEAD], "little")
    need = _HEAD + _RECORD.itemsize * count
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
        facets = np.frombuffer(data, _RECORD, count, _HEAD) if count else np.empty(0, _RECORD)
        corners = facets["floats"][:, 3:].reshape(-1, 3).astype(np.float64)
    return Document([TriangleMesh(corners, np.arange(len(corners), dtype=np.int32).reshape(-1, 3))])


def write_stl(path: Path, mesh: TriangleMesh, progress: Progress = no_progress) -> None:
    """Write a mesh as binary STL.

    Raises:
        OutputError: the file cannot be written.
    """
    starts = range(0, len(mesh.faces), _CHUNK)
    chunks = (mesh.vertices[mesh.faces[i : i + _CHUNK]] for i in starts)
    write_triangles(path, len(mesh.faces), chunks, progress)


def write_triangles(
    path: Path, count: int, chunks: Iterable[FloatArray], progress: Progress = no_progress
) -> None:
    """Write triangles from an iterator, so that a surface may exceed the memory.

    Args:
        path: file.
        count: triangles in all, below 2**32.
        chunks: (n, 3, 3) corners in meters each.
        progress: callback for the progress of the file.

    Raises:
        OutputError: the file cannot be written.
    """
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        # The header must not begin with "solid", which marks ASCII.
        file.write(struct.pack("<80sI", b"LIRS-WCT, meters, z up", count))
        for corners in track(chunks, count, len, path.name, progress):
            record = np.zeros(len(corners), dtype=_RECORD)
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
