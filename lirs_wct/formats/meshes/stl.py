"""STL: triangles without names, materials or units, binary."""

from __future__ import annotations

import logging
import struct
import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lirs_wct.arrays import Float32Array, FloatArray
from lirs_wct.errors import SourceError, reason_of
from lirs_wct.files import atomic_write
from lirs_wct.formats.meshes.ply_header import require_positions
from lirs_wct.formats.references import referenced_file
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.kernels import njit
from lirs_wct.progress import Progress, no_progress, tracked

if TYPE_CHECKING:
    import trimesh

logging.getLogger("trimesh").addHandler(logging.NullHandler())
"""Else a texture that is not read prints a traceback."""
_CHUNK = 1 << 14
_RECORD = np.dtype([("floats", "<f4", 12), ("attribute", "<u2")])


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
    """Write triangles as they come, so that a surface larger than the memory can be written.

    Args:
        path: file.
        count: triangles in all, below 2**32.
        chunks: (n, 3, 3) corners in meters each.
        progress: of the file.

    Raises:
        OutputError: the file cannot be written.
    """
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        # The header must not begin with "solid", which marks ASCII.
        file.write(struct.pack("<80sI", b"LIRS-WCT, meters, z up", count))
        for corners in tracked(chunks, count, len, path.name, progress):
            record = np.zeros(len(corners), dtype=_RECORD)
            record["floats"] = _facets(np.ascontiguousarray(corners))
            file.write(record.data)


@njit(cache=True)
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


def read_mesh(path: Path) -> TriangleMesh:
    """Read a mesh in any format that trimesh knows, equal vertices merged, as it stands in the file.

    Raises:
        SourceError: the file is missing, damaged, of an unknown format, or holds no triangles.
    """
    loaded = load_mesh(path)
    return TriangleMesh(np.asarray(loaded.vertices, np.float64), np.asarray(loaded.faces, np.int32))


def load_mesh(path: Path) -> trimesh.Trimesh:
    """Load a mesh in any format that trimesh knows; warns of files outside its folder or Gazebo package.

    Raises:
        SourceError: as `read_mesh` says.
    """
    import trimesh

    if not path.is_file():
        raise SourceError(f"{path}: no such file")
    if path.suffix.lower() == ".ply":
        require_positions(path)
    files = _referenced_files(path)
    try:
        loaded = trimesh.load_mesh(path, resolver=files)
    except SourceError:
        raise
    except Exception as error:  # every loader of trimesh has errors of its own
        raise SourceError(f"{path}: cannot be read as a mesh: {reason_of(error)}") from error
    if len(getattr(loaded, "faces", ())) == 0:
        raise SourceError(f"{path}: holds no triangles, at least one is needed")
    if not np.isfinite(loaded.vertices).all():
        raise SourceError(f"{path}: has vertices that are not finite")
    for reason in files.refused:
        warnings.warn(f"{reason}; left out", stacklevel=3)
    return loaded


def _referenced_files(path: Path) -> Any:
    """Return trimesh's resolver of the files that a mesh names, with the list `refused` of messages."""
    from trimesh.resolvers import Resolver

    class References(Resolver):  # type: ignore[misc,unused-ignore]  # trimesh is loaded late
        def __init__(self) -> None:
            self.refused: list[str] = []

        def get(self, name: str) -> bytes:
            try:
                return referenced_file(path, name).read_bytes()
            except SourceError as error:
                self.refused += [] if str(error) in self.refused else [str(error)]
                raise

        def keys(self) -> list[str]:
            return []

        def write(self, name: str, data: bytes) -> None:
            raise NotImplementedError

        def namespaced(self, namespace: str) -> Resolver:
            raise NotImplementedError

    return References()
