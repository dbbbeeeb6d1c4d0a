"""Writer and conversion of mesh files (STL, COLLADA, OBJ, PLY, GLB), upright in every consumer."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

from PIL import Image

from lirs_wct.errors import ConfigError, OutputError
from lirs_wct.files import atomic_write
from lirs_wct.formats.meshes.collada import MeshPart, stream_collada
from lirs_wct.formats.meshes.mesh_reader import read_upright, upright
from lirs_wct.formats.meshes.obj import write_obj
from lirs_wct.formats.meshes.stl import write_stl
from lirs_wct.formats.meshes.textured import TEXTURED, TexturedMesh, png, read_textured, write_glb
from lirs_wct.formats.suffixes import MESHES
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.meshing.uv import cube_uv
from lirs_wct.progress import Progress, no_progress

BULK = 500_000
"""Triangles above which the file is compact: fewer digits, and quads."""


def write_mesh(path: Path, mesh: TriangleMesh) -> None:
    """Write a mesh in the format of the file's suffix; a GLB has y up, its convention.

    Raises:
        ConfigError: the suffix is not supported.
        OutputError: the file cannot be written.
    """
    writers: dict[str, Callable[[Path, TriangleMesh], None]] = {
        ".stl": write_stl,
        ".dae": write_collada,
        ".obj": write_obj,
        ".ply": _write_ply,
        ".glb": lambda path, mesh: write_glb(path, [("ground", mesh, None)]),
    }
    suffix = path.suffix.lower()
    if suffix not in writers:
        raise ConfigError(f"{path}: not a mesh that is written; legal: {', '.join(MESHES)}")
    writers[suffix](path, mesh)


def _write_ply(path: Path, mesh: TriangleMesh) -> None:
    import trimesh  # slow import, needed here only

    with atomic_write(path) as temporary:
        trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(temporary)


def write_collada(path: Path, mesh: TriangleMesh, texture: str | None = None) -> None:
    """Write a mesh with texture coordinates; missing ones are made by cube projection.

    Args:
        path: output file.
        mesh: mesh in the world frame.
        texture: path of the picture relative to the file, or None for a plain color.

    Raises:
        ConfigError: the texture's path has spaces, which Gazebo does not support.
        OutputError: the file cannot be written.
    """
    whole = mesh if mesh.uv is not None and mesh.normals is not None else cube_uv(mesh)
    write_parts(path, (MeshPart("ground", whole, texture),))


def write_parts(path: Path, parts: Sequence[MeshPart], progress: Progress = no_progress) -> None:
    """Write parts of one texture each as one COLLADA file (see `write_collada`)."""
    for part in parts:
        if part.texture is not None and any(c.isspace() for c in part.texture):
            raise ConfigError(f"path of a texture must not hold spaces, got {part.texture!r}")
    count = sum(len(part.mesh.faces) for part in parts)
    with atomic_write(path) as temporary:
        passed = _count_progress(count, path.name, progress)
        stream_collada(temporary, parts, brief=count > BULK, passed=passed)


def _count_progress(total: int, step: str, progress: Progress) -> Callable[[int], None]:
    """Return a function that adds a number of triangles and reports the progress."""
    done = 0

    def passed(count: int) -> None:
        nonlocal done
        done += count
        progress(step, done / max(total, 1))

    return passed


def convert_mesh(source: Path, target: Path, rotate_x: float = 0.0) -> TriangleMesh:
    """Convert a mesh file and return its shape with equal vertices merged.

    Texture and texture coordinates are kept if both formats support them; a warning names the losses.

    Args:
        source: input file.
        target: output file in the format of its suffix; COLLADA and OBJ store the texture next to it.
        rotate_x: rotation about the x axis, degrees.

    Raises:
        SourceError: the source cannot be used.
        ConfigError: the target's suffix is not supported.
        OutputError: a file cannot be written, or the texture would replace another picture.
    """
    shape = _rotate(read_upright(source), rotate_x)
    found = read_textured(source)
    lost = _lost(found, target)
    if found.mesh.uv is not None and target.suffix.lower() in TEXTURED:
        if found.picture is None:
            warnings.warn(f"{source}: its texture coordinates are kept, no texture was found", stacklevel=2)
        _write_textured(target, _rotate(upright(source, found.mesh), rotate_x), found.picture)
    else:
        write_mesh(target, shape)
    if lost:
        warnings.warn(f"{target}: {' and '.join(lost)} of {source} are left out", stacklevel=2)
    return shape


def _rotate(mesh: TriangleMesh, degrees: float) -> TriangleMesh:
    return mesh.rotated_x(degrees) if degrees else mesh


def _lost(found: TexturedMesh, target: Path) -> list[str]:
    """Return the names of the attributes that the target's format cannot store."""
    lost = []
    if found.mesh.uv is not None and target.suffix.lower() not in TEXTURED:
        lost.append("texture and texture coordinates" if found.picture else "texture coordinates")
    if found.vertex_colors:
        lost.append("the colors of vertices or faces")
    return lost


def _write_textured(path: Path, mesh: TriangleMesh, picture: Image.Image | None) -> None:
    suffix = path.suffix.lower()
    if suffix == ".glb":
        write_glb(path, [("ground", mesh, picture)])
        return
    texture = None if picture is None else _write_beside(path, picture)
    if suffix == ".dae":
        write_collada(path, mesh, texture)
    else:
        write_obj(path, mesh, texture)


def _write_beside(path: Path, picture: Image.Image) -> str:
    """Write a texture next to a mesh file; return its name, which has no spaces."""
    name = f"{re.sub(r'[^A-Za-z0-9_.-]+', '_', path.stem)}-texture.png"
    place, content = path.with_name(name), png(picture)
    if place.exists() and place.read_bytes() != content:
        raise OutputError(f"{place}: is another picture, and the texture of {path} is to be written there")
    with atomic_write(place) as temporary:
        temporary.write_bytes(content)
    return name
