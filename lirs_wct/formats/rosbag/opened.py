"""Open bags: also split, compressed, without index, or cut off.

The files of a folder are opened one by one, without the metadata. A recorder writes these last and may die
before. Complete messages of a cut-off MCAP file are salvaged into a new bag.
"""

from __future__ import annotations

import re
import struct
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import cache, partial
from heapq import merge
from io import BytesIO
from operator import itemgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, NoReturn, TypeAlias

import yaml
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Schema
from rosbags import rosbag1, rosbag2
from rosbags.interfaces import Connection, MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag2 import StoragePlugin
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

from lirs_wct.errors import SourceError
from lirs_wct.formats.rosbag.compression import decompress_chunk, decompress_file, decompress_message
from lirs_wct.formats.rosbag.storage import METADATA
from lirs_wct.formats.suffixes import BAGS, ZSTD, is_bag_file

Reader: TypeAlias = rosbag1.Reader | rosbag2.Reader
IDL_SEPARATOR = "=" * 80 + "\n"
"""Separator between the definitions of a type and of its parts."""
IDL_TITLE = re.compile(r"\AIDL: .*\n")
VERSION_LENGTH = 40
"""Bytes at the start of a ROS 1 bag within which its version ends."""


class Bag:
    """An open bag.

    Attributes:
        path: of the bag, as the user gave it.
        kinds: type of each topic.
        faults: damaged or missing parts; reading messages may add some.
        undecoded: count of messages that could not be decoded, by topic.
    """

    def __init__(self, path: Path, readers: Sequence[Reader], faults: list[str]) -> None:
        self.path, self.faults = path, faults
        self._readers = readers
        types: dict[str, set[str]] = {}
        for connection in (c for reader in readers for c in reader.connections):
            types.setdefault(connection.topic, set()).add(connection.msgtype)
        self.kinds = {topic: kinds.pop() if len(kinds) == 1 else "" for topic, kinds in types.items()}
        self.undecoded: Counter[str] = Counter()

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, Any]]:
        """Yield topic, receive time in nanoseconds, and message, up to the first damage.

        Only the types of these topics are parsed, so that other malformed types do no harm.
        """
        messages = merge(*(_of_topics(reader, topics) for reader in self._readers), key=itemgetter(1))
        while True:
            # Parsers raise any kind of exception for damaged binary data.
            try:
                connection, received, data = next(messages)
            except StopIteration:
                return
            except Exception as error:
                if (reason := _reason(error)) not in self.faults:
                    self.faults.append(reason)
                return
            try:
                message = _decoder(connection.msgdef, connection.msgtype, self._ros1)(
                    decompress_message(data)
                )
            except Exception:
                self.undecoded[connection.topic] += 1
                continue
            yield connection.topic, received, message

    @property
    def _ros1(self) -> bool:
        return isinstance(self._readers[0], rosbag1.Reader)


def _of_topics(reader: Reader, topics: Collection[str]) -> Iterator[tuple[Connection, int, bytes]]:
    """Yield a file's messages on topics; the library treats an empty selection as all."""
    chosen = [c for c in reader.connections if c.topic in topics]
    return reader.messages(chosen) if chosen else iter(())


@cache
def _decoder(definition: MessageDefinition, kind: str, ros1: bool) -> Callable[[bytes | memoryview], Any]:
    """Return the decoder of a type by the bag's definition, else by Jazzy's.

    The definition states the layout of the bytes, also where the recorded hash of the type differs. The
    decoder of a definition that cannot be parsed refuses every message.
    """
    try:
        store = get_typestore(Stores.EMPTY if definition.data else Stores.ROS2_JAZZY)
        if definition.format == MessageDefinitionFormat.MSG:
            store.register(get_types_from_msg(definition.data, kind))
        elif definition.format == MessageDefinitionFormat.IDL:
            for part in filter(None, definition.data.split(IDL_SEPARATOR)):
                store.register(get_types_from_idl(IDL_TITLE.sub("", part)))
    except Exception as error:
        return partial(_refuse, error)
    decode = store.deserialize_ros1 if ros1 else store.deserialize_cdr
    return partial(decode, typename=kind)


def _refuse(error: Exception, data: bytes | memoryview) -> NoReturn:
    raise error


@contextmanager
def open_bag(path: Path) -> Iterator[Bag]:
    """Open a bag: a folder or file of ROS 2, or a ROS 1 bag.

    Raises:
        SourceError: no part of it can be read.
    """
    faults = _missing(path)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(TemporaryDirectory(prefix="lirs-wct-")))
        try:
            files = [_readable(file, folder / str(k), faults) for k, file in enumerate(_files(path))]
            readers = [stack.enter_context(_reader(file)) for file in files]
        except Exception as error:
            said = "; ".join([*faults, _reason(error)])
            raise SourceError(f"{path}: not a bag that can be read: {said}") from error
        yield Bag(path, readers, faults)


def _reader(file: Path) -> Reader:
    """Return the library's reader of a file.

    Raises:
        ValueError: the file is of another version of ROS 1's format.
    """
    if file.suffix != ".bag":
        return rosbag2.Reader(file)
    with file.open("rb") as begin:
        version = begin.readline(VERSION_LENGTH).strip()
    if version.startswith(b"#ROS") and version != MAGIC.strip():
        raise ValueError(f"its format is {version.decode('latin-1')!r}, legal is {MAGIC.decode().strip()!r}")
    return rosbag1.Reader(file)


def _files(path: Path) -> list[Path]:
    """Return the files of a bag; of two kinds in a folder, the first."""
    if not path.is_dir():
        return [path]
    # A compressed file and its decompressed copy count once.
    found = {p.name.removesuffix(ZSTD): p for p in sorted(path.iterdir(), reverse=True) if is_bag_file(p)}
    kinds = ([found[name] for name in sorted(found) if name.endswith(suffix)] for suffix in BAGS)
    return next(files for files in kinds if files)


def _readable(file: Path, folder: Path, faults: list[str]) -> Path:
    """Return a readable file: the file itself, or its repaired copy in a folder."""
    folder.mkdir()
    if file.name.endswith(ZSTD):
        whole, file = file, folder / file.name.removesuffix(ZSTD)
        fault = decompress_file(whole, file)
        faults += [f"{whole.name}: {fault}"] if fault else []
    broken = fault_of(file)
    if broken is None:
        return file
    faults += [f"{file.name}: {broken}"] if broken else []
    return salvage_file(file, folder / "salvaged")


def _missing(path: Path) -> list[str]:
    """Return faults for files in the metadata that are missing from the folder."""
    try:
        held = yaml.safe_load((path / METADATA).read_text(encoding="utf-8"))
        names = [Path(str(p)).name for p in held["rosbag2_bagfile_information"]["relative_file_paths"]]
    except (OSError, ValueError, LookupError, TypeError, yaml.YAMLError):
        return []
    return [f"{name} is missing" for name in names if not (path / name).exists()]


def _reason(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


MAGIC = b"#ROSBAG V2.0\n"
INDEX = b"index_pos="
"""Field of a bag's first record: position of the index, 0 = unwritten."""


class Topic(NamedTuple):
    """A topic: name, type, and the type's definition (empty = unknown)."""

    name: str
    kind: str
    definition: str = ""


class SalvagedMessage(NamedTuple):
    """A message: topic, time of recording in nanoseconds, and bytes."""

    topic: Topic
    stamp: int
    data: bytes


CUT = "its end is missing"
MCAP = b"\x89MCAP0\r\n"
_HEAD = 4096
"""Bytes of a ROS 1 bag that hold its first record."""
FOOTER = 37
"""Bytes of an MCAP file's last record and the magic bytes after it."""


def fault_of(path: Path) -> str | None:
    """Return the fault of an MCAP file: "" for a missing index, None without one.

    Raises:
        ValueError: a ROS 1 bag without index.
    """
    with path.open("rb") as file:
        begin, size = file.read(len(MAGIC)), file.seek(0, 2)
        file.seek(max(0, size - FOOTER))
        end = file.read()
    if begin.startswith(MCAP):
        if not end.endswith(MCAP):
            return CUT
        return "" if not any(end[9:17]) else None
    if begin == MAGIC:
        with path.open("rb") as file:
            _, found, rest = file.read(_HEAD).partition(INDEX)
        if found and not 0 < int.from_bytes(rest[:8], "little") < size:
            raise ValueError(f"{path.name}: {CUT}; rosbag reindex {path.name} makes it readable")
    return None


def salvage_file(path: Path, target: Path) -> Path:
    """Write the complete messages of an MCAP file as a bag, and return its file.

    Args:
        path: file of the bag.
        target: folder that is created.

    Raises:
        Exception: any exception of the parsers for damaged data.
    """
    with rosbag2.Writer(target, version=8, storage_plugin=StoragePlugin.MCAP) as writer:
        _write_ros2(writer, mcap_messages(path))
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
