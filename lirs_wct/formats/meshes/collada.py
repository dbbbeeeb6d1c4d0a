"""COLLADA: a mesh with normals, texture coordinates and one material, upright in every consumer.

Z_UP data with a Z_UP tag and metres is upright in Gazebo (which ignores the tag) and elsewhere. The
inputs have distinct offsets: Gazebo's loader miscounts shared ones.
"""

from __future__ import annotations

import datetime
from collections.abc import Iterable
from pathlib import Path

import collada
import numpy as np
from collada import asset, geometry, material, scene, source
from collada.common import E, tag

from lirs_wct.arrays import FloatArray
from lirs_wct.errors import ConfigError
from lirs_wct.files import atomic_write
from lirs_wct.formats.meshes.collada_stream import CREATED, GROUND, stream_collada
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
            with temporary.open("wb") as file:
                _document(tiles, texture).write(file)


def _document(tiles: Iterable[TriangleMesh], texture: str | None) -> collada.Collada:
    document = collada.Collada()
    document.assetInfo.upaxis = asset.UP_AXIS.Z_UP
    document.assetInfo.unitname, document.assetInfo.unitmeter = "meter", 1.0
    document.assetInfo.created = document.assetInfo.modified = datetime.datetime.fromisoformat(CREATED)
    surface = _material(document, texture)
    shown = scene.MaterialNode("material", surface, inputs=[("UV", "TEXCOORD", "0")])
    nodes = [scene.GeometryNode(_geometry(document, t, tile), [shown]) for t, tile in enumerate(tiles)]
    document.scenes.append(scene.Scene("scene", [scene.Node("world", children=nodes)]))
    document.scene = document.scenes[0]
    return document


def _material(document: collada.Collada, texture: str | None) -> material.Material:
    diffuse: material.Map | tuple[float, ...] = GROUND
    parameters: list[object] = []
    if texture is not None:
        image = material.CImage("texture", texture)
        raster = material.Surface("surface", image)
        sampler = material.Sampler2D("sampler", raster)
        document.images.append(image)
        parameters, diffuse = [raster, sampler], material.Map(sampler, "UV")
    effect = material.Effect("effect", parameters, "lambert", diffuse=diffuse)
    surface = material.Material("material", "material", effect)
    document.effects.append(effect)
    document.materials.append(surface)
    return surface


def _geometry(document: collada.Collada, t: int, tile: TriangleMesh) -> geometry.Geometry:
    def floats(name: str, values: FloatArray | None, axes: tuple[str, ...]) -> source.FloatSource:
        return source.FloatSource(f"{name}{t}", np.asarray(values, dtype=np.float32), axes)

    parts = [
        floats("p", tile.vertices, ("X", "Y", "Z")),
        floats("n", tile.normals, ("X", "Y", "Z")),
        floats("u", tile.uv, ("S", "T")),
    ]
    shape = geometry.Geometry(document, f"tile{t}", f"tile{t}", parts)
    normal = {"semantic": "NORMAL", "source": f"#n{t}"}
    shape.xmlnode.find(f".//{tag('vertices')}").append(E.input(**normal))
    inputs = source.InputList()
    inputs.addInput(0, "VERTEX", f"#p{t}")
    inputs.addInput(1, "TEXCOORD", f"#u{t}", set="0")
    shape.primitives.append(shape.createTriangleSet(np.repeat(tile.faces.ravel(), 2), inputs, "material"))
    document.geometries.append(shape)
    return shape
