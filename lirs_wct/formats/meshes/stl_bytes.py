"""Triangles of an STL, binary or text, with bytes that do not belong to it."""

from __future__ import annotations

import re

import numpy as np

from lirs_wct.formats.meshes.document import Document, numbers
from lirs_wct.geometry.mesh import TriangleMesh

_HEAD = 84
_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_CORNER = re.compile(rb"\bvertex\s+(\S+\s+\S+\s+\S+)")


def read_stl(data: bytes) -> Document:
    """Read the triangles of an STL.

    Raises:
        ValueError: the file is cut off, or a number is none.
    """
    count = int.from_bytes(data[_HEAD - 4 : _HEAD], "little")
    need = _HEAD + _FACET.itemsize * count
    if len(data) != need and data.lstrip()[:5].lower() == b"solid" and b"\0" not in data:
        corners = numbers(b" ".join(_CORNER.findall(data.lower())), np.float64).reshape(-1, 3)
        if len(corners) % 3:
            raise ValueError(f"is damaged: {len(corners)} corners are no whole triangles")
    elif len(data) < need:
        raise ValueError(f"is cut off: {count} triangles need {need} bytes, it has {len(data)}")
    else:
        facets = np.frombuffer(data, _FACET, count, _HEAD) if count else np.empty(0, _FACET)
        corners = facets["corners"].reshape(-1, 3).astype(np.float64)
    return Document([TriangleMesh(corners, np.arange(len(corners), dtype=np.int32).reshape(-1, 3))])
