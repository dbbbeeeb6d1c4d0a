"""Messages of an MCAP file that is cut off or has no index."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from lirs_wct.formats.rosbag.compression import decompress_chunk
from lirs_wct.formats.rosbag.salvage.message import SalvagedMessage, Topic

MAGIC = b"\x89MCAP0\r\n"
FOOTER = 37
"""Bytes of an MCAP file's last record and the magic bytes after it."""
SCHEMA, CHANNEL, MESSAGE, CHUNK = 3, 4, 5, 6


@dataclass
class _Names:
    """Schemas and channels of the MCAP records read so far."""

    schemas: dict[int, tuple[str, str]]
    channels: dict[int, Topic]


def mcap_messages(path: Path) -> Iterator[SalvagedMessage]:
    """Yield the messages of complete records, and of the rest of the last chunk."""
    with path.open("rb") as file:
        file.seek(len(MAGIC))
        yield from _messages_of(file, _Names({}, {}))


def _messages_of(stream: BinaryIO, names: _Names) -> Iterator[SalvagedMessage]:
    while len(head := stream.read(9)) == 9:
        kind, length = struct.unpack("<BQ", head)
        body = stream.read(length)
        if kind == CHUNK and len(body) > 40:
            (n,) = struct.unpack_from("<I", body, 28)
            compression = body[32 : 32 + n].decode()
            yield from _messages_of(BytesIO(decompress_chunk(body[40 + n :], compression)), names)
        elif len(body) < length:
            return
        elif kind == SCHEMA:
            (number,) = struct.unpack_from("<H", body)
            name, _, definition = _strings(body, 2, 3)
            names.schemas[number] = name, definition
        elif kind == CHANNEL:
            number, schema = struct.unpack_from("<HH", body)
            kind_name, definition = names.schemas.get(schema, ("", ""))
            (topic,) = _strings(body, 4, 1)
            names.channels[number] = Topic(topic, kind_name, definition)
        elif kind == MESSAGE:
            number, _, stamp = struct.unpack_from("<HIQ", body)
            if number in names.channels:
                yield SalvagedMessage(names.channels[number], stamp, body[22:])


def _strings(body: bytes, at: int, count: int) -> list[str]:
    found = []
    for _ in range(count):
        (n,) = struct.unpack_from("<I", body, at)
        found.append(body[at + 4 : at + 4 + n].decode())
        at += 4 + n
    return found
