"""COLLADA for millions of triangles: tile by tile, each a geometry with short indices.

Tiles keep the memory bounded and the indices short, which are half of the file. Vertices on the
border of two tiles are written in both, from the same numbers, so that the whole stays closed.
NORMAL stands inside <vertices>; a position then may have one normal and texture coordinate only within
a tile, since Gazebo joins equal positions.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import BinaryIO
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import ArrayLike

from lirs_wct.arrays import FloatArray
from lirs_wct.errors import ConfigError
from lirs_wct.formats.meshes.text import fixed_text
from lirs_wct.geometry.mesh import TriangleMesh

CREATED = "2020-01-01T00:00:00"
"""Stands in every file: the same world gives the same bytes."""
GROUND = (0.62, 0.57, 0.5, 1.0)
"""Colour of a world without texture, RGBA."""
_NORMAL_DECIMALS, _UV_DECIMALS = 3, 4

_HEAD = """<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><created>{created}</created><modified>{created}</modified>
<unit name="meter" meter="1"/><up_axis>Z_UP</up_axis></asset>
{images}<library_effects><effect id="effect"><profile_COMMON>{parameters}
<technique sid="common"><lambert><diffuse>{diffuse}</diffuse></lambert></technique>
</profile_COMMON></effect></library_effects>
<library_materials><material id="material" name="material"><instance_effect url="#effect"/></material>
</library_materials>
<library_geometries>
"""
_IMAGES = (
    '<library_images><image id="texture" name="texture"><init_from>{}</init_from></image></library_images>\n'
)
_PARAMETERS = """<newparam sid="surface"><surface type="2D"><init_from>texture</init_from></surface>
</newparam>
<newparam sid="sampler"><sampler2D><source>surface</source></sampler2D></newparam>"""
_SOURCE = """<source id="{id}"><float_array id="{id}-array" count="{size}">
"""
_SOURCE_END = """</float_array><technique_common><accessor source="#{id}-array" count="{n}" stride="{k}">
{params}</accessor></technique_common></source>
"""
_TRIANGLES = """<vertices id="v{t}"><input semantic="POSITION" source="#p{t}"/>
<input semantic="NORMAL" source="#n{t}"/></vertices>
<triangles count="{count}" material="material"><input semantic="VERTEX" source="#v{t}" offset="0"/>
<input semantic="TEXCOORD" source="#u{t}" offset="1" set="0"/><p>
"""
_INSTANCE = """<instance_geometry url="#tile{t}"><bind_material><technique_common>
<instance_material symbol="material" target="#material"><bind_vertex_input semantic="UV" \
input_semantic="TEXCOORD" input_set="0"/></instance_material></technique_common></bind_material>
</instance_geometry>
"""


def stream_collada(
    path: Path, tiles: Iterable[TriangleMesh], size: ArrayLike, texture: str | None, step: float = 2e-6
) -> None:
    """Write tiles as they come.

    Args:
        path: file.
        tiles: meshes with texture coordinates and normals.
        size: extent of them all along x, y, z, metres: it gives the digits that are worth writing.
        texture: path of the picture relative to the file, or None for a plain color.
        step: share of the width that positions are exact to; heights, to ten times this share of their own.

    Raises:
        ConfigError: a tile lacks texture coordinates or normals.
        OSError: the file cannot be written.
    """
    color = " ".join(map(str, GROUND))
    head = _HEAD.format(
        created=CREATED,
        images=_IMAGES.format(escape(texture)) if texture else "",
        parameters=_PARAMETERS if texture else "",
        diffuse='<texture texture="sampler" texcoord="UV"/>' if texture else f"<color>{color}</color>",
    )
    with path.open("wb") as file:
        file.write(head.encode())
        count, decimals = 0, _position_decimals(size, step)
        for tile in tiles:
            _write_tile(file, count, tile, decimals)
            count += 1
        file.write(b'</library_geometries>\n<library_visual_scenes><visual_scene id="scene">')
        file.write(b'<node id="world" name="world">\n')
        file.writelines(_INSTANCE.format(t=t).encode() for t in range(count))
        file.write(b"</node></visual_scene></library_visual_scenes>\n")
        file.write(b'<scene><instance_visual_scene url="#scene"/></scene></COLLADA>\n')


def _write_tile(file: BinaryIO, t: int, tile: TriangleMesh, decimals: tuple[int, ...]) -> None:
    if tile.uv is None or tile.normals is None:
        raise ConfigError("a mesh needs texture coordinates and normals to be streamed as COLLADA")
    file.write(f'<geometry id="tile{t}" name="tile{t}"><mesh>\n'.encode())
    _write_source(file, f"p{t}", tile.vertices, decimals, "XYZ")
    _write_source(file, f"n{t}", tile.normals, (_NORMAL_DECIMALS,) * 3, "XYZ")
    _write_source(file, f"u{t}", tile.uv, (_UV_DECIMALS,) * 2, "ST")
    file.write(_TRIANGLES.format(t=t, count=len(tile.faces)).encode())
    file.write(fixed_text(np.repeat(tile.faces, 2, axis=1), (0,) * 6))
    file.write(b"</p></triangles></mesh></geometry>\n")


def _write_source(
    file: BinaryIO, name: str, values: FloatArray, decimals: tuple[int, ...], axes: str
) -> None:
    params = "".join(f'<param name="{axis}" type="float"/>' for axis in axes)
    file.write(_SOURCE.format(id=name, size=values.size).encode())
    file.write(fixed_text(values, decimals))
    file.write(_SOURCE_END.format(id=name, n=len(values), k=len(axes), params=params).encode())


def _position_decimals(size: ArrayLike, step: float) -> tuple[int, int, int]:
    """Return the digits worth writing: with 2e-6, 0.1 mm in a world of 50 m and 5 m of relief."""
    x, y, z = np.asarray(size, dtype=np.float64)
    least = np.array([max(x, y) * step, max(x, y) * step, z * 10 * step])
    a, b, c = np.clip(np.ceil(-np.log10(np.maximum(least, 1e-9)) - 1e-9), 0, 6).astype(int).tolist()
    return a, b, c
