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
from lirs_wct.formats.meshes.collada_stream import CREATED, GROUND
from lirs_wct.geometry.mesh import TriangleMesh


def write_document(path: Path, tiles: Iterable[TriangleMesh], texture: str | None = None) -> None:
    """Write tiles that have texture coordinates and normals, as one document in memory.

    Args:
        path: file.
        tiles: in the world frame.
        texture: path of the picture relative to the file, or None for a plain colour.
    """
    with path.open("wb") as file:
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
