"""Bags as recorders leave them: split, compressed, without index, cut off; what is there is read."""

import shutil
import sqlite3
import struct
import warnings
import zlib
from collections import Counter
from collections.abc import Iterable
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import mcap.writer
import numpy as np
import pytest
import yaml
from rosbags import rosbag1
from rosbags.convert.converter import convert
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from lirs_wct.errors import SourceError
from lirs_wct.formats.rosbag.messages import BagDrive
from lirs_wct.formats.rosbag.reader import read_bag
from lirs_wct.formats.rosbag.topics import Topics
from lirs_wct.formats.rosbag.writer import write_bag
from lirs_wct.sources.source import is_bag
from tests.lirs_wct.formats.rosbag import drives

SCANS = 300
IMU = Topics(imu="/imu")


@pytest.fixture(scope="module")
def given() -> BagDrive:
    return drives.drive(SCANS)


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize("mode", [CompressionMode.FILE, CompressionMode.MESSAGE, CompressionMode.STORAGE])
def test_what_zstd_compressed_is_read(
    bag: Path, given: BagDrive, tmp_path: Path, plugin: StoragePlugin, mode: CompressionMode
) -> None:
    if (plugin, mode) == (StoragePlugin.SQLITE3, CompressionMode.STORAGE):
        return  # databases have no chunks
    writer = Writer(tmp_path / "run", version=8, storage_plugin=plugin)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        drives.copy_bag(bag, writer)
    (file,) = (p for p in (tmp_path / "run").iterdir() if p.suffix != ".yaml")
    for path in (tmp_path / "run", file):
        assert is_bag(path)
        drives.check(read_bag(path, IMU), given)


def write_mcap(
    path: Path, messages: Iterable[tuple[Connection, int, bytes]], *, ros: int, **options: Any
) -> None:
    with path.open("wb") as file:
        writer = mcap.writer.Writer(file, **options)
        writer.start(profile=f"ros{ros}")
        channels: dict[str, int] = {}
        for c, stamp, data in messages:
            if c.topic not in channels:
                kind = c.msgtype if ros == 2 else c.msgtype.replace("/msg/", "/")
                schema = writer.register_schema(kind, f"ros{ros}msg", c.msgdef.data.encode())
                encoding = "cdr" if ros == 2 else "ros1"
                channels[c.topic] = writer.register_channel(c.topic, encoding, schema)
            writer.add_message(channels[c.topic], stamp, bytes(data), stamp)
        writer.finish()


def test_chunks_of_lz4_are_read(bag: Path, given: BagDrive, tmp_path: Path) -> None:
    with AnyReader([bag]) as reader:
        write_mcap(
            tmp_path / "run.mcap", reader.messages(), ros=2, compression=mcap.writer.CompressionType.LZ4
        )
    drives.check(read_bag(tmp_path / "run.mcap", IMU), given)


@pytest.fixture(scope="module")
def ros1(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The bag in ROS 1's format."""
    path = tmp_path_factory.mktemp("ros1") / "whole.bag"
    convert([bag], path, "", 0, None, "none", None, get_typestore(Stores.ROS1_NOETIC), (), (), (), ())
    return path


def test_ros_1_is_read_from_a_bag_and_from_mcap(ros1: Path, given: BagDrive, tmp_path: Path) -> None:
    with rosbag1.Reader(ros1) as reader:
        write_mcap(tmp_path / "run.mcap", reader.messages(), ros=1)
    for path in (ros1, tmp_path / "run.mcap"):
        drives.check(read_bag(path, IMU), given)


def unindexed(bag: Path) -> bytes:
    """Return a bag's file without its summary, as the recorder's fast preset leaves it."""
    data = (bag / "run.mcap").read_bytes()
    (start,) = struct.unpack("<Q", data[-28:-20])
    end = data[:start]
    return end + b"\x02" + struct.pack("<QQQI", 20, 0, 0, 0) + data[-8:]


def test_a_file_without_index_is_whole(bag: Path, given: BagDrive, tmp_path: Path, recwarn: Any) -> None:
    (tmp_path / "run.mcap").write_bytes(unindexed(bag))
    drives.check(read_bag(tmp_path / "run.mcap", IMU), given)
    assert not recwarn.list


@pytest.mark.parametrize("share", [0.2, 0.5, 0.97])
def test_the_whole_chunks_before_a_crash_are_read(
    bag: Path, given: BagDrive, tmp_path: Path, share: float
) -> None:
    cut = tmp_path / "cut.mcap"
    with AnyReader([bag]) as reader:
        messages = (each for each in reader.messages() if each[0].topic != "/map")
        write_mcap(cut, messages, ros=2, chunk_size=1 << 15)
    data = cut.read_bytes()
    cut.write_bytes(data[: round(share * len(data))])
    with pytest.warns(UserWarning, match=r"damaged \(cut\.mcap: its end is missing; .*: \d+ scans"):
        log = read_bag(cut, IMU)
    assert len(log.scans) == pytest.approx(share * SCANS, abs=0.05 * SCANS)
    drives.check(log, given, len(log.scans))


def test_a_database_that_is_cut_is_refused(given: BagDrive, tmp_path: Path) -> None:
    write_bag(tmp_path / "whole", BagDrive(ticks=given.ticks), "sqlite3")
    data = (tmp_path / "whole" / "whole.db3").read_bytes()
    (tmp_path / "cut.db3").write_bytes(data[: round(0.9 * len(data))])
    with pytest.raises(SourceError, match=r"^\S*cut\.db3: .*malformed"):
        read_bag(tmp_path / "cut.db3", IMU)


@pytest.mark.parametrize("share", [0.2, 0.4, 0.9, 0.999])
def test_a_ros_1_bag_without_index_names_the_remedy(ros1: Path, tmp_path: Path, share: float) -> None:
    data = ros1.read_bytes()
    (tmp_path / "cut.bag").write_bytes(data[: round(share * len(data))])
    with pytest.raises(SourceError, match=r"^\S*cut\.bag: not a bag that can be read: .*") as refused:
        read_bag(tmp_path / "cut.bag", IMU)
    if share < 0.999:  # the index is behind the end; otherwise a part of it
        assert "rosbag reindex cut.bag makes it readable" in str(refused.value)


@pytest.fixture
def split(bag: Path, tmp_path: Path) -> Path:
    """A bag of three files, as `ros2 bag record --max-bag-size` splits them."""
    folder = tmp_path / "split"
    folder.mkdir()

    def of_part(scan: int, connection: Connection, data: bytes, part: int) -> bytes | None:
        return data if scan // 100 == part or connection.topic == "/tf_static" else None

    for k in range(3):
        with Writer(tmp_path / f"part{k}", version=8, storage_plugin=StoragePlugin.MCAP) as writer:
            drives.copy_bag(bag, writer, partial(of_part, part=k))
        shutil.move(tmp_path / f"part{k}" / f"part{k}.mcap", folder / f"run_{k}.mcap")
    held = yaml.safe_load((bag / "metadata.yaml").read_text())
    held["rosbag2_bagfile_information"]["relative_file_paths"] = [f"run_{k}.mcap" for k in range(3)]
    held["rosbag2_bagfile_information"]["message_count"] += 2  # each part begins with /tf_static
    (folder / "metadata.yaml").write_text(yaml.safe_dump(held))
    return folder


def test_a_split_bag_is_one_log(split: Path, given: BagDrive) -> None:
    drives.check(read_bag(split, IMU), given)


@pytest.mark.parametrize(
    ("part", "data", "why"),
    [(1, None, " is missing"), (2, b"", ": not an MCAP file"), (2, b"junk" * 99, ": not an MCAP file")],
)
def test_of_a_split_bag_the_other_parts_are_read(
    split: Path, given: BagDrive, part: int, data: bytes | None, why: str
) -> None:
    (split / f"run_{part}.mcap").unlink()
    if data is not None:
        (split / f"run_{part}.mcap").write_bytes(data)
    with pytest.warns(UserWarning, match=rf"damaged \(run_{part}\.mcap{why}\): 200 scans could be read"):
        log = read_bag(split, IMU)
    drives.check(log, BagDrive(ticks=[tick for k, tick in enumerate(given.ticks) if k // 100 != part]))


def test_of_a_split_bag_the_last_file_may_be_cut(split: Path, given: BagDrive) -> None:
    data = (split / "run_2.mcap").read_bytes()
    (split / "run_2.mcap").write_bytes(data[:60_000])
    (split / "metadata.yaml").unlink()  # the recorder writes it last
    with pytest.warns(UserWarning, match=r"damaged \(run_2\.mcap: its end is missing; .*\): 2\d+ scans"):
        log = read_bag(split, IMU)
    drives.check(log, given, len(log.scans))


def test_a_bag_cut_in_its_first_messages_is_said_to_be_damaged(bag: Path, tmp_path: Path) -> None:
    (tmp_path / "cut.mcap").write_bytes((bag / "run.mcap").read_bytes()[:900])
    with pytest.raises(SourceError, match=r"holds no message \(damaged: cut\.mcap: its end is missing; .*\)"):
        read_bag(tmp_path / "cut.mcap", Topics())


def test_a_message_that_cannot_be_decoded_is_left_out_and_counted(
    bag: Path, given: BagDrive, tmp_path: Path
) -> None:
    def cut_last(scan: int, connection: Connection, data: bytes) -> bytes:
        return data[:30] if (scan, connection.topic) == (SCANS - 1, "/scan") else data

    with Writer(tmp_path / "run", version=8, storage_plugin=StoragePlugin.MCAP) as writer:
        drives.copy_bag(bag, writer, cut_last)
    log = read_bag(tmp_path / "run", IMU)
    drives.check(log, given, SCANS - 1)
    assert log.skipped == {"message on /scan that cannot be decoded": 1}


def test_a_chunk_with_a_wrong_checksum_is_told(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    kind = "sensor_msgs/msg/LaserScan"
    header = store.types["std_msgs/msg/Header"](store.types["builtin_interfaces/msg/Time"](1, 0), "laser")
    ranges, none = np.full(4, 2.5, np.float32), np.empty(0, np.float32)
    scan = store.types[kind](header, -0.15, 0.15, 0.1, 0.0, 0.1, 0.1, 30.0, ranges, none)
    with Writer(tmp_path / "run", version=8, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/scan", kind, typestore=store)
        writer.write(connection, 1, store.serialize_cdr(scan, kind))
    (file,) = (tmp_path / "run").glob("*.mcap")
    data = bytearray(file.read_bytes())
    at = 8
    while data[at] != 6:  # the library writes 0, no checksum, into its chunks
        at += 9 + int.from_bytes(data[at + 1 : at + 9], "little")
    end = at + 9 + int.from_bytes(data[at + 1 : at + 9], "little")
    name = int.from_bytes(data[at + 37 : at + 41], "little")
    data[at + 33 : at + 37] = struct.pack("<I", zlib.crc32(data[at + 49 + name : end]))
    file.write_bytes(data)
    with warnings.catch_warnings(action="error"):
        read_bag(tmp_path / "run", Topics())
    data[data.index(ranges.tobytes())] ^= 1
    file.write_bytes(data)
    with (
        pytest.warns(
            UserWarning, match=r"damaged \(crc validation failed in Chunk, .*\): 0 scans could be read"
        ),
        pytest.raises(SourceError, match="run: holds no laser scan"),
    ):
        read_bag(tmp_path / "run", Topics())


def test_the_write_ahead_log_of_a_database_is_read(given: BagDrive, tmp_path: Path) -> None:
    write_bag(tmp_path / "whole", BagDrive(ticks=given.ticks), "sqlite3")
    file, folder = tmp_path / "whole" / "whole.db3", tmp_path / "run"
    folder.mkdir()
    with closing(sqlite3.connect(file)) as database:
        rows = database.execute("SELECT * FROM messages ORDER BY timestamp").fetchall()
        database.execute("DELETE FROM messages")
        database.commit()
        database.executescript("VACUUM; PRAGMA journal_mode=WAL; PRAGMA wal_autocheckpoint=0;")
        marks = ",".join("?" * len(rows[0]))
        database.executemany(f"INSERT INTO messages VALUES ({marks})", rows)
        database.commit()
        for part in tmp_path.glob("whole/whole.db3*"):
            shutil.copy(part, folder / part.name.replace("whole", "run"))
    assert (folder / "run.db3-wal").stat().st_size
    before = sorted(p.name for p in folder.iterdir())
    drives.check(read_bag(folder, IMU), given)
    assert sorted(p.name for p in folder.iterdir()) == before


@pytest.mark.parametrize(
    ("names", "whole"),
    [
        (("drive_0.bag", "drive_1.bag"), True),
        (("drive_2026-01-02-10-00-00_0.bag", "drive_2026-01-02-10-01-00_1.bag"), True),
        (("monday.bag", "tuesday.bag"), False),
    ],
)
def test_the_parts_of_a_ros_1_bag_are_one_log(
    names: tuple[str, str], whole: bool, ros1: Path, given: BagDrive, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    with rosbag1.Reader(ros1) as reader:
        messages = list(reader.messages())
    folder.mkdir()
    for name, part in zip(
        names, (messages[: len(messages) // 2], messages[len(messages) // 2 :]), strict=True
    ):
        with rosbag1.Writer(folder / name) as writer:
            made: dict[str, Connection] = {}
            for c, stamp, data in part:
                if c.topic not in made:
                    made[c.topic] = writer.add_connection(
                        c.topic, c.msgtype, msgdef=c.msgdef.data, md5sum=c.digest
                    )
                writer.write(made[c.topic], stamp, data)
    assert is_bag(folder)
    if whole:
        drives.check(read_bag(folder, IMU), given)
    else:
        with pytest.raises(SourceError, match=r"run: .*several bags: give one of monday\.bag, tuesday\.bag"):
            read_bag(folder, IMU)


def test_fewer_messages_than_the_metadata_states_are_told(bag: Path, tmp_path: Path) -> None:
    shutil.copytree(bag, tmp_path / "run")
    file = tmp_path / "run" / "metadata.yaml"
    stated = yaml.safe_load(file.read_text())
    count = stated["rosbag2_bagfile_information"]["message_count"]
    stated["rosbag2_bagfile_information"]["message_count"] = count + 5
    file.write_text(yaml.safe_dump(stated))
    with pytest.warns(UserWarning, match=rf"metadata\.yaml states {count + 5} messages, there are {count}"):
        read_bag(tmp_path / "run", Topics())


def test_late_and_repeated_messages_leave_the_stamps_alone(
    bag: Path, given: BagDrive, tmp_path: Path, recwarn: Any
) -> None:
    """Scans arrive 0.25 s late, two of them in the wrong order, and each tenth pose comes twice."""
    with (
        AnyReader([bag]) as reader,
        Writer(tmp_path / "run", version=8, storage_plugin=StoragePlugin.MCAP) as writer,
    ):
        made = {
            c.topic: writer.add_connection(c.topic, c.msgtype, typestore=reader.typestore)
            for c in reader.connections
        }
        received = Counter[str]()
        late: list[tuple[int, str, bytes]] = []
        for c, stamp, data in reader.messages():
            received[c.topic] += 1
            delay = {"/scan": 250_000_000}.get(c.topic, 0)
            delay += 30_000_000 if (c.topic, received[c.topic]) == ("/scan", 50) else 0
            twice = c.topic == "/odom" and received[c.topic] % 10 == 0
            late += [(stamp + delay + k, c.topic, bytes(data)) for k in range(1 + twice)]
        for stamp, topic, data in sorted(late):
            writer.write(made[topic], stamp, data)
    log = read_bag(tmp_path / "run", IMU)
    drives.check(log, given)
    assert log.lines.moved == 0
    assert not recwarn.list
