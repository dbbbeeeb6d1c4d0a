"""A world as a textured GLB, as light as a browser needs it."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import trimesh
from PIL import Image
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from lirs_wct.formats.images.picture import read_picture
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.ground import Terrain
from lirs_wct.meshing.ground_texture import ground_texture
from lirs_wct.meshing.solid import solid_mesh
from lirs_wct.meshing.uv import cube_uv
from lirs_wct.world import World

TEXTURE = 1024
"""Pixels of a texture's longer side, at most; of a preview, which is to come fast, fewer."""
PREVIEW_TEXTURE = 384


def world_glb(world: World, most: int, texture: int = TEXTURE) -> tuple[bytes, int]:
    """Return a world as GLB, z up, and its number of triangles.

    Args:
        world: of any kind.
        most: triangles; a surface with more is shown on a coarser grid.
        texture: pixels of its longer side, at most.
    """
    mesh = cube_uv(_shown_mesh(world, most), world.export_options.texture_size)
    material = PBRMaterial(
        baseColorTexture=Image.fromarray(_texture(world, texture)), metallicFactor=0.0, roughnessFactor=1.0
    )
    shown = trimesh.Trimesh(
        mesh.vertices,
        mesh.faces,
        vertex_normals=mesh.normals,
        process=False,
        visual=TextureVisuals(uv=mesh.uv, material=material),
    )
    content: bytes = shown.export(file_type="glb")
    return content, len(mesh.faces)


def _shown_mesh(world: World, most: int) -> TriangleMesh:
    """Return the mesh that is exported, or a coarser grid of the same surface."""
    surface = world.surface
    plain = isinstance(world.ground, Terrain) and not world.export_options.limited
    if not plain and (len(world.mesh.faces) <= most or world.walls is not None or world.overhangs):
        return world.mesh
    rows, cols = surface.shape
    if plain and 2 * rows * cols <= most:
        return world.mesh
    return solid_mesh(_thinned(surface, most))


def _thinned(surface: HeightField, most: int) -> HeightField:
    """Return the surface on fewer nodes, its border kept."""
    rows, cols = surface.shape
    share = min(1.0, (most / 2 / (rows * cols)) ** 0.5)
    at = [np.linspace(0, n - 1, max(2, int(n * share))).round().astype(int) for n in (rows, cols)]
    width, depth = surface.size
    cell = (width / (len(at[1]) - 1), depth / (len(at[0]) - 1))
    return replace(surface, z=np.ascontiguousarray(surface.z[np.ix_(*at)]), cell=cell)


def _texture(world: World, most: int) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    """Return (rows, cols, 3) RGB: the user's picture, or the ground's own."""
    given = world.export_options.texture
    if given is None:
        bgr = ground_texture(world.surface, world.walls)
    else:
        pixels = read_picture(given).pixels
        bgr = pixels if pixels.ndim == 3 else cv2.cvtColor(pixels, cv2.COLOR_GRAY2BGR)
    scale = min(1.0, most / max(bgr.shape[:2]))
    if scale < 1.0:
        bgr = cv2.resize(bgr, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    if bgr.dtype != np.uint8:
        bgr = (bgr >> 8).astype(np.uint8)
    return np.ascontiguousarray(bgr[..., 2::-1])
