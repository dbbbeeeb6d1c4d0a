"""Mesh files of any common format, read upright: z up, meters."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from lirs_wct.errors import SourceError
from lirs_wct.formats.meshes.stl import read_mesh
from lirs_wct.formats.suffixes import MESHES
from lirs_wct.geometry.mesh import TriangleMesh, welded

_HEAD = 1 << 16
"""Bytes of a COLLADA file in which its <asset> stands."""
_UPRIGHT = {
    "X": np.array(((0.0, 0.0, 1.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0))),
    "Y": np.array(((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0))),
    "Z": np.eye(3),
}
"""Where the file's x, y and z go, by the axis that is up: of X_UP -y is right and z to the viewer, of Y_UP x
is right and z to the viewer, of Z_UP x is right and -y to the viewer (COLLADA 1.4.1, <up_axis>)."""


def read_upright(path: Path) -> TriangleMesh:
    """Read a mesh, equal vertices merged, turned so that z is up, in meters.

    A GLB has y up by its standard, a COLLADA file says what it has and its unit; the others do not say,
    and are taken to be z up in meters.

    Raises:
        SourceError: the file is missing, damaged, of a format that is not read, or without triangles.
    """
    if path.suffix.lower() not in MESHES:
        raise SourceError(f"{path}: not a mesh that is read; legal: {', '.join(MESHES)}")
    return upright(path, _merged(read_mesh(path)))


def upright(path: Path, mesh: TriangleMesh) -> TriangleMesh:
    """Return the mesh of a file turned so that z is up, in meters; its normals turn with it.

    Raises:
        SourceError: the file's unit is not a number of meters.
    """
    if path.suffix.lower() == ".glb":
        return mesh.rotated_x(90.0)
    if path.suffix.lower() == ".dae":
        up, unit = _collada_frame(path)
        normals = None if mesh.normals is None else mesh.normals @ _UPRIGHT[up]
        return replace(mesh, vertices=mesh.vertices @ _UPRIGHT[up] * unit, normals=normals)
    return mesh


def _merged(mesh: TriangleMesh) -> TriangleMesh:
    """Return the mesh with one vertex a place, and without triangles that have two corners there."""
    whole = welded(mesh)
    a, b, c = whole.faces.T
    return TriangleMesh(whole.vertices, whole.faces[(a != b) & (b != c) & (c != a)])


def _collada_frame(path: Path) -> tuple[str, float]:
    """Return the axis that is up, and meters a unit; the standard's defaults are Y and 1."""
    with path.open("rb") as file:
        head = file.read(_HEAD).decode("utf-8", errors="replace")
    up = re.search(r"<up_axis>\s*([XYZ])_UP", head)
    unit = re.search(r"<unit\b[^>]*\bmeter\s*=\s*[\"']([^\"']+)", head)
    try:
        meters = float(unit[1]) if unit else 1.0
    except ValueError:
        raise SourceError(f"{path}: its unit is not a number of meters") from None
    if not 0 < meters < float("inf"):
        raise SourceError(f"{path}: its unit must be above 0 m, got {meters:g}")
    return (up[1] if up else "Y"), meters
