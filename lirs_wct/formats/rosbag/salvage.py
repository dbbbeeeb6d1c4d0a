"""Files of bags that have no index, or whose recorder died: their whole messages, in a whole bag."""

from __future__ import annotations

import shutil
import sqlite3
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from rosbags import rosbag1, rosbag2
from rosbags.rosbag2 import StoragePlugin
from rosbags.typesys import Stores, get_typestore

from lirs_wct.formats.rosbag.compression import inflated
from lirs_wct.formats.rosbag.salvage_ros1 import index_of, ros1_messages
from lirs_wct.formats.rosbag.salvaged_message import SalvagedMessage, Topic

MAGIC = b"\x89MCAP0\r\n"
FOOTER = 37
"""Bytes of an MCAP file's last record and the magic behind it."""
SCHEMA, CHANNEL, MESSAGE, CHUNK = 3, 4, 5, 6
CUT = "its end is missing"


def fault_of(path: Path) -> str | None:
    """Return why a file cannot be read as it is; "" = it has no index, None = it can, or is no bag at all."""
    with path.open("rb") as file:
        begin, size = file.read(100), file.seek(0, 2)
        file.seek(max(0, size - FOOTER))
        end = file.read()
    if begin.startswith(MAGIC):
        if not end.endswith(MAGIC):
            return CUT
        return "" if not any(end[9:17]) else None
    if begin.startswith(b"SQLite format 3\0") and len(begin) == 100:
        return CUT if _database_size(begin) > size else None
    if begin.startswith(b"#ROSBAG V2.0\n"):
        index = index_of(path)
        return CUT if index is not None and not 0 < index < size else None
    return None


def salvaged(path: Path, target: Path) -> Path:
    """Write the whole messages of a file as a bag, and return its file.

    Args:
        path: of an MCAP file, a database or a ROS 1 bag.
        target: folder that is made.

    Raises:
        Exception: of the parsers, whatever damaged data lead to.
    """
    if path.suffix == ".bag":
        target.mkdir()
        with rosbag1.Writer(target / path.name) as writer:
            _write_ros1(writer, ros1_messages(path))
        return target / path.name
    if path.suffix == ".mcap":
        messages = _mcap_messages(path)
    else:
        messages = _database_messages(_padded(path, target.with_suffix(".db3")))
    with rosbag2.Writer(target, version=8, storage_plugin=StoragePlugin.MCAP) as writer2:
        _write_ros2(writer2, messages)
    return target / f"{target.name}.mcap"


def _write_ros2(writer: rosbag2.Writer, messages: Iterable[SalvagedMessage]) -> None:
    store, connections = get_typestore(Stores.ROS2_JAZZY), {}
    for topic, stamp, data in messages:
        if topic not in connections:
            definition = topic.definition or store.generate_msgdef(topic.kind, ros_version=2)[0]
            connections[topic] = writer.add_connection(
                topic.name, topic.kind, msgdef=definition, rihs01="unknown"
            )
        writer.write(connections[topic], stamp, data)


def _write_ros1(writer: rosbag1.Writer, messages: Iterable[SalvagedMessage]) -> None:
    connections = {}
    for topic, stamp, data in messages:
        if topic not in connections:
            connections[topic] = writer.add_connection(
                topic.name, topic.kind, msgdef=topic.definition, md5sum=topic.digest
            )
        writer.write(connections[topic], stamp, data)


@dataclass
class _Names:
    """What the records of an MCAP file have said so far."""

    schemas: dict[int, tuple[str, str]]
    channels: dict[int, Topic]


def _mcap_messages(path: Path) -> Iterator[SalvagedMessage]:
    """Yield the messages of an MCAP file's whole records, and of what is left of its last chunk."""
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
            yield from _messages_of(BytesIO(inflated(body[40 + n :], compression)), names)
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


def _database_size(begin: bytes) -> int:
    """Return how many bytes a database has by its header: size and number of its pages."""
    page, pages = struct.unpack(">16xH10xI", begin[:32])
    return int(pages * (65536 if page == 1 else page))


def _padded(path: Path, target: Path) -> Path:
    """Copy a database that is cut off, filled up with zeros to the size that it must have to be opened."""
    shutil.copyfile(path, target)
    with target.open("r+b") as file:
        file.truncate(_database_size(file.read(100)))
    return target


def _database_messages(path: Path) -> Iterator[SalvagedMessage]:
    """Yield the messages of a database in the order in which they were written, up to where it is damaged."""
    connection = sqlite3.connect(f"file:{path}?mode=ro&immutable=1", uri=True)
    try:
        topics = {
            number: Topic(name, kind, "")
            for number, name, kind in connection.execute("SELECT id, name, type FROM topics")
        }
        last = 0
        while True:
            row = _next_row(connection, last)
            if row is None or row[0] <= last:  # pages of zeros may lead back
                return
            last, number, stamp, data = row
            if number in topics:
                yield SalvagedMessage(topics[number], stamp, data)
    finally:
        connection.close()


def _next_row(connection: sqlite3.Connection, last: int) -> tuple[int, int, int, bytes] | None:
    """Return the row behind one; None where there is none, or it cannot be read."""
    text = "SELECT id, topic_id, timestamp, data FROM messages WHERE id > ? ORDER BY id LIMIT 1"
    try:
        found: tuple[int, int, int, bytes] | None = connection.execute(text, (last,)).fetchone()
    except sqlite3.DatabaseError:
        return None
    return found
