"""Writer of mesh files: STL, COLLADA, OBJ, PLY or GLB, upright in every consumer."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import trimesh

from lirs_wct.errors import ConfigError
from lirs_wct.files import atomic_write
from lirs_wct.formats.meshes.collada import MeshPart, stream_collada
from lirs_wct.formats.meshes.obj import write_obj
from lirs_wct.formats.meshes.stl import write_stl
from lirs_wct.formats.meshes.textured import write_glb
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
    with atomic_write(path) as temporary:
        trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(temporary)


def write_collada(
    path: Path,
    mesh: TriangleMesh,
    texture: str | None = None,
    *,
    progress: Progress = no_progress,
) -> None:
    """Write a mesh with texture coordinates; missing ones are made by cube projection.

    Args:
        path: output file.
        mesh: mesh in the world frame.
        texture: path of the picture relative to the file, or None for a plain color.
        progress: progress of the file.

    Raises:
        ConfigError: the texture's path has spaces, which Gazebo does not support.
        OutputError: the file cannot be written.
    """
    whole = mesh if mesh.uv is not None and mesh.normals is not None else cube_uv(mesh)
    write_parts(path, (MeshPart("ground", whole, texture),), progress)


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
