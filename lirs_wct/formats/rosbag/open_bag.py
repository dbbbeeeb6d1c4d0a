"""Open bags: also split, compressed, without index, or cut off.

The files of a folder are opened one by one, without the metadata. A recorder writes these last and may die
before.
"""

from __future__ import annotations

import re
import shutil
import sqlite3
import sys
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from functools import cache, partial
from heapq import merge
from operator import itemgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias

import yaml
from mcap.reader import make_reader
from mcap.records import Channel, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader
from mcap.summary import Summary
from rosbags import rosbag1, rosbag2
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.msg import normalize_msgtype

from lirs_wct.errors import SourceError, reason_of
from lirs_wct.formats import BAGS, METADATA, ZSTD

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

MCAP_MAGIC = b"\x89MCAP0\r\n"
"""First and last bytes of a whole file."""
FORMATS = {
    "ros1msg": MessageDefinitionFormat.MSG,
    "ros2msg": MessageDefinitionFormat.MSG,
    "ros2idl": MessageDefinitionFormat.IDL,
    "omgidl": MessageDefinitionFormat.IDL,
}
"""Formats of message definitions by the encoding of a schema."""


class McapFile:
    """An MCAP file of ROS 1 or 2, also without index; one without end is read up to its last whole chunk.

    Attributes:
        fault: Missing end in words; empty for a whole file.
        message_count: Number of messages by the index; None without one.
        connections: Topics with their types.
    """

    def __init__(self, path: Path) -> None:
        """Read the topics, from the index if there is one."""
        self._path = path
        with path.open("rb") as file:
            if file.read(len(MCAP_MAGIC)) != MCAP_MAGIC:
                raise ValueError(f"{path.name}: not an MCAP file")
            file.seek(max(0, file.seek(0, 2) - len(MCAP_MAGIC)))
            whole = file.read() == MCAP_MAGIC
            summary = None
            with suppress(Exception):  # a damaged index
                file.seek(0)
                summary = make_reader(file).get_summary() if whole else None
        self.fault = "" if whole else "its end is missing; mcap recover makes a whole file of it"
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
        self.connections = [
            _connection(channel, summary.schemas.get(channel.schema_id))
            for channel in summary.channels.values()
        ]

    def messages(self, connections: Collection[Connection]) -> Iterator[tuple[Connection, int, bytes]]:
        """Yield connection, time of recording in nanoseconds, and bytes of each message on some topics."""
        chosen = {connection.id: connection for connection in connections}
        for record in self._records():
            if isinstance(record, Message) and record.channel_id in chosen:
                yield chosen[record.channel_id], record.log_time, record.data

    def _records(self) -> Iterator[McapRecord]:
        """Yield the records; of a file without end, those before it."""
        with self._path.open("rb") as file:
            try:
                yield from StreamReader(file, validate_crcs=True).records
            except Exception:  # the parsers raise any kind for damaged data
                if not self.fault:
                    raise


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


Reader: TypeAlias = rosbag1.Reader | rosbag2.Reader | McapFile
IDL_SEPARATOR = "=" * 80 + "\n"
"""Separator between the definitions of a type and of its parts."""
IDL_TITLE = re.compile(r"\AIDL: .*\n")
ROS1_MAGIC = b"#ROSBAG V2.0\n"
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
"""First bytes of zstd data; no message in CDR begins with them."""
INDEX = b"index_pos="
"""Field of a ROS 1 bag's first record: position of the index, 0 = unwritten."""
HEAD = 4096
"""Bytes of a ROS 1 bag that hold its first record."""
PART = re.compile(r"(_?\d{4}(-\d\d){5})?_\d+\.\w+$|\.\w+$")
"""End of the name of a bag's part: number, and the date that `rosbag record --split` adds."""


class Bag:
    """An open bag.

    Attributes:
        kinds: Type of each topic.
        faults: Damaged or missing parts; reading messages may add some.
        undecoded: Count of messages that could not be decoded, by topic.
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
        chosen = [[c for c in reader.connections if c.topic in topics] for reader in self._readers]
        # The library treats an empty selection as all.
        parts = [reader.messages(own) for reader, own in zip(self._readers, chosen, strict=True) if own]
        messages = merge(*parts, key=itemgetter(1))
        while True:
            # Parsers raise any kind of exception for damaged binary data.
            try:
                connection, received, data = next(messages)
            except StopIteration:
                return
            except Exception as error:
                if (reason := reason_of(error)) not in self.faults:
                    self.faults.append(reason)
                return
            encoding = getattr(connection.ext, "serialization_format", "ros1")
            decode = _decoder(connection.msgdef, connection.msgtype, encoding == "ros1")
            try:
                is_packed = data[: len(ZSTD_MAGIC)] == ZSTD_MAGIC
                message = decode(zstd.decompress(data) if is_packed else data) if decode else None
            except Exception:
                message = None
            if message is None:
                self.undecoded[connection.topic] += 1
            else:
                yield connection.topic, received, message


@cache
def _decoder(
    definition: MessageDefinition, kind: str, ros1: bool
) -> Callable[[bytes | memoryview], Any] | None:
    """Return the decoder of a type by the bag's definition, else by Jazzy's; None for a damaged one."""
    try:
        store = get_typestore(Stores.EMPTY if definition.data else Stores.ROS2_JAZZY)
        if definition.format == MessageDefinitionFormat.MSG:
            store.register(get_types_from_msg(definition.data, kind))
        elif definition.format == MessageDefinitionFormat.IDL:
            for part in filter(None, definition.data.split(IDL_SEPARATOR)):
                store.register(get_types_from_idl(IDL_TITLE.sub("", part)))
    except Exception:
        return None
    decode = store.deserialize_ros1 if ros1 else store.deserialize_cdr
    return partial(decode, typename=kind)


@contextmanager
def open_bag(path: Path) -> Iterator[Bag]:
    """Open a bag: a folder or file of ROS 2, or a ROS 1 bag."""
    if not path.exists():
        raise SourceError(f"{path}: no such file or folder")
    stated = _metadata(path)
    names = [Path(str(name)).name for name in stated.get("relative_file_paths") or ()]
    faults = [f"{name} is missing" for name in names if not (path / name).exists()]
    with ExitStack() as stack:
        folder = Path(stack.enter_context(TemporaryDirectory(prefix="lirs-wct-")))
        readers = []
        for k, file in enumerate(_files(path, names)):
            try:
                readers.append(_open(_readable(file, folder / str(k), faults), stack, faults))
            except Exception as error:  # the libraries raise any kind for damaged data
                faults.append(
                    reason_of(error) if file.name in str(error) else f"{file.name}: {reason_of(error)}"
                )
        if not readers:
            raise SourceError(f"{path}: not a bag that can be read: {'; '.join(faults)}")
        counts = [reader.message_count for reader in readers if reader.message_count is not None]
        count = stated.get("message_count", sum(counts))
        if not faults and len(counts) == len(readers) and count != sum(counts):
            faults.append(f"{METADATA} states {count} messages, there are {sum(counts)}")
        yield Bag(path, readers, faults)


def _open(file: Path, stack: ExitStack, faults: list[str]) -> Reader:
    """Open a file of a bag until the stack's end; add its fault."""
    suffix = file.suffix.lower()
    if suffix == ".mcap":
        mcap = McapFile(file)
        faults += [f"{file.name}: {mcap.fault}"] if mcap.fault else []
        return mcap
    if suffix != ".bag":
        return stack.enter_context(rosbag2.Reader(file))
    with file.open("rb") as opened:
        head, size = opened.read(HEAD), opened.seek(0, 2)
    version, _, _ = head.partition(b"\n")
    if version.startswith(b"#ROS") and not head.startswith(ROS1_MAGIC):
        raise ValueError(
            f"its format is {version.decode('latin-1')!r}, legal is {ROS1_MAGIC.decode().strip()!r}"
        )
    _, mark, rest = head.partition(INDEX)
    if mark and not 0 < int.from_bytes(rest[:8], "little") < size:
        raise ValueError(f"{file.name}: its end is missing; rosbag reindex {file.name} makes it readable")
    return stack.enter_context(rosbag1.Reader(file))


def _files(path: Path, names: Sequence[str]) -> list[Path]:
    """Return the files of a bag: those that its metadata names, else those of one kind."""
    if not path.is_dir():
        return [path]
    # A compressed file and its decompressed copy count once.
    by_name = {p.name.removesuffix(ZSTD): p for p in sorted(path.iterdir(), reverse=True)}
    by_name = {name: p for name, p in by_name.items() if name.lower().endswith(BAGS)}
    stated = [by_name[name] for name in (name.removesuffix(ZSTD) for name in names) if name in by_name]
    if stated:
        return stated
    kinds = ([by_name[name] for name in sorted(by_name) if name.endswith(suffix)] for suffix in BAGS)
    files = next((files for files in kinds if files), [])
    if len({PART.sub("", file.name.removesuffix(ZSTD)) for file in files}) > 1:
        raise SourceError(f"{path}: several bags: give one of {', '.join(file.name for file in files)}")
    return files


def _readable(file: Path, folder: Path, faults: list[str]) -> Path:
    """Return a readable file: the file itself, or its copy in a folder."""
    folder.mkdir()
    if file.name.endswith(ZSTD):
        whole, file = file, folder / file.name.removesuffix(ZSTD)
        with zstd.open(whole) as packed, file.open("wb") as unpacked:
            try:
                shutil.copyfileobj(packed, unpacked)
            except (zstd.ZstdError, EOFError) as error:
                faults.append(f"{whole.name}: {error}")
    log = file.with_name(f"{file.name}-wal")
    if file.suffix.lower() == ".db3" and log.exists() and log.stat().st_size:
        # The library opens a database as it lies on the disk, without the messages of its write-ahead log.
        for part in (file, log):
            shutil.copyfile(part, folder / part.name)
        with closing(sqlite3.connect(folder / file.name)) as database:
            database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        return folder / file.name
    return file


def _metadata(path: Path) -> dict[str, Any]:
    """Return what the metadata of a folder states; empty without usable metadata."""
    try:
        stated = yaml.safe_load((path / METADATA).read_text(encoding="utf-8"))
        metadata = dict(stated["rosbag2_bagfile_information"])
        return metadata if isinstance(metadata.get("relative_file_paths", []), list) else {}
    except (OSError, ValueError, LookupError, TypeError, yaml.YAMLError):
        return {}
