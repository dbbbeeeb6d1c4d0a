"""An MCAP file of ROS 1 or 2, also without index or end."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import IO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader
from mcap.summary import Summary
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat
from rosbags.typesys.msg import normalize_msgtype

from lirs_wct.formats.rosbag.compression import decompress_start

MAGIC = b"\x89MCAP0\r\n"
"""First and last bytes of a whole file."""
FORMATS = {
    "ros1msg": MessageDefinitionFormat.MSG,
    "ros2msg": MessageDefinitionFormat.MSG,
    "ros2idl": MessageDefinitionFormat.IDL,
    "omgidl": MessageDefinitionFormat.IDL,
}
"""Formats of message definitions by the encoding of a schema."""


class McapFile:
    """An MCAP file.

    Attributes:
        fault: Missing end in words; empty for a whole file.
        connections: Topics with their types.
        message_count: Number of messages by the index; None without one.
    """

    def __init__(self, path: Path) -> None:
        """Read the topics, from the index if there is one.

        Raises:
            ValueError: not an MCAP file.
        """
        self._path = path
        with path.open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                raise ValueError(f"{path.name}: not an MCAP file")
            file.seek(max(0, file.seek(0, 2) - len(MAGIC)))
            whole = file.read() == MAGIC
            file.seek(0)
            summary = None
            with suppress(Exception):  # a damaged index
                summary = make_reader(file).get_summary() if whole else None
        self.fault = "" if whole else "its end is missing"
        statistics = summary and summary.statistics
        self.message_count = statistics.message_count if statistics else None
        if summary is None or (not summary.channels and self.message_count != 0):
            summary = Summary()
            with suppress(Exception):  # damage is reported with the messages before it
                for record in self._records():
                    if isinstance(record, Schema):
                        summary.schemas[record.id] = record
                    elif isinstance(record, Channel):
                        summary.channels[record.id] = record
        self._connections = {
            channel.id: _connection(channel, summary.schemas.get(channel.schema_id))
            for channel in summary.channels.values()
        }

    @property
    def connections(self) -> list[Connection]:
        """Topics with their types."""
        return list(self._connections.values())

    def messages(self, connections: Collection[Connection]) -> Iterator[tuple[Connection, int, bytes]]:
        """Yield connection, time of recording in nanoseconds, and bytes of each message on some topics.

        Raises:
            Exception: any exception of the parser at the first damage of a file with an end.
        """
        chosen = {id(connection) for connection in connections}
        for record in self._records():
            if isinstance(record, Message):
                connection = self._connections.get(record.channel_id)
                if connection is not None and id(connection) in chosen:
                    yield connection, record.log_time, record.data

    def _records(self) -> Iterator[McapRecord]:
        """Yield the records; of a file without end, those before it."""
        with self._path.open("rb") as file:
            begin = 0
            try:
                for record in StreamReader(file, validate_crcs=True).records:
                    begin = file.tell()
                    yield record
                return
            except Exception:  # the parsers raise any kind for damaged data
                if not self.fault:
                    raise
            yield from _cut_chunk(file, begin)


def _cut_chunk(file: IO[bytes], begin: int) -> Iterator[McapRecord]:
    """Yield the records of a file's last, incomplete chunk, which the library leaves out."""
    file.seek(begin)
    stream = ReadDataStream(file)
    with suppress(Exception):
        if stream.read1() == Opcode.CHUNK:
            stream.read8()
            chunk = Chunk.read(stream)
            data = decompress_start(chunk.data, chunk.compression)
            yield from StreamReader(BytesIO(data), skip_magic=True).records


def _connection(channel: Channel, schema: Schema | None) -> Connection:
    """Return the description of a topic as that of the other kinds of bags."""
    kind = schema.name if schema else ""
    if channel.message_encoding == "ros1" and kind:
        kind = normalize_msgtype(kind)
    definition = MessageDefinition(MessageDefinitionFormat.NONE, "")
    if schema and schema.encoding in FORMATS:
        definition = MessageDefinition(FORMATS[schema.encoding], schema.data.decode())
    encoding = ConnectionExtRosbag2(channel.message_encoding, [])
    return Connection(channel.id, channel.topic, kind, definition, "", 0, encoding, None)
