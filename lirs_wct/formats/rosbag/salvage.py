"""Salvage of cut-off bags: complete messages, written as a new bag."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator
from contextlib import suppress
from io import BytesIO
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Schema
from rosbags import rosbag1, rosbag2
from rosbags.rosbag2 import StoragePlugin
from rosbags.typesys import Stores, get_typestore

from lirs_wct.formats.rosbag.compression import decompress_chunk
from lirs_wct.formats.rosbag.ros1_records import MAGIC as ROS1
from lirs_wct.formats.rosbag.ros1_records import SalvagedMessage, Topic, index_of, ros1_messages

CUT = "its end is missing"
MCAP = b"\x89MCAP0\r\n"
FOOTER = 37
"""Bytes of an MCAP file's last record and the magic bytes after it."""


def fault_of(path: Path) -> str | None:
    """Return the fault of an MCAP file or a ROS 1 bag.

    The fault is "" for a missing index, and None for a sound file or no bag.
    """
    with path.open("rb") as file:
        begin, size = file.read(len(ROS1)), file.seek(0, 2)
        file.seek(max(0, size - FOOTER))
        end = file.read()
    if begin.startswith(MCAP):
        if not end.endswith(MCAP):
            return CUT
        return "" if not any(end[9:17]) else None
    if begin == ROS1:
        index = index_of(path)
        return CUT if index is not None and not 0 < index < size else None
    return None


def salvage_file(path: Path, target: Path) -> Path:
    """Write the complete messages of an MCAP file or ROS 1 bag as a bag, and return its file.

    Args:
        path: file of the bag.
        target: folder that is created.

    Raises:
        Exception: any exception of the parsers for damaged data.
    """
    if path.suffix == ".bag":
        target.mkdir()
        with rosbag1.Writer(target / path.name) as writer:
            _write_ros1(writer, ros1_messages(path))
        return target / path.name
    with rosbag2.Writer(target, version=8, storage_plugin=StoragePlugin.MCAP) as writer2:
        _write_ros2(writer2, mcap_messages(path))
    return target / f"{target.name}.mcap"


def mcap_messages(path: Path) -> Iterator[SalvagedMessage]:
    """Yield the messages of complete records, and of the rest of the last chunk."""
    schemas: dict[int, Schema] = {}
    topics: dict[int, Topic] = {}
    with path.open("rb") as file:
        file.seek(len(MCAP))
        for record in _mcap_records(ReadDataStream(file)):
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                schema = schemas.get(record.schema_id)
                kind, definition = (schema.name, schema.data.decode()) if schema else ("", "")
                topics[record.id] = Topic(record.topic, kind, definition)
            elif isinstance(record, Message) and record.channel_id in topics:
                yield SalvagedMessage(topics[record.channel_id], record.log_time, record.data)


def _mcap_records(stream: ReadDataStream) -> Iterator[Schema | Channel | Message]:
    """Yield the records of a stream and of its chunks; the package's reader drops incomplete chunks."""
    with suppress(EndOfFile, struct.error):
        while True:
            kind, length = stream.read1(), stream.read8()
            if kind == Opcode.CHUNK:
                chunk = Chunk.read(stream)
                data = decompress_chunk(chunk.data, chunk.compression)
                yield from _mcap_records(ReadDataStream(BytesIO(data)))
                continue
            body = stream.read(length)
            if len(body) < length:
                return
            content = ReadDataStream(BytesIO(body))
            if kind == Opcode.SCHEMA:
                yield Schema.read(content)
            elif kind == Opcode.CHANNEL:
                yield Channel.read(content)
            elif kind == Opcode.MESSAGE:
                yield Message.read(content, length)


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
