"""The records of a ROS 1 bag, read without its index (http://wiki.ros.org/Bags/Format/2.0)."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

from lirs_wct.formats.rosbag.compression import decompress_chunk

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, HEADER, CHUNK, CONNECTION = 2, 3, 5, 7
"""Kinds of records, their field `op`."""
Fields = dict[str, bytes]


class Topic(NamedTuple):
    """A topic: name, type, and the type's definition and digest (empty = unknown)."""

    name: str
    kind: str
    definition: str = ""
    digest: str = ""


class SalvagedMessage(NamedTuple):
    """A message: topic, time of recording in nanoseconds, and bytes."""

    topic: Topic
    stamp: int
    data: bytes


def index_of(path: Path) -> int | None:
    """Return the position of a bag's index (0 = unwritten); None without entry."""
    with path.open("rb") as file:
        file.seek(len(MAGIC))
        fields, _ = next(_records(file), ({}, b""))
    found = fields.get("index_pos", b"")
    return int.from_bytes(found, "little") if len(found) == 8 else None


def ros1_messages(path: Path) -> Iterator[SalvagedMessage]:
    """Yield the messages of complete records, and of the rest of the last chunk."""
    with path.open("rb") as file:
        file.seek(len(MAGIC))
        yield from _messages_of(file, {})


def _messages_of(stream: BinaryIO, topics: dict[bytes, Topic]) -> Iterator[SalvagedMessage]:
    for fields, data in _records(stream):
        kind = int.from_bytes(fields.get("op", b"\0"), "little")
        if kind == CHUNK:
            compression = fields.get("compression", b"none").decode()
            yield from _messages_of(BytesIO(decompress_chunk(data, compression)), topics)
        elif kind == CONNECTION:
            topics.setdefault(fields["conn"], _topic(fields["topic"].decode(), data))
        elif kind == MESSAGE and fields.get("conn") in topics:
            seconds, rest = struct.unpack("<II", fields["time"])
            yield SalvagedMessage(topics[fields["conn"]], seconds * 1_000_000_000 + rest, data)


def _topic(name: str, data: bytes) -> Topic:
    held = _fields(data)
    package, _, kind = held["type"].decode().partition("/")
    return Topic(name, f"{package}/msg/{kind}", held["message_definition"].decode(), held["md5sum"].decode())


def _records(stream: BinaryIO) -> Iterator[tuple[Fields, bytes]]:
    """Yield fields and data of the records; also of a cut-off last chunk."""
    while True:
        header = _read_sized(stream)
        if header is None:
            return
        fields = _fields(header)
        length = stream.read(4)
        if len(length) < 4:
            return
        data = stream.read(int.from_bytes(length, "little"))
        whole = len(data) == int.from_bytes(length, "little")
        if whole or fields.get("op") == bytes([CHUNK]):
            yield fields, data
        if not whole:
            return


def _read_sized(stream: BinaryIO) -> bytes | None:
    """Read a length and that many bytes; None if some are missing."""
    length = stream.read(4)
    if len(length) < 4:
        return None
    data = stream.read(int.from_bytes(length, "little"))
    return data if len(data) == int.from_bytes(length, "little") else None


def _fields(header: bytes) -> Fields:
    stream, fields = BytesIO(header), Fields()
    while (field := _read_sized(stream)) is not None:
        name, _, value = field.partition(b"=")
        fields[name.decode()] = value
    return fields
