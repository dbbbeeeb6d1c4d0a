"""Mesh files of any common format, read upright: z up, meters."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from lirs_wct.errors import SourceError, reason_of
from lirs_wct.formats.meshes.collada_tree import collada_frame, read_collada
from lirs_wct.formats.meshes.document import Document
from lirs_wct.formats.meshes.glb import read_glb
from lirs_wct.formats.meshes.obj import read_obj
from lirs_wct.formats.meshes.ply_faces import read_ply
from lirs_wct.formats.meshes.stl import read_stl
from lirs_wct.formats.references import referenced_file
from lirs_wct.formats.suffixes import MESHES, way_to_read
from lirs_wct.geometry.mesh import TriangleMesh, weld

FARTHEST = 1e9
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

    Raises:
        SourceError: the file is missing, damaged, of a format that is not read, or without triangles.
    """
    if path.suffix.lower() not in MESHES:
        reason = way_to_read(path) or "not a mesh that is read"
        raise SourceError(f"{path}: {reason}; legal: {', '.join(MESHES)}")
    mesh = read_mesh(path)
    a, b, c = mesh.faces.T
    return upright(path, TriangleMesh(mesh.vertices, mesh.faces[(a != b) & (b != c) & (c != a)]), up)


def upright(path: Path, mesh: TriangleMesh, up: Literal["y", "z"] | None = None) -> TriangleMesh:
    """Convert the mesh of a file to z up and meters, with its normals.

    Raises:
        SourceError: the file's unit is not a number of meters.
    """
    if up == "y" or (up is None and path.suffix.lower() == ".glb"):
        mesh = mesh.rotated_x(90.0)
    if path.suffix.lower() == ".dae":
        axis, unit = _collada_frame(path)
        turn = _UPRIGHT["Z" if up else axis]
        normals = None if mesh.normals is None else mesh.normals @ turn
        return replace(mesh, vertices=mesh.vertices @ turn * unit, normals=normals)
    return mesh


def _collada_frame(path: Path) -> tuple[str, float]:
    """Return the up axis and meters per unit."""
    up, unit = collada_frame(path)
    try:
        meters = float(unit)
    except ValueError:
        raise SourceError(f"{path}: its unit is not a number of meters") from None
    if up not in _UPRIGHT:
        raise SourceError(f"{path}: its up axis must be X_UP, Y_UP or Z_UP")
    if not 0 < meters < float("inf"):
        raise SourceError(f"{path}: its unit must be above 0 m, got {meters:g}")
    return up, meters


def read_mesh(path: Path) -> TriangleMesh:
    """Read a mesh file in its own frame, equal vertices merged.

    Warns of parts that are left out or simplified.

    Raises:
        SourceError: the file is missing, damaged, of an unknown format, or holds no triangles.
    """
    document = read_document(path)
    for note in dict.fromkeys(document.notes):
        warnings.warn(f"{path}: {note}", stacklevel=3)
    whole = document.whole
    used, faces = np.unique(whole.faces, return_inverse=True)
    return weld(TriangleMesh(whole.vertices[used], faces.reshape(-1, 3).astype(np.int32)))


@np.errstate(invalid="ignore", over="ignore")  # such numbers are refused
def read_document(path: Path) -> Document:
    """Read the shapes of a mesh file as it states them.

    Raises:
        SourceError: as `read_mesh` says.
    """
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
    if not (np.abs(whole.vertices[whole.faces]) <= FARTHEST).all():
        raise SourceError(f"{path}: has vertices that are not finite, or farther than {FARTHEST:g} units")
    return document


_READERS = {".obj": read_obj, ".stl": read_stl, ".dae": read_collada, ".ply": read_ply}
