"""Conversion of mesh files: keeps shape, up axis and texture, and warns of losses."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

from PIL import Image

from lirs_wct.errors import OutputError
from lirs_wct.export.mesh_writer import write_collada, write_mesh
from lirs_wct.files import atomic_write
from lirs_wct.formats.meshes.mesh_reader import read_upright, upright
from lirs_wct.formats.meshes.obj import write_obj
from lirs_wct.formats.meshes.textured import TEXTURED, TexturedMesh, png, read_textured, write_glb
from lirs_wct.geometry.mesh import TriangleMesh


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
