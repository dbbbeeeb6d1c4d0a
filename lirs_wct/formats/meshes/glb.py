"""Shapes and instances of a GLB, from its JSON and binary chunks (glTF 2.0)."""

from __future__ import annotations

import base64
import json
import re
import struct
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lirs_wct.arrays import FloatArray, IntArray
from lirs_wct.formats.meshes.document import MOST_NODES, Document, place_triangles
from lirs_wct.formats.meshes.polygons import strip_triangles
from lirs_wct.geometry.mesh import TriangleMesh

_READ = re.compile(
    r"KHR_(materials_|texture_|lights_|mesh_quantization|animation_|xmp)|(EXT|MSFT)_(texture|lights)"
)
"""Prefixes of extensions that are read, or do not change shapes."""
_PACKED = {"KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression"}
_COPIES = "EXT_mesh_gpu_instancing"
_KINDS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_JSON, _BINARY = 0x4E4F534A, 0x004E4942
_LISTS, _STRIP, _FAN = 4, 5, 6


def read_glb(data: bytes, referenced: Callable[[str], bytes]) -> Document:
    """Read the instances of a GLB's scene.

    Args:
        data: of the file.
        referenced: reads a file that it names.

    Raises:
        ValueError: the file is damaged, or needs an extension that is not read.
    """
    scene = _Scene(data, referenced)
    parts = [part for part in scene.instances() if len(part.faces)]
    attributes = [p["attributes"] for mesh in scene.tree.get("meshes", []) for p in mesh["primitives"]]
    odd = any(
        {"sparse", "normalized"} & {*scene.entry("accessors", index)}
        for each in attributes
        for name, index in each.items()
        if not name.startswith("COLOR")
    )
    return Document(parts, "materials" in scene.tree, odd, scene.notes)


class _Scene:
    """A GLB: its JSON, its buffers, and lines on what is simplified."""

    def __init__(self, data: bytes, referenced: Callable[[str], bytes]) -> None:
        self.tree, binary = _chunks(data)
        self.notes, self._visits = list[str](), 0
        self._buffers = [
            _uri_bytes(b["uri"], referenced) if "uri" in b else b"" if i else binary
            for i, b in enumerate(self.tree.get("buffers", []))
        ]
        self._refuse(name for name in self.tree.get("extensionsRequired", []) if not _READ.match(name))

    def _refuse(self, extensions: Iterable[str]) -> None:
        if named := ", ".join(sorted(extensions)):
            raise ValueError(f"needs the extension {named}, which is not read; export without it")

    def entry(self, kind: str, index: int) -> Any:
        """Return an entry of a list in the JSON."""
        entries = self.tree.get(kind, [])
        if not 0 <= index < len(entries):
            raise ValueError(f"names entry {index} of its {kind}, there are {len(entries)}")
        return entries[index]

    def instances(self) -> Iterator[TriangleMesh]:
        """Yield each primitive at each place in the scene."""
        if "scenes" in self.tree:
            for root in self.entry("scenes", self.tree.get("scene", 0)).get("nodes", []):
                yield from self._below(root, np.eye(4))

    def _below(self, index: int, matrix: FloatArray) -> Iterator[TriangleMesh]:
        """Yield the instances of a node and of those below it."""
        self._visits += 1
        if self._visits > MOST_NODES:
            raise ValueError(f"has more than {MOST_NODES} nodes; nodes may contain themselves")
        node = self.entry("nodes", index)
        matrix = matrix @ _place(node)
        if "mesh" in node:
            mesh = self.entry("meshes", node["mesh"])
            name = f"mesh `{mesh.get('name', node['mesh'])}`"
            if "skin" in node or any(p.get("targets") for p in mesh["primitives"]):
                self.notes.append(f"{name} is read as its plain shape, without skin and morph targets")
            if _COPIES in node.get("extensions", {}):
                self.notes.append(f"the copies of {name} by {_COPIES} are left out")
            for primitive in mesh["primitives"]:
                yield place_triangles(*self._triangles(primitive), matrix)
        for child in node.get("children", []):
            yield from self._below(child, matrix)

    def _triangles(self, primitive: dict[str, Any]) -> tuple[FloatArray, IntArray]:
        """Return the points and triangles of a primitive; none of lines and points."""
        points = self._accessor(primitive["attributes"]["POSITION"]).astype(np.float64)
        corners, mode = np.arange(len(points)), primitive.get("mode", _LISTS)
        if "indices" in primitive:
            corners = self._accessor(primitive["indices"]).ravel().astype(np.int64)
        if mode in (_STRIP, _FAN):
            corners = corners[strip_triangles(len(corners), is_fan=mode == _FAN)]
        triangles = corners.reshape(-1, 3) if mode in (_LISTS, _STRIP, _FAN) else np.empty((0, 3), np.int64)
        if triangles.size and not 0 <= triangles.min() <= triangles.max() < len(points):
            raise IndexError("is damaged: a triangle has a corner that is not in the file")
        return points, triangles

    def _accessor(self, index: int) -> NDArray[Any]:
        """Return the (count, width) numbers of an accessor, sparse and normalized ones as they count."""
        entry = self.entry("accessors", index)
        kind, count, width = np.dtype(_KINDS[entry["componentType"]]), entry["count"], _WIDTHS[entry["type"]]
        if count > sum(map(len, self._buffers)):
            raise ValueError(f"is cut off: it lacks {count} numbers")
        if "bufferView" in entry:
            values = self._view(entry, count, kind, width)
        else:
            self._refuse(set() if "sparse" in entry else _PACKED & {*self.tree.get("extensionsUsed", [])})
            values = np.zeros((count, width), kind)
        if "sparse" in entry:
            some, values = entry["sparse"], values.copy()
            places = self._view(
                some["indices"], some["count"], np.dtype(_KINDS[some["indices"]["componentType"]])
            )
            values[places[:, 0]] = self._view(some["values"], some["count"], kind, width)
        if entry.get("normalized") and kind.kind != "f":
            values = np.maximum(values / np.iinfo(kind).max, -1.0)
        return values

    def _view(self, entry: dict[str, Any], count: int, kind: np.dtype[Any], width: int = 1) -> NDArray[Any]:
        """Return numbers of a buffer view."""
        view = self.entry("bufferViews", entry["bufferView"])
        buffer, size = self._buffers[view["buffer"]], kind.itemsize
        if not buffer:
            self._refuse(_PACKED & {*view.get("extensions", {})})
        start = view.get("byteOffset", 0) + entry.get("byteOffset", 0)
        try:
            return np.ndarray(
                (count, width), kind, buffer, start, (view.get("byteStride", size * width), size)
            )
        except (TypeError, ValueError) as error:  # by the version of NumPy
            raise ValueError(f"is damaged: {count} numbers at byte {start} are not in its buffer") from error


def _chunks(data: bytes) -> tuple[dict[str, Any], bytes]:
    """Return the JSON and the binary chunk."""
    if data[:8] != b"glTF\2\0\0\0":
        raise ValueError("is no GLB of version 2")
    at, found = 12, dict[int, bytes]()
    while at + 8 <= len(data):
        size, kind = struct.unpack_from("<II", data, at)
        found.setdefault(kind, data[at + 8 : at + 8 + size])
        at += 8 + size
    return json.loads(found[_JSON]), found.get(_BINARY, b"")


def _uri_bytes(uri: str, referenced: Callable[[str], bytes]) -> bytes:
    head, mark, text = uri.partition("base64,")
    return base64.b64decode(text) if mark and head.startswith("data:") else referenced(uri)


def _place(node: dict[str, Any]) -> FloatArray:
    """Return a node's 4x4 matrix."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    place, (*axis, w) = np.eye(4), node.get("rotation", (0.0, 0.0, 0.0, 1.0))
    cross = np.cross(axis, np.eye(3)).T
    place[:3, :3] += 2 * (w * cross + cross @ cross)
    place[:3, :3] *= np.array(node.get("scale", (1.0, 1.0, 1.0)))
    place[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return place
