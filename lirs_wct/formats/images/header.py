"""Size and completeness of a picture from its bytes, before any pixel is decoded.

Decoders allocate memory for the announced size, and some silently fill in missing pixels. Both are therefore
checked first. Every function raises ValueError with a reason, or struct.error if the file ends too early.
"""

from __future__ import annotations

import mmap
import re
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field

from lirs_wct.formats.images import tiff

MAX_PIXELS = 5000 * 5000
"""Larger pictures are refused unless the caller allows them."""
_PNM = re.compile(rb"P[1-6fF]\s+(?:#[^\n]*\n\s*)*(\d+)\s+(?:#[^\n]*\n\s*)*(\d+)")


@dataclass(frozen=True, slots=True)
class PictureHeader:
    """Size, pages and tags of a picture file.

    Attributes:
        width: pixels.
        height: pixels.
        pages: pictures in the file.
        tags: a TIFF's tags.
        masked: whether a page is a mask of the first one.
    """

    width: int
    height: int
    pages: int = 1
    tags: tiff.Tags = field(default_factory=dict)
    masked: bool = False


def read_header(data: mmap.mmap) -> PictureHeader:
    """Return the header of a PNG, PNM, GIF, JPEG, TIFF, BMP or WebP file.

    Raises:
        ValueError: the format is none of these, or the file is damaged.
        struct.error: the file ends inside its header.
    """
    readers: tuple[tuple[tuple[bytes, ...], Callable[[mmap.mmap], PictureHeader]], ...] = (
        ((b"\x89PNG\r\n\x1a\n",), _png),
        ((b"GIF87a", b"GIF89a"), _gif),
        ((b"\xff\xd8\xff",), _jpeg),
        ((b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"), _tiff),
        ((b"BM",), _bmp),
        ((b"RIFF",), _webp),
        (tuple(b"P%c" % c for c in b"123456fF"), _pnm),
    )
    start = data[:8]
    for magics, read in readers:
        if start.startswith(magics):
            return read(data)
    raise ValueError("is not a picture; legal: PNG, PGM/PNM, GIF, JPEG, TIFF, BMP, WebP")


def check_complete(data: mmap.mmap) -> None:
    """Check for damage that a decoder would ignore or report only on stderr.

    Raises:
        ValueError: the file is truncated or a checksum is wrong.
        struct.error: the file ends inside a structure.
    """
    if data[:4] == b"\x89PNG":
        _check_png(data)
    elif data[:3] == b"\xff\xd8\xff" and data.rfind(b"\xff\xd9") < data.rfind(b"\xff\xda"):
        raise ValueError("is truncated: the JPEG's end marker is missing")


def _png(data: mmap.mmap) -> PictureHeader:
    if data[12:16] != b"IHDR":
        raise ValueError("is damaged: the PNG does not begin with IHDR")
    return PictureHeader(*struct.unpack(">II", data[16:24]))


def _check_png(data: mmap.mmap) -> None:
    at, view = 8, memoryview(data)
    while at + 12 <= len(data):
        length, kind = struct.unpack(">I4s", data[at : at + 8])
        end = at + 8 + length
        if end + 4 > len(data):
            break
        if zlib.crc32(view[at + 4 : end]) != struct.unpack(">I", data[end : end + 4])[0]:
            raise ValueError(f"is damaged: checksum of PNG chunk {kind.decode('latin-1')} is wrong")
        if kind == b"IEND":
            return
        at = end + 4
    raise ValueError("is truncated: the PNG's end is missing")


def _gif(data: mmap.mmap) -> PictureHeader:
    width, height, flags = struct.unpack("<HHB", data[6:11])
    at, pages = 13 + _gif_table(flags), 0
    while at < len(data) and data[at] != 0x3B:
        if data[at] == 0x2C:
            w, h, flags = struct.unpack("<HHB", data[at + 5 : at + 10])
            width, height, pages = max(width, w), max(height, h), pages + 1
            at += 11 + _gif_table(flags)
        else:
            at += 2
        while at < len(data) and data[at]:
            at += data[at] + 1
        at += 1
    return PictureHeader(width, height, max(pages, 1))


def _gif_table(flags: int) -> int:
    """Return the bytes of a color table."""
    return 3 << (flags % 8 + 1) if flags & 0x80 else 0


def _jpeg(data: mmap.mmap) -> PictureHeader:
    at = 2
    while at < len(data):
        marker, length = struct.unpack(">HH", data[at : at + 4])
        if not 0xFFC0 <= marker <= 0xFFFE:
            break
        if marker <= 0xFFCF and marker not in (0xFFC4, 0xFFC8, 0xFFCC):
            height, width = struct.unpack(">HH", data[at + 5 : at + 9])
            return PictureHeader(width, height)
        at += 2 + length
    raise ValueError("is damaged: the JPEG has no frame header")


def _tiff(data: mmap.mmap) -> PictureHeader:
    tags, kinds = tiff.read_tags(data)
    if tiff.WIDTH not in tags or tiff.HEIGHT not in tags:
        raise ValueError("is damaged: the TIFF does not say its size")
    pages = sum(not kind & (tiff.REDUCED | tiff.MASK) for kind in kinds)
    masked = any(kind & tiff.MASK and not kind & tiff.REDUCED for kind in kinds)
    return PictureHeader(int(tags[tiff.WIDTH][0]), int(tags[tiff.HEIGHT][0]), pages, tags, masked)


def _bmp(data: mmap.mmap) -> PictureHeader:
    (size,) = struct.unpack("<I", data[14:18])
    width, height = struct.unpack("<HH", data[18:22]) if size == 12 else struct.unpack("<ii", data[18:26])
    return PictureHeader(width, abs(height))


def _webp(data: mmap.mmap) -> PictureHeader:
    """Read the first chunk of a WebP file (RFC 9649): lossy, lossless or extended."""
    form, kind = data[8:12], data[12:16]
    if form != b"WEBP" or kind not in (b"VP8 ", b"VP8L", b"VP8X"):
        raise ValueError("is not a picture: a RIFF file is read if it is a WebP")
    announced = struct.unpack("<I", data[4:8])[0] + 8
    if announced > len(data):
        raise ValueError(f"is truncated: {announced} bytes announced, {len(data)} there")
    if kind == b"VP8 ":
        width, height = (side & 0x3FFF for side in struct.unpack("<HH", data[26:30]))
        return PictureHeader(width, height)
    if kind == b"VP8L":
        (bits,) = struct.unpack("<I", data[21:25])
        return PictureHeader((bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1)
    if len(data) < 30:
        raise ValueError("is truncated: the file ends inside its header")
    width, height = (int.from_bytes(data[at : at + 3], "little") + 1 for at in (24, 27))
    return PictureHeader(width, height, max(_webp_frames(data), 1))


def _webp_frames(data: mmap.mmap) -> int:
    at, frames = 12, 0
    while at + 8 <= len(data):
        frames += data[at : at + 4] == b"ANMF"
        (length,) = struct.unpack("<I", data[at + 4 : at + 8])
        at += 8 + length + length % 2
    return frames


def _pnm(data: mmap.mmap) -> PictureHeader:
    found = _PNM.match(data[:4096])
    if found is None:
        raise ValueError("is damaged: the PNM header lacks the size")
    return PictureHeader(int(found[1]), int(found[2]))
