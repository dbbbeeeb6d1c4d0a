"""Headers of point clouds, checked against the file's size before a library allocates memory for them."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import BinaryIO

from lirs_wct.errors import SourceError

LAS_BEGIN = b"LASF"
"""The first bytes of a LAS or LAZ file."""
_LAS_HEADER, _LAS_14_HEADER = 227, 375
"""Bytes of the public header of LAS 1.0 to 1.2, and of 1.4."""
_VLR, _EVLR = (54, 18, "<H"), (60, 18, "<Q")
"""Bytes of a record's header, place and format of the length of what follows it."""
_COMPRESSED = 0x80
"""Bit of the point format that marks LAZ."""
_PCD_HEADER = 1 << 14
_LZF = 90
"""LZF writes at most 264 bytes for 3."""


def check_las(path: Path) -> bool:
    """Return whether the points of a LAS file are compressed; the format is ASPRS LAS 1.4, section 2.

    Raises:
        SourceError: the file is none, or shorter than its header says.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(_LAS_14_HEADER)
        if not head.startswith(LAS_BEGIN):
            begin = head[: len(LAS_BEGIN)]
            raise SourceError(
                f"{path}: is not a LAS file: it begins with {begin!r}, those with {LAS_BEGIN!r}"
            )
        if len(head) < _LAS_HEADER:
            raise SourceError(f"{path}: is cut off: a LAS header has {_LAS_HEADER} bytes, this file {size}")
        header, start, records = struct.unpack_from("<HII", head, 94)
        form, length, points = struct.unpack_from("<BHI", head, 104)
        if not _LAS_HEADER <= header <= start <= size:
            raise SourceError(
                f"{path}: is damaged: its header has {header} bytes and its points begin at byte {start}; "
                f"legal: {_LAS_HEADER} <= header <= begin <= {size}, the file's size"
            )
        _check_records(path, file, records, header, start, _VLR)
        if head[25] >= 4 and len(head) == _LAS_14_HEADER <= header:
            extended, count, points = struct.unpack_from("<QIQ", head, 235)
            if count:
                _check_records(path, file, count, extended, size, _EVLR)
    compressed = bool(form & _COMPRESSED)
    if length == 0 or (not compressed and start + points * length > size):
        raise SourceError(
            f"{path}: is damaged or cut off: {points} points of {length} bytes from byte {start} on "
            f"are not in a file of {size}"
        )
    return compressed


def _check_records(
    path: Path, file: BinaryIO, count: int, begin: int, end: int, kind: tuple[int, int, str]
) -> None:
    """Raise SourceError unless so many records of variable length lie between two bytes of a file."""
    head, place, form = kind
    at = begin
    for _ in range(count if begin + count * head <= end else 0):
        file.seek(at)
        record = file.read(head)
        at += head + (struct.unpack_from(form, record, place + 2)[0] if len(record) == head else end)
        if at > end:
            break
    if begin + count * head > end or at > end:
        raise SourceError(
            f"{path}: is damaged: {count} records from byte {begin} on reach beyond byte {end}, their end"
        )


def check_pcd(path: Path) -> None:
    """Check that the points of a PCD file fit into it.

    Raises:
        SourceError: the file is shorter than its header says.
    """
    with path.open("rb") as file:
        head = file.read(_PCD_HEADER)
        entries, form, begin = _pcd_entries(head)
        file.seek(begin)
        packed = file.read(8)
    try:
        sizes, counts = ([int(n) for n in entries[key]] for key in (b"SIZE", b"COUNT"))
        points = int(entries[b"POINTS"][0])
    except (KeyError, ValueError, IndexError):
        return  # the reader says what is wrong with it
    record, values = sum(n * k for n, k in zip(sizes, counts, strict=False)), sum(counts)
    size = path.stat().st_size
    left = size - begin
    if form == b"binary_compressed":
        need, unpacked = struct.unpack("<II", packed) if len(packed) == 8 else (size, 0)
        fits = need <= left - 8 and max(unpacked, points * record) <= _LZF * need
    else:
        fits = points * (record if form == b"binary" else values) <= left
    if values > size or (points != 0 and not (fits and points > 0 and record > 0)):
        raise SourceError(
            f"{path}: is damaged or cut off: {points} points of {record} bytes are not in a file of {size}"
        )


def _pcd_entries(head: bytes) -> tuple[dict[bytes, list[bytes]], bytes, int]:
    """Return the lines of a PCD header by their first word, its kind of data and where these begin."""
    entries: dict[bytes, list[bytes]] = {}
    at = 0
    for line in head.splitlines(keepends=True):
        at += len(line)
        words = line.split()
        if words:
            entries[words[0].upper()] = words[1:]
            if words[0].upper() == b"DATA":
                break
    return entries, b"".join(entries.get(b"DATA", [])[:1]).lower(), at
