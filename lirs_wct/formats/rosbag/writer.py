"""Writing a drive as a ROS 2 bag: sensors, frames, truth and map.

Stamps are simulated time. Chunks are closed at 1 MiB *after* the message that fills them, so that a chunk
holds every message whole, a large map too.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from rosbags.interfaces import (
    Connection,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from lirs_wct.errors import OutputError
from lirs_wct.files import atomic_folder
from lirs_wct.formats import Storage
from lirs_wct.formats.rosbag import messages, topics
from lirs_wct.formats.rosbag.messages import BagDrive, BagTick, SensorErrors
from lirs_wct.geometry import OccupancyGrid

VERSION: Final = 8
"""Version of `metadata.yaml`: the latest whose quality of service Humble reads (text with numbers)."""
BUFFERED_SCANS = 64
"""Number of scans that are written together."""


class BagWriter:
    """Incremental writer of a bag, with the time from scan to scan in seconds.

    It buffers scans: written one by one between steps of a simulation, messages take three times as long.
    """

    def __init__(
        self, folder: Path, storage: Storage, period: float, errors: SensorErrors = messages.NO_ERRORS
    ) -> None:
        plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
        self._folder = folder
        self._writer = Writer(folder, version=VERSION, storage_plugin=plugin)
        self._store = get_typestore(Stores.ROS2_JAZZY)
        self._messages = messages.TickMessages(period, errors)
        self._connections: dict[str, Connection] = {}
        self._last: BagTick | None = None
        self._waiting: list[BagTick] = []
        with self._output_errors():
            self._writer.open()

    def add(self, tick: BagTick) -> None:
        """Add the messages of a scan; they are buffered before writing."""
        self._waiting.append(tick)
        if len(self._waiting) == BUFFERED_SCANS:
            with self._output_errors():
                self._write_waiting()

    def close(self, grid: OccupancyGrid | None = None) -> None:
        """Write the buffered scans, the map in the map frame, and the bag's end."""
        with self._output_errors():
            self._write_waiting()
            if grid is not None and self._last is not None:
                stamp = self._last.scan.stamp
                self._write(topics.MAP_TOPIC, stamp, messages.occupancy_grid(stamp, grid))
            self._writer.close()

    def abort(self) -> None:
        """Close the files of an unfinished bag without writing its end."""
        self._writer.abort()

    def _write_waiting(self) -> None:
        for tick in self._waiting:
            for topic, stamp, message in self._messages.of(tick):
                self._write(topic, stamp, message)
            self._last = tick
        self._waiting.clear()

    def _write(self, topic: str, stamp: float, message: bytearray) -> None:
        if topic not in self._connections:
            latched, never = topic in topics.LATCHED, QosTime(0, 0)
            quality = Qos(
                QosHistory.KEEP_LAST,
                1 if latched else 10,
                QosReliability.RELIABLE,
                QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE,
                never,
                never,
                QosLiveliness.AUTOMATIC,
                never,
                False,
            )
            self._connections[topic] = self._writer.add_connection(
                topic, topics.TOPICS[topic], typestore=self._store, offered_qos_profiles=[quality]
            )
        self._writer.write(self._connections[topic], messages.nanoseconds(stamp), memoryview(message))

    @contextmanager
    def _output_errors(self) -> Iterator[None]:
        try:
            yield
        except (OSError, sqlite3.Error) as error:
            reason = getattr(error, "strerror", None) or error
            raise OutputError(f"{self._folder}: cannot be written: {reason}") from error


def write_bag(folder: Path, drive: BagDrive, storage: Storage = "mcap") -> None:
    """Write a drive as a bag folder, replacing an older one."""
    with atomic_folder(folder) as temporary:
        inner = temporary / folder.name  # the library names the file after the folder, which it creates
        bag = BagWriter(inner, storage, drive.period, drive.errors)
        try:
            for tick in drive.ticks:
                bag.add(tick)
            bag.close(drive.grid)
        finally:
            bag.abort()
        for file in inner.iterdir():
            file.rename(temporary / file.name)
        inner.rmdir()
