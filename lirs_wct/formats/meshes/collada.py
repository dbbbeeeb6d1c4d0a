"""COLLADA documents: meshes with normals, texture coordinates and materials.

Z_UP data with a Z_UP tag and meters is upright in Gazebo (which ignores the tag) and in other programs. The
inputs have distinct offsets: Gazebo's loader miscounts shared ones (see `collada_stream`).
"""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from pathlib import Path

import collada
import numpy as np
from collada import asset, geometry, material, scene, source

from lirs_wct.arrays import FloatArray
from lirs_wct.formats.meshes.collada_stream import CREATED, GROUND, MeshPart


def write_document(path: Path, parts: Sequence[MeshPart]) -> None:
    """Write parts as one geometry, from a document in memory."""
    with path.open("wb") as file:
        _document(parts).write(file)


def _document(parts: Sequence[MeshPart]) -> collada.Collada:
    document = collada.Collada()
    document.assetInfo.upaxis = asset.UP_AXIS.Z_UP
    document.assetInfo.unitname, document.assetInfo.unitmeter = "meter", 1.0
    document.assetInfo.created = document.assetInfo.modified = datetime.datetime.fromisoformat(CREATED)
    shown = [
        scene.MaterialNode(
            part.name, _material(document, part.name, part.texture), inputs=[("UV", "TEXCOORD", "0")]
        )
        for part in parts
    ]
    node = scene.GeometryNode(_geometry(document, parts), shown)
    document.scenes.append(scene.Scene("scene", [scene.Node("world", children=[node])]))
    document.scene = document.scenes[0]
    return document


def _material(document: collada.Collada, name: str, texture: str | None) -> material.Material:
    diffuse: material.Map | tuple[float, ...] = GROUND
    parameters: list[object] = []
    if texture is not None:
        image = material.CImage(f"{name}-texture", texture)
        raster = material.Surface(f"{name}-surface", image)
        sampler = material.Sampler2D(f"{name}-sampler", raster)
        document.images.append(image)
        parameters, diffuse = [raster, sampler], material.Map(sampler, "UV")
    effect = material.Effect(f"{name}-effect", parameters, "lambert", diffuse=diffuse)
    surface = material.Material(name, name, effect)
    document.effects.append(effect)
    document.materials.append(surface)
    return surface


def _geometry(document: collada.Collada, parts: Sequence[MeshPart]) -> geometry.Geometry:
    def floats(name: str, values: list[FloatArray], axes: tuple[str, ...]) -> source.FloatSource:
        return source.FloatSource(name, np.concatenate(values, dtype=np.float32), axes)

    sources = [
        floats("positions", [part.mesh.vertices for part in parts], ("X", "Y", "Z")),
        floats("normals", [part.normals for part in parts], ("X", "Y", "Z")),
        floats("UV", [part.uv for part in parts], ("S", "T")),
    ]
    shape = geometry.Geometry(document, "mesh", "mesh", sources)
    inputs = source.InputList()
    inputs.addInput(0, "VERTEX", "#positions")
    inputs.addInput(1, "NORMAL", "#normals")
    inputs.addInput(2, "TEXCOORD", "#UV", set="0")
    before = 0
    for part in parts:
        corners = np.repeat(part.mesh.faces.ravel() + before, 3)
        shape.primitives.append(shape.createTriangleSet(corners, inputs, part.name))
        before += len(part.mesh.vertices)
    document.geometries.append(shape)
    return shape
