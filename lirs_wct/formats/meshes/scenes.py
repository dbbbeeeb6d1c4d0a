"""Files with a scene of instances: COLLADA and GLB (glTF 2.0).

trimesh and pycollada read real files wrongly: they leave out skinned instances and those whose material is
missing, fill holes and notches of polygons, do not scale normalized integers, and give zeros for compressed
shapes.
"""

from __future__ import annotations

import base64
import json
import math
import re
import struct
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from lirs_wct.arrays import FloatArray, IntArray
from lirs_wct.errors import SourceError
from lirs_wct.formats.meshes import (
    MAX_NODES,
    Document,
    cut_polygons,
    numbers,
    place_triangles,
    strip_triangles,
)
from lirs_wct.geometry.mesh import TriangleMesh

_MAX_CONTROLLERS = 10
_NO_MOVE = "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"
_MOVES = {"matrix", "translate", "rotate", "scale", "lookat", "skew"}
_INSTANCES = {"instance_node", "instance_geometry", "instance_controller"}
_PRIMITIVES = {"triangles", "polylist", "polygons", "tristrips", "trifans"}


def collada_frame(path: Path) -> tuple[str, float]:
    """Return the up axis and the meters per unit; defaults: Y, 1."""
    depth, up, unit = 0, "Y", "1"
    for event, element in ElementTree.iterparse(path, ("start", "end")):
        depth += 1 if event == "start" else -1
        if (depth, event, _local(element)) == (1, "end", "asset"):
            asset = {_local(child): child for child in element}
            up = (asset["up_axis"].text or "").strip()[:1] if "up_axis" in asset else up
            unit = asset["unit"].get("meter", "1") if "unit" in asset else unit
            break
    try:
        meters = float(unit)
    except ValueError:
        raise SourceError(f"{path}: its unit is not a number of meters") from None
    if up not in ("X", "Y", "Z"):
        raise SourceError(f"{path}: its up axis must be X_UP, Y_UP or Z_UP")
    if not 0 < meters < math.inf:
        raise SourceError(f"{path}: its unit must be above 0 m, got {meters:g}")
    return up, meters


def read_collada(data: bytes) -> Document:
    """Read the instances of the scene, with polygons cut and skins in their bind pose."""
    tree = _Shapes(data)
    instances = list(tree.instances())
    parts = [
        place_triangles(points, faces, matrix)
        for name, matrix in instances
        for points, faces in tree.shape(name)
    ]
    if tree.skipped:
        named = ", ".join(dict.fromkeys(tree.skipped))
        tree.notes.append(
            f"{len(tree.skipped)} of {len(instances) + len(tree.skipped)} instances left out: {named}"
        )
    looks = tree.root.find(".//instance_material") is not None
    return Document([part for part in parts if len(part.faces)], looks, notes=tree.notes)


def _local(element: Element) -> str:
    return element.tag.rpartition("}")[2]


class _Shapes:
    """The tree of a document without namespaces, with notes on simplified and skipped instances."""

    def __init__(self, data: bytes) -> None:
        if b"<!DOCTYPE" in data.replace(b"\0", b""):
            raise ValueError("has a DOCTYPE, which is not read; remove it")
        self.root = ElementTree.fromstring(data)
        for element in self.root.iter():
            element.tag = _local(element)
        self.notes, self.skipped = list[str](), list[str]()
        self._ids = {(e.tag, e.get("id", "")): e for e in self.root.iter() if "id" in e.attrib}
        self._shapes: dict[str, list[tuple[FloatArray, IntArray]]] = {}
        self._visits = 0

    def _target(self, element: Element, tag: str) -> Element:
        """Return the element that another one names."""
        key = element.get("url", "").removeprefix("#")
        if (tag, key) not in self._ids:
            raise ValueError(f"names the {tag} `{key}`, which is not in the file")
        return self._ids[tag, key]

    def instances(self) -> Iterator[tuple[str, FloatArray]]:
        """Yield the geometry and the place of each instance in the scene."""
        named = self.root.find("scene/instance_visual_scene")
        scene = self.root.find(".//visual_scene") if named is None else self._target(named, "visual_scene")
        if scene is not None:
            yield from self._below(scene, np.eye(4))

    def _below(self, node: Element, matrix: FloatArray) -> Iterator[tuple[str, FloatArray]]:
        """Yield the instances in a node and below it."""
        self._visits += 1
        if self._visits > MAX_NODES:
            raise ValueError(f"has more than {MAX_NODES} nodes; nodes may contain themselves")
        for element in node:
            if element.tag in _MOVES:
                matrix = matrix @ _move(element.tag, numbers(element.text or "", np.float64))
        for element in node:
            url = element.get("url", "")
            if element.tag == "node":
                yield from self._below(element, matrix)
            elif element.tag in _INSTANCES and not url.startswith("#"):
                self.skipped.append(f"`{url}` is in another file")
            elif element.tag == "instance_node":
                yield from self._below(self._target(element, "node"), matrix)
            elif element.tag == "instance_controller":
                yield self._bound(url, matrix)
            elif element.tag == "instance_geometry":
                if self._target(element, "geometry").find("mesh") is None:
                    self.skipped.append(f"geometry `{url[1:]}` is no mesh")
                else:
                    yield url[1:], matrix

    def _bound(self, url: str, matrix: FloatArray) -> tuple[str, FloatArray]:
        """Return the geometry of a skin or morph, and its place in the bind pose."""
        for _ in range(_MAX_CONTROLLERS):
            if ("geometry", url[1:]) in self._ids:
                break
            inner = self._target(Element("", url=url), "controller")[0]
            shape = numbers(inner.findtext("bind_shape_matrix") or _NO_MOVE, np.float64)
            matrix = matrix @ shape.reshape(4, 4)
            self.notes.append(
                f"{inner.tag} `{url[1:]}` is read as its plain shape, without joints and weights"
            )
            url = inner.get("source", "")
        return url[1:], matrix

    def shape(self, name: str) -> list[tuple[FloatArray, IntArray]]:
        """Return the points and triangles of each primitive of a geometry."""
        if name not in self._shapes:
            mesh, self._shapes[name] = self._ids["geometry", name].find("mesh"), []
            assert mesh is not None
            for primitive in (element for element in mesh if element.tag in _PRIMITIVES):
                inputs = primitive.findall("input")
                width = 1 + max(int(i.get("offset", 0)) for i in inputs)
                vertex = next(i for i in inputs if i.get("semantic") == "VERTEX")
                rows, counts, rings = _polygons(primitive, width)
                points, corners = _points(mesh, vertex), rows[:, int(vertex.get("offset", 0))]
                self._shapes[name].append((points, corners[cut_polygons(points, corners, counts, rings)]))
        return self._shapes[name]


def _points(mesh: Element, vertex: Element) -> FloatArray:
    """Return the positions that the vertices of a primitive name."""
    ids = {e.get("id"): e for e in mesh if "id" in e.attrib}
    source = ids[vertex.get("source", "")[1:]]
    for position in source.findall("input"):
        if position.get("semantic") == "POSITION":
            source = ids[position.get("source", "")[1:]]
    values = numbers(source.findtext("float_array") or "", np.float64)
    accessor = source.find("technique_common/accessor")
    if accessor is None:
        return values.reshape(-1, 3)
    first, stride = int(accessor.get("offset", 0)), int(accessor.get("stride", 1))
    names = [param.get("name") for param in accessor.findall("param")]
    axes = [names.index(axis) for axis in "XYZ"] if {*"XYZ"} <= {*names} else [0, 1, 2]
    rows = (len(values) - first) // stride
    points: FloatArray = values[first : first + rows * stride].reshape(rows, stride)[:, axes]
    return points


def _polygons(primitive: Element, width: int) -> tuple[IntArray, IntArray, dict[int, list[int]]]:
    """Return indices of all corners, counts of the polygons, and rings of those with holes."""

    def rows(*elements: Element) -> IntArray:
        return numbers(" ".join(e.text or "" for e in elements), np.int64).reshape(-1, width)

    lists = [np.empty((0, width), np.int64), *(rows(e) for e in primitive.findall("p"))]
    rings: dict[int, list[int]] = {}
    if primitive.tag == "polylist":
        counts = numbers(primitive.findtext("vcount") or "", np.int64)
        return np.concatenate(lists)[: counts.sum()], counts, rings
    if primitive.tag == "polygons":
        for ring in primitive.findall("ph"):
            each = [rows(e) for e in ring if e.tag in ("p", "h")]
            rings[len(lists) - 1] = np.cumsum([len(r) for r in each]).tolist()
            lists.append(np.concatenate(each))
        return np.concatenate(lists), np.array([len(e) for e in lists[1:]], np.int64), rings
    if primitive.tag != "triangles":  # strips and fans
        lists = [
            each[strip_triangles(len(each), is_fan=primitive.tag == "trifans").ravel()] for each in lists
        ]
    table = np.concatenate(lists)
    return table, np.full(len(table) // 3, 3), rings


def _move(kind: str, values: FloatArray) -> FloatArray:
    """Return the 4x4 matrix of a node's transform."""
    moved = np.eye(4)
    if kind == "matrix":
        return values.reshape(4, 4)
    if kind == "translate":
        moved[:3, 3] = values
    elif kind == "scale":
        moved[:3, :3] = np.diag(values)
    elif kind == "rotate":
        axis, angle = values[:3] / (np.linalg.norm(values[:3]) or 1.0), np.radians(values[3])
        turn = np.cross(axis, np.eye(3)).T
        moved[:3, :3] += np.sin(angle) * turn + (1 - np.cos(angle)) * turn @ turn
    elif kind == "lookat":
        eye, interest, up = values.reshape(3, 3)
        back = (eye - interest) / np.linalg.norm(eye - interest)
        side = np.cross(up, back) / np.linalg.norm(np.cross(up, back))
        moved[:3] = np.column_stack((side, np.cross(back, side), back, eye))
    else:
        raise ValueError("has a node with <skew>, which is not read; apply the transforms before the export")
    return moved


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
    """Read the instances of a GLB's scene; `referenced` reads a file that it names."""
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
        if data[:8] != b"glTF\2\0\0\0":
            raise ValueError("is no GLB of version 2")
        at, chunks = 12, dict[int, bytes]()
        while at + 8 <= len(data):
            size, kind = struct.unpack_from("<II", data, at)
            chunks.setdefault(kind, data[at + 8 : at + 8 + size])
            at += 8 + size
        self.tree: dict[str, Any] = json.loads(chunks[_JSON])
        self.notes, self._visits = list[str](), 0
        self._buffers = [
            _read_uri(b["uri"], referenced) if "uri" in b else b"" if i else chunks.get(_BINARY, b"")
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
        if self._visits > MAX_NODES:
            raise ValueError(f"has more than {MAX_NODES} nodes; nodes may contain themselves")
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


def _read_uri(uri: str, referenced: Callable[[str], bytes]) -> bytes:
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
