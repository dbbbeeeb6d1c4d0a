"""Mesh files with texture coordinates and a texture picture: COLLADA, OBJ, GLB."""

from __future__ import annotations

import io
import logging
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

from lirs_wct.errors import SourceError
from lirs_wct.files import referenced_file
from lirs_wct.formats.meshes.document import is_same
from lirs_wct.formats.meshes.reader import read_document
from lirs_wct.geometry.mesh import TriangleMesh

if TYPE_CHECKING:
    import trimesh

logging.getLogger("trimesh").addHandler(logging.NullHandler())
"""Without a handler, trimesh prints a traceback for each texture that it cannot read."""
TEXTURED = (".dae", ".obj", ".glb")
"""Files that hold texture coordinates."""


@dataclass(frozen=True)
class TexturedMesh:
    """A mesh in its file's frame, with its texture.

    Attributes:
        mesh: with normals, and texture coordinates (origin lower left) where the file has them.
        picture: Texture; None = not found.
        vertex_colors: whether the file has colors of vertices or faces.
    """

    mesh: TriangleMesh
    picture: Image.Image | None
    vertex_colors: bool


def read_textured(path: Path) -> TexturedMesh:
    """Read a mesh with its texture; vertices with different texture coordinates stay separate.

    Where trimesh reads other faces than the file states, its looks are left out, which a warning says.
    """
    document = read_document(path)
    if (loaded := _load(path)) is not None:
        visual = loaded.visual
        uv = getattr(visual, "uv", None) if visual.kind == "texture" else None
        mesh = TriangleMesh(
            np.asarray(loaded.vertices, np.float64),
            np.asarray(loaded.faces, np.int32),
            None if uv is None else np.asarray(uv, np.float64)[:, :2],
            np.asarray(loaded.vertex_normals, np.float64),
        )
    if loaded is None or document.odd_looks or not is_same(document.whole, mesh):
        if document.looks:
            warnings.warn(f"{path}: its materials and colors cannot be read and are left out", stacklevel=3)
        return TexturedMesh(document.whole, None, vertex_colors=False)
    material = getattr(visual, "material", None)
    picture = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    return TexturedMesh(mesh, picture, visual.kind in ("vertex", "face"))


def _load(path: Path) -> trimesh.Trimesh | None:
    """Load a mesh by trimesh, without files outside its package; None on failure."""
    import trimesh

    files = _referenced_files(path)
    try:
        loaded = trimesh.load_mesh(path, resolver=files)
    except Exception:  # every loader of trimesh raises different errors
        return None
    for reason in files.refused:
        warnings.warn(f"{reason}; left out", stacklevel=4)
    return loaded


def _referenced_files(path: Path) -> Any:
    """Return a trimesh resolver of referenced files with messages in the list `refused`."""
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


def png(picture: Image.Image) -> bytes:
    """Return a picture as the bytes of a PNG file."""
    out = io.BytesIO()
    mode = "RGBA" if picture.mode in ("RGBA", "LA", "PA") else "RGB"
    picture.convert(mode).save(out, format="PNG")
    return out.getvalue()
