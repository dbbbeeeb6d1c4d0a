"""Bags: what recording a drive costs, and how fast a bag is read.

    python benchmarks/bags.py [--scans 100000] [--mapper hector,gmapping,cartographer] [--quick]

Recording is measured beside the rest of the same drive, reading beside rosbags, which decodes the same
messages and does nothing else with them: processor time both, which other programs disturb least.
"""

from __future__ import annotations

import math
import tempfile
import time
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from rosbags.highlevel import AnyReader

from benchmarks.steps import arguments, print_rows
from lirs_envs.sensing.sensors import Observation
from lirs_validation import validate
from lirs_validation.experiment.run import Recording
from lirs_wct.formats.rosbag.messages import BagTick
from lirs_wct.formats.rosbag.reader import read_bag
from lirs_wct.formats.rosbag.topics import Topics
from lirs_wct.formats.rosbag.writer import BagWriter
from lirs_wct.geometry.pose import Pose2, Pose3
from lirs_wct.geometry.scan import Imu, LaserScan

BEAMS, PERIOD = 541, 0.04
"""Of a Husky's LMS111: beams, seconds from scan to scan."""


def main() -> None:
    """Measure and print."""
    given = arguments(__doc__, scans=100000, mapper="hector,gmapping,cartographer", quick=False)
    scans, seconds = (10_000, 20.0) if given.quick else (given.scans, 120.0)
    with tempfile.TemporaryDirectory() as folder:
        recording = [recorded(name, seconds, Path(folder)) for name in given.mapper.split(",")]
        reading = read(scans, Path(folder))
    print_rows(recording, "recording")
    print_rows([reading], "reading")


def recorded(mapper: str, seconds: float, folder: Path) -> dict[str, Any]:
    """Record a drive; return what recording takes, and its share of what the drive takes without."""
    validate("simple", mapper=mapper, seconds=1.0, bag="mcap", out=folder)  # compiles
    spent = []
    add = Recording.add

    def timed(self: Recording, observation: Observation, T_world_base: Pose3, T_map_base: Pose2) -> None:
        begun = time.process_time()
        add(self, observation, T_world_base, T_map_base)
        spent.append(time.process_time() - begun)

    with patch.object(Recording, "add", timed):
        record = validate("simple", mapper=mapper, seconds=seconds, bag="mcap", out=folder).record
    rest = record.cost["cpu_seconds"] - sum(spent)
    return {"mapper": mapper, "us a scan": 1e6 * sum(spent) / len(spent), "of the rest": sum(spent) / rest}


def tick(k: int, ranges: np.ndarray[Any, np.dtype[np.float32]]) -> BagTick:
    """Return the k-th scan of a drive in a circle, and what belongs to it."""
    t, yaw = PERIOD * k, 0.002 * k
    pose = Pose2(5 * math.sin(yaw), 5 - 5 * math.cos(yaw), math.remainder(yaw, math.tau))
    angle = math.radians(270)
    return BagTick(
        scan=LaserScan(ranges, -angle / 2, angle / (BEAMS - 1), 0.5, 20.0, t, Pose3(0.2, 0.0, 0.3)),
        odometry=pose,
        imu=Imu(0.01, 0.02, stamp=t),
        truth=Pose3.from_pose2(pose),
        estimate=pose,
    )


def read(scans: int, folder: Path) -> dict[str, Any]:
    """Read a bag as a log, and its messages by rosbags alone."""
    ranges = np.random.default_rng(0).uniform(0.5, 20.0, (64, BEAMS)).astype(np.float32)
    writer = BagWriter(folder / "read", "mcap", PERIOD)
    for k in range(scans):
        writer.add(tick(k, ranges[k % len(ranges)]))
    writer.close()
    begun = time.process_time()
    log = read_bag(folder / "read", Topics(imu="/imu"))
    own = time.process_time() - begun
    assert len(log.scans) == scans
    with AnyReader([folder / "read"]) as reader:
        topics = ("/scan", "/odom", "/imu", "/tf_static")
        begun = time.process_time()
        for connection, _, data in reader.messages([c for c in reader.connections if c.topic in topics]):
            reader.deserialize(data, connection.msgtype)
        peer = time.process_time() - begun
    return {"scans": scans, "scans a second": scans / own, "rosbags": scans / peer, "ratio": peer / own}


if __name__ == "__main__":
    main()
