"""Databases that are cut off at any place give every message that is whole in what is left."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="the extra [ros] is not installed")

from lirs_wct.formats.rosbag.salvage.message import Topic
from lirs_wct.formats.rosbag.salvage.sqlite import database_messages, database_size

TOPICS = {1: Topic("/scan", "sensor_msgs/msg/LaserScan"), 2: Topic("/points", "sensor_msgs/msg/PointCloud2")}


def database(path: Path, page: int, longest: int, count: int) -> list[tuple[int, int, bytes]]:
    """Write a database as rosbag2 does; return topic, stamp and bytes of its messages."""
    rng = np.random.default_rng(page)
    sizes = rng.integers(0, longest, count)
    stamps = rng.choice([0, 1, 200, 70_000, 2**40, 1_700_000_000_000_000_000, -5], count)
    rows = [(1 + k % 2, int(stamps[k]), k.to_bytes(2) + rng.bytes(int(n))) for k, n in enumerate(sizes)]
    with sqlite3.connect(path) as connection:
        connection.execute(f"PRAGMA page_size = {page}")
        connection.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, more TEXT)")
        connection.execute("CREATE TABLE metadata(id INTEGER PRIMARY KEY, version INTEGER, text TEXT)")
        connection.execute(
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)"
        )
        connection.execute("CREATE INDEX timestamp_idx ON messages (timestamp ASC)")
        named = [(number, topic.name, topic.kind, "cdr") for number, topic in TOPICS.items()]
        connection.executemany("INSERT INTO topics VALUES (?, ?, ?, ?)", named)
        connection.execute("INSERT INTO metadata VALUES (1, 4, 'a bag')")
        connection.executemany("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", rows)
    connection.close()
    return rows


@pytest.mark.parametrize(
    ("page", "longest"), [(512, 40), (512, 3000), (4096, 2300), (4096, 40_000), (65536, 9000)]
)
@pytest.mark.parametrize("share", [0.05, 0.3, 0.77, 1.0])
def test_every_whole_message_comes_out(tmp_path: Path, page: int, longest: int, share: float) -> None:
    path = tmp_path / "bag.db3"
    rows = database(path, page, longest, 900)
    whole = path.read_bytes()
    assert database_size(whole[:100]) == len(whole)
    path.write_bytes(whole[: max(int(len(whole) * share), 8 * page)])
    found = list(database_messages(path, tmp_path / "whole.db3"))
    wanted = [(TOPICS[topic], stamp, data) for topic, stamp, data in rows]
    places = [wanted.index(message) for message in found]
    assert len(set(places)) == len(places)
    assert share < 1 or sorted(places) == list(range(len(rows)))
    # What is left holds indices and a started row beside the messages that came out.
    held = sum(len(message.data) for message in found)
    assert held >= 0.8 * (path.stat().st_size - 8 * page - 2 * longest) - 40 * len(found)


def test_old_rows_on_pages_that_were_used_before_come_once(tmp_path: Path) -> None:
    path = tmp_path / "bag.db3"
    rows = database(path, 512, 300, 400)
    with sqlite3.connect(path) as connection:  # pages are split, and what they held is left on some
        connection.execute("UPDATE messages SET data = zeroblob(400) WHERE id % 7 = 0")
    connection.close()
    found = list(database_messages(path, tmp_path / "whole.db3"))
    assert len(found) == len(rows)
