"""Appearance of a world: its mesh in parts of one texture each."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from lirs_wct.formats.picture import read_picture, write_image
from lirs_wct.geometry import ByteArray, FloatArray, Pose2, WallGrid
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.meshing.texture import (
    FLOOR_SPAN,
    cube_uv,
    draped_uv,
    floor_texture,
    ground_texture,
    wall_texture,
    wall_uv,
)
from lirs_wct.world import World, texture_path

GROUND, WALLS = "ground", "walls"
HALF_PIXEL = 0.5 / 1024
"""Share of a draped picture omitted along its border: at least half a pixel of a drawn texture."""


@dataclass(frozen=True)
class Wear:
    """The texture of a part of a world.

    Attributes:
        name: name of the part, `ground` or `walls`.
        given: the user's file; None = drawn.
        draped: whether the picture covers the world once from above; else it is repeated.
        span: side of a repeated picture, meters; None = the longest side of the part.
    """

    name: str
    given: Path | None
    draped: bool
    span: float | None

    def pixels(self, world: World) -> ByteArray:
        """Return (rows, cols, 3) BGR; row 0 = upper edge, north in a draped picture.

        Raises:
            SourceError: the user's file cannot be read.
        """
        if self.given is not None:
            return _colors(self.given)
        if self.name == WALLS:
            return wall_texture()
        return ground_texture(world.surface) if world.walls is None else floor_texture()

    def write(self, world: World, folder: Path) -> Path:
        """Write the picture into a world's folder unless it exists; return its path inside."""
        path = texture_path(world.name, "texture" if self.name == GROUND else "wall_texture", self.given)
        if not (folder / path).is_file():
            write_image(folder / path, self.pixels(world))
        return path


class Part(NamedTuple):
    """Triangles of one texture, with texture coordinates and normals."""

    wear: Wear
    mesh: TriangleMesh


def ground_wear(world: World) -> Wear:
    """Return the texture of the ground; a drawn one is draped, unless it is a floor."""
    options = world.export_options
    if options.texture is not None:
        return Wear(GROUND, options.texture, options.drape, options.texture_size)
    drawn_once = world.walls is None
    return Wear(GROUND, None, drawn_once, None if drawn_once else FLOOR_SPAN)


def world_parts(world: World, mesh: TriangleMesh | None = None) -> tuple[Part, ...]:
    """Return the world's mesh in parts of one texture each.

    Args:
        world: source of the textures.
        mesh: triangles without attributes; None = the world's own mesh.

    Raises:
        ConfigError: the mesh has more triangles than its budget allows.
    """
    mesh, wear = world.mesh if mesh is None else mesh, ground_wear(world)
    if world.walls is None:
        laid = draped_uv(mesh, world.surface.bounds, HALF_PIXEL) if wear.draped else cube_uv(mesh, wear.span)
        return (Part(wear, laid),)
    return _map_parts(world, world.walls, mesh, wear)


def world_extent(world: World) -> tuple[FloatArray, FloatArray]:
    """Return the lowest and highest corner of a world's visible part, meters."""
    if world.solid is not None:
        low, high = world.solid.bounds
        return low.copy(), high.copy()
    west, south, east, north = world.surface.bounds
    top = max(float(world.surface.z.max()), 0.0 if world.walls is None else world.walls.height)
    return np.array((west, south, float(world.surface.z.min()))), np.array((east, north, top))


def pad_to_square(picture: ByteArray, size: tuple[float, float]) -> ByteArray:
    """Extend a picture of width x depth meters to a square of the longer side.

    The given picture fills the lower-left corner; the rest repeats its border.
    """
    pixels = max(picture.shape[:2])
    cols, rows = (max(1, round(pixels * side / max(size))) for side in size)
    fitting = cv2.resize(picture, (cols, rows), interpolation=cv2.INTER_AREA)
    wide: ByteArray = np.pad(fitting, ((pixels - rows, 0), (0, pixels - cols), (0, 0)), mode="edge")
    return wide


def _map_parts(world: World, walls: WallGrid, mesh: TriangleMesh, wear: Wear) -> tuple[Part, ...]:
    """Return floor and walls; pictures are parallel to the map's own axes."""
    rows, cols = walls.shape
    bounds = (0.0, 0.0, cols * walls.resolution, rows * walls.resolution)
    upright = mesh.vertices[mesh.faces][..., 2].max(axis=1) > 0
    in_map = _move(mesh, walls.origin.inverse())
    span = wear.span or max(bounds)
    floor = in_map.part(~upright)
    laid = draped_uv(floor, bounds, HALF_PIXEL) if wear.draped else cube_uv(floor, span)
    parts = [Part(wear, laid)]
    if upright.any():
        # The picture has the height of the walls.
        paint = Wear(WALLS, world.export_options.wall_texture, False, walls.height)
        parts.append(Part(paint, wall_uv(in_map.part(upright), walls.height)))
    return tuple(Part(wear, _move(mesh, walls.origin)) for wear, mesh in parts if len(mesh.faces))


def _move(mesh: TriangleMesh, T: Pose2) -> TriangleMesh:
    vertices = np.column_stack((T.apply(mesh.vertices[:, :2]), mesh.vertices[:, 2]))
    normals = mesh.normals
    if normals is not None:
        normals = np.column_stack((replace(T, x=0.0, y=0.0).apply(normals[:, :2]), normals[:, 2]))
    return replace(mesh, vertices=vertices, normals=normals)


def _colors(path: Path) -> ByteArray:
    """Return (rows, cols, 3) BGR, 8 bit, of a picture of any kind."""
    pixels = read_picture(path).pixels
    if pixels.dtype != np.uint8:
        pixels = (pixels >> 8).astype(np.uint8)
    bgr = pixels[..., :3] if pixels.ndim == 3 else cv2.cvtColor(pixels, cv2.COLOR_GRAY2BGR)
    return np.ascontiguousarray(bgr, np.uint8)
