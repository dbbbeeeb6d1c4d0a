"""Messages of a cut-off SQLite database: the rows of all remaining pages.

SQLite finds rows from the root of a table, whose pages come late in a file that grew. A cut-off file often
holds rows that no root refers to. Pages with rows are found by their first byte.
The format: https://www.sqlite.org/fileformat2.html, sections 1.3, 1.6 and 2.1.
"""

from __future__ import annotations

import mmap
import sqlite3
import struct
from collections.abc import Iterator
from pathlib import Path
from shutil import copyfile

from lirs_wct.formats.rosbag.salvage.message import SalvagedMessage, Topic

MAGIC = b"SQLite format 3\0"
HEADER = 100
"""Bytes of a database's header."""
LEAF = 13
"""First byte of a page with rows of a table."""
INTEGERS = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8, 8: 0, 9: 0}
"""Bytes of an integer by its serial type; 8 and 9 are the numbers 0 and 1."""


def database_size(begin: bytes) -> int:
    """Return the bytes of a database by its header: page size times page count."""
    page, pages = struct.unpack(">16xH10xI", begin[:32])
    return int(pages * (65536 if page == 1 else page))


def database_messages(path: Path, whole: Path) -> Iterator[SalvagedMessage]:
    """Yield the complete messages of a cut-off bag database in file order.

    Args:
        path: of the database.
        whole: path for a copy with the original length, which SQLite can open.

    Raises:
        sqlite3.DatabaseError: the topics are lost.
    """
    topics = _topics(path, whole)
    seen = set()  # a page that was used before may still hold its old rows
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        for number, payload in _rows(data):
            row = _message(payload)
            if row is not None and row[0] in topics and number not in seen:
                seen.add(number)
                yield SalvagedMessage(topics[row[0]], row[1], row[2])


def _topics(path: Path, whole: Path) -> dict[int, Topic]:
    """Return the topics of a database by their numbers."""
    copyfile(path, whole)
    with whole.open("r+b") as file:
        file.truncate(database_size(file.read(HEADER)))
    connection = sqlite3.connect(f"file:{whole}?mode=ro&immutable=1", uri=True)
    try:
        rows = connection.execute("SELECT id, name, type FROM topics")
        return {number: Topic(name, kind, "") for number, name, kind in rows}
    finally:
        connection.close()


def _rows(data: mmap.mmap) -> Iterator[tuple[int, bytes]]:
    """Yield number and record of the complete rows of all tables."""
    (size,) = struct.unpack_from(">H", data, 16)
    size = 65536 if size == 1 else size
    usable = size - data[20]
    for start in range(size, len(data) - size + 1, size):  # the first page holds no messages
        if data[start] != LEAF:
            continue
        (cells,) = struct.unpack_from(">H", data, start + 3)
        if 8 + 2 * cells > size:
            continue
        for offset in struct.unpack_from(f">{cells}H", data, start + 8):
            if 8 + 2 * cells <= offset < usable - 3:
                length, at = _varint(data, start + offset)
                number, at = _varint(data, at)
                record = _record(data, at, length, size, usable)
                if record is not None:
                    yield number, record


def _record(data: mmap.mmap, at: int, length: int, size: int, usable: int) -> bytes | None:
    """Return a row's record with its overflow pages; None if one is missing."""
    most, least = usable - 35, (usable - 12) * 32 // 255 - 23
    held = least + (length - least) % (usable - 4)
    here = length if length <= most else held if held <= most else least
    found = data[at : at + here]
    if length == here:
        return found
    parts, (page,) = [found], struct.unpack_from(">I", data, at + here)
    left = length - here
    while left > 0:
        start = (page - 1) * size
        if page < 2 or start + size > len(data):
            return None
        (page,) = struct.unpack_from(">I", data, start)
        parts.append(data[start + 4 : start + 4 + min(left, usable - 4)])
        left -= usable - 4
    return b"".join(parts)


def _message(record: bytes) -> tuple[int, int, bytes] | None:
    """Return topic, stamp and bytes of a record (id, integer, integer, blob), else None."""
    length, at = _varint(record, 0)
    kinds = []
    while at < length:
        kind, at = _varint(record, at)
        kinds.append(kind)
    if len(kinds) != 4 or kinds[0] != 0 or not {kinds[1], kinds[2]} <= set(INTEGERS):
        return None
    if kinds[3] < 12 or kinds[3] % 2:
        return None
    topic, at = _integer(record, at, kinds[1])
    stamp, at = _integer(record, at, kinds[2])
    return topic, stamp, record[at : at + (kinds[3] - 12) // 2]


def _integer(record: bytes, at: int, kind: int) -> tuple[int, int]:
    """Return an integer of a serial type, and its end."""
    end = at + INTEGERS[kind]
    return (kind - 8 if kind > 7 else int.from_bytes(record[at:end], "big", signed=True)), end


def _varint(data: mmap.mmap | bytes, at: int) -> tuple[int, int]:
    """Return a number of 1 to 9 bytes, and its end.

    Each byte holds 7 bits, the ninth 8.
    """
    value = 0
    for k in range(at, at + 8):
        value = value << 7 | data[k] & 127
        if data[k] < 128:
            return value, k + 1
    return value << 8 | data[at + 8], at + 9
