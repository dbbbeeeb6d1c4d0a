"""A mesh becomes a file: STL, COLLADA, OBJ, PLY or GLB, upright in every consumer."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh

from lirs_wct.errors import ConfigError
from lirs_wct.files import atomic_write
from lirs_wct.formats.meshes.collada import write_document
from lirs_wct.formats.meshes.collada_stream import stream_collada
from lirs_wct.formats.meshes.obj import write_obj
from lirs_wct.formats.meshes.stl import write_stl
from lirs_wct.formats.meshes.textured import write_glb
from lirs_wct.formats.suffixes import MESHES
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.meshing.tiles import split_tiles
from lirs_wct.meshing.uv import cube_uv, projection_groups
from lirs_wct.progress import Progress, no_progress, tracked

TILE = 19_000
"""Triangles of a streamed tile: its 9,500 vertices have indices of four digits."""
STREAM_ABOVE = 20_000
"""Triangles above which the file is streamed: pycollada needs 20 s and 500 MB for each million."""
BULK = 500_000
"""Triangles above which positions are written to 2e-6 of the world's width instead of 2e-7: fewer digits."""


def write_mesh(path: Path, mesh: TriangleMesh) -> None:
    """Write a mesh in the format of the file's suffix; a GLB with y up, as its readers expect.

    Raises:
        ConfigError: the suffix is none that is written.
        OutputError: the file cannot be written.
    """
    writers: dict[str, Callable[[Path, TriangleMesh], None]] = {
        ".stl": write_stl,
        ".dae": write_collada,
        ".obj": write_obj,
        ".ply": _write_ply,
        ".glb": write_glb,
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
    stream_above: int = STREAM_ABOVE,
    progress: Progress = no_progress,
) -> None:
    """Write a mesh with its texture coordinates; missing ones are made by cube projection.

    Args:
        path: file.
        mesh: in the world frame.
        texture: path of the picture relative to the file, or None for a plain colour.
        stream_above: triangles above which the file is streamed in tiles.
        progress: of the file.

    Raises:
        ConfigError: the texture's path holds spaces, which Gazebo does not take.
        OutputError: the file cannot be written.
    """
    if texture is not None and any(c.isspace() for c in texture):
        raise ConfigError(f"path of a texture must not hold spaces, got {texture!r}")
    if mesh.uv is None or mesh.normals is None:
        mesh = cube_uv(mesh)
    streamed = len(mesh.faces) > stream_above
    aim = TILE if streamed else max(len(mesh.faces), 1)
    tiles = split_tiles(mesh, aim=aim, groups=projection_groups(mesh))
    tiles = tracked(tiles, len(mesh.faces), lambda tile: len(tile.faces), path.name, progress)
    with atomic_write(path) as temporary:
        if streamed:
            step = 2e-6 if len(mesh.faces) > BULK else 2e-7
            stream_collada(temporary, tiles, np.ptp(mesh.bounds, axis=0), texture, step)
        else:
            write_document(temporary, tiles, texture)
