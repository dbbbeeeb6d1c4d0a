"""Salvage of cut-off files of bags: complete messages, written as a new bag."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from rosbags import rosbag1, rosbag2
from rosbags.rosbag2 import StoragePlugin
from rosbags.typesys import Stores, get_typestore

from lirs_wct.formats.rosbag.salvage.mcap import FOOTER, MAGIC, mcap_messages
from lirs_wct.formats.rosbag.salvage.message import SalvagedMessage
from lirs_wct.formats.rosbag.salvage.ros1 import index_of, ros1_messages
from lirs_wct.formats.rosbag.salvage.sqlite import HEADER, database_messages, database_size
from lirs_wct.formats.rosbag.salvage.sqlite import MAGIC as SQLITE

CUT = "its end is missing"


def fault_of(path: Path) -> str | None:
    """Return the fault of a bag's file.

    The fault is "" for a missing index, and None for a sound file or no bag.
    """
    with path.open("rb") as file:
        begin, size = file.read(HEADER), file.seek(0, 2)
        file.seek(max(0, size - FOOTER))
        end = file.read()
    if begin.startswith(MAGIC):
        if not end.endswith(MAGIC):
            return CUT
        return "" if not any(end[9:17]) else None
    if begin.startswith(SQLITE) and len(begin) == HEADER:
        return CUT if database_size(begin) > size else None
    if begin.startswith(b"#ROSBAG V2.0\n"):
        index = index_of(path)
        return CUT if index is not None and not 0 < index < size else None
    return None


def salvage_file(path: Path, target: Path) -> Path:
    """Write the complete messages of a file as a bag, and return its file.

    Args:
        path: of an MCAP file, a database or a ROS 1 bag.
        target: folder that is created.

    Raises:
        Exception: any exception of the parsers for damaged data.
    """
    if path.suffix == ".bag":
        target.mkdir()
        with rosbag1.Writer(target / path.name) as writer:
            _write_ros1(writer, ros1_messages(path))
        return target / path.name
    if path.suffix == ".mcap":
        messages = mcap_messages(path)
    else:
        messages = database_messages(path, target.with_suffix(".db3"))
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
