"""Vertices and faces of a Wavefront OBJ."""

from __future__ import annotations

import re
from bisect import bisect_left

import numpy as np

from lirs_wct.formats.meshes.document import Document, numbers
from lirs_wct.formats.meshes.polygons import cut_polygons
from lirs_wct.geometry.mesh import TriangleMesh

_MARK = b"\xef\xbb\xbf"
_POINT = re.compile(rb"^v +(\S+\s+\S+\s+\S+)", re.M)
_FACE = re.compile(rb"^f +([^#\n]*)", re.M)


def read_obj(data: bytes) -> Document:
    """Read the faces of an OBJ; their negative indices count back from the vertices so far.

    Raises:
        ValueError: a number is none.
    """
    text = _plain(data)
    points = numbers(b" ".join(_POINT.findall(text)), np.float64).reshape(-1, 3)
    lines = _FACE.findall(text)
    block = b"\n".join(lines)
    if b"-" in block:
        lines = _FACE.findall(_count_forward(text))
        block = b"\n".join(lines)
    counts = np.array([len(line.split()) for line in lines], np.int64)
    corners = numbers(re.sub(rb"/\S*", b"", block) if b"/" in block else block, np.int64) - 1
    mesh = TriangleMesh(points, corners[cut_polygons(points, corners, counts)].astype(np.int32))
    return Document([mesh], b"usemtl" in text or b"\nvt " in text)


def _plain(data: bytes) -> bytes:
    """Return the text without continued, indented or tabbed lines."""
    text = data.removeprefix(_MARK).replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if b"\\\n" in text:
        text = re.sub(rb"^[ \t]*#.*", b"", text, flags=re.M).replace(b"\\\n", b" ")
    if b"\t" in text or b"\n " in text or text[:1] == b" ":
        text = re.sub(rb"^[ \t]*(\w+)[ \t]+", rb"\1 ", text, flags=re.M).replace(b"\t", b" ")
    return text


def _count_forward(text: bytes) -> bytes:
    """Return the text with positive indices only."""
    places = [[m.start() for m in re.finditer(rb"^%s " % word, text, re.M)] for word in (b"v", b"vt", b"vn")]

    def positive(line: re.Match[bytes]) -> bytes:
        before = [bisect_left(starts, line.start()) for starts in places]
        corners = [corner.split(b"/") for corner in line[1].split()]
        return b"f " + b" ".join(
            b"/".join(
                b"%d" % (n + 1 + int(i)) if i[:1] == b"-" else i for i, n in zip(corner, before, strict=False)
            )
            for corner in corners
        )

    return _FACE.sub(positive, text)
