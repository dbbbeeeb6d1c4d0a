"""Tags of TIFF that decoders do not report: size before decoding, pages, truncation.

Layouts: TIFF 6.0, section 2; BigTIFF.
"""

from __future__ import annotations

import mmap
import struct

TagValue = tuple[float, ...] | bytes
Tags = dict[int, TagValue]

WIDTH, HEIGHT, BITS, SAMPLES, FORMAT = 256, 257, 258, 277, 339
SUBFILE = 254
REDUCED, MASK = 1, 4
"""Bits of a page's kind: an overview of another page, and a mask of its pixels."""
EXTENTS = ((273, 279), (324, 325))
"""Tags of offsets and byte counts: of strips, of tiles."""
PIXEL_SCALE, TIE_POINT = 33550, 33922
GEOREFERENCE = frozenset((PIXEL_SCALE, TIE_POINT, 34264, 34735, 42112, 42113))
"""Tags whose meaning GDAL knows: pixel scale, tie points, matrix, GeoKeys, metadata and nodata of GDAL."""
_TYPES = {1: "B", 2: "s", 3: "H", 4: "I", 6: "b", 8: "h", 9: "i", 11: "f", 12: "d", 16: "Q", 17: "q", 18: "Q"}


def read_tags(data: mmap.mmap) -> tuple[Tags, tuple[int, ...]]:
    """Return the first page's tags, and the kind of each page in bits (`REDUCED`, `MASK`).

    Args:
        data: the whole file.

    Raises:
        ValueError: the file ends inside its directory or its pixels.
        struct.error: likewise.
    """
    order = "<" if data[:2] == b"II" else ">"
    big = struct.unpack(order + "H", data[2:4])[0] == 43
    (offset,) = struct.unpack(order + ("Q" if big else "I"), data[8:16] if big else data[4:8])
    tags, following = _directory(data, offset, order, big)
    seen, kinds = {offset}, [0]
    while following and following not in seen and len(seen) < 1000:
        seen.add(following)
        page, following = _directory(data, following, order, big, only=SUBFILE)
        kinds.append(int((floats(page, SUBFILE) or (0,))[0]))
    for offsets, counts in EXTENTS:
        ends = [a + n for a, n in zip(tags.get(offsets, ()), tags.get(counts, ()), strict=False)]
        if ends and max(ends) > len(data):
            raise ValueError(f"is truncated: {max(ends):.0f} bytes of pixels announced, {len(data)} there")
    return tags, tuple(kinds)


def _directory(
    data: mmap.mmap, offset: int, order: str, big: bool, only: int | None = None
) -> tuple[Tags, int]:
    """Return the tags of a directory (or one tag) and the next directory's offset."""
    count_type, head, entry, inline, pointer = ("Q", 8, 20, 8, "Q") if big else ("H", 2, 12, 4, "I")
    (n,) = struct.unpack(order + count_type, data[offset : offset + head])
    start = offset + head
    end = start + n * entry
    (following,) = struct.unpack(order + pointer, data[end : end + inline])
    tags: Tags = {}
    for at in range(start, end, entry):
        tag, kind, count = struct.unpack(order + "HH" + pointer, data[at : at + entry - inline])
        if kind not in _TYPES or only not in (None, tag):
            continue
        layout = f"{order}{count}{_TYPES[kind]}"
        size = struct.calcsize(layout)
        where = at + entry - inline
        if size > inline:
            (where,) = struct.unpack(order + pointer, data[where : where + inline])
        value = struct.unpack(layout, data[where : where + size])
        tags[tag] = value[0].rstrip(b"\0") if kind == 2 else value
    return tags, following


def floats(tags: Tags, tag: int) -> tuple[float, ...]:
    """Return the numbers of a tag; none where it is missing or a text."""
    value = tags.get(tag, ())
    return () if isinstance(value, bytes) else value
