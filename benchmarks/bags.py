"""Bags: what recording a drive costs, how much memory an hour takes, and how fast a bag is read.

An hour is measured twice: the bag alone, and a whole recorded run with its evaluation.

    python benchmarks/bags.py [--scans 100000] [--mapper hector,gmapping,cartographer] [--quick] [--json FILE]

Recording is measured beside the rest of the same drive, reading beside rosbags, which decodes the same
messages and does nothing else with them: processor time both, which other programs disturb least.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from rich.console import Console
from rosbags.highlevel import AnyReader

from lirs_envs.sensing.sensors import Observation
from lirs_validation import validate
from lirs_validation.experiment.recording import Recording
from lirs_wct.formats.rosbag.messages import BagTick
from lirs_wct.formats.rosbag.reader import read_bag
from lirs_wct.formats.rosbag.topics import Topics
from lirs_wct.formats.rosbag.writer import BagWriter
from lirs_wct.formats.suffixes import Storage
from lirs_wct.geometry.pose import Pose2, Pose3
from lirs_wct.geometry.scan import Imu, LaserScan

BEAMS, PERIOD, HOUR = 541, 0.04, 3600.0
"""Of a Husky's LMS111: beams, seconds from scan to scan."""
STORAGES: tuple[Storage, ...] = ("mcap", "sqlite3")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--scans", type=int, default=100_000, help="of the bag that is read")
    parser.add_argument("--mapper", default="hector,gmapping,cartographer")
    parser.add_argument("--quick", action="store_true", help="10,000 scans, drives of 20 s instead of 120")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    scans, seconds = (10_000, 20.0) if given.quick else (given.scans, 120.0)
    console = Console(width=120)
    with tempfile.TemporaryDirectory() as folder:
        recording = [recorded(name, seconds, Path(folder)) for name in given.mapper.split(",")]
        hours = [alone(written, Path(folder) / f"hour-{s}", s, round(HOUR / PERIOD)) for s in STORAGES]
        whole = alone(driven, Path(folder) / "run", 600.0 if given.quick else HOUR)
        reading = read(scans, Path(folder))
    for row in recording:
        console.print(
            f"recording, {row['mapper']}: {row['us_a_scan']:.0f} us a scan, "
            f"{row['share']:.1%} of the rest of the drive"
        )
    for row in hours:
        console.print(
            f"an hour as {row['storage']}: {row['scans']} scans, peak {row['peak_mb']:.0f} MB, "
            f"{row['growth_mb']:+.0f} MB after the first minute, {row['file_mb']:.0f} MB on disk"
        )
    console.print(
        f"a run of {whole['seconds']:g} s, recorded: peak {whole['drive_mb']:.0f} MB while driving, "
        f"{whole['growth_kb']:.1f} kB a simulated second after the first minute, {whole['peak_mb']:.0f} MB "
        f"with the evaluation; RTF of the first minute {whole['rtf_first']:.1f}, "
        f"of the last {whole['rtf_last']:.1f}"
    )
    console.print(
        f"reading: {reading['scans']} scans at {reading['scans_a_second']:.0f} a second of processor time, "
        f"{reading['share']:.2f} x what rosbags decodes ({reading['rosbags']:.0f} a second)"
    )
    if given.json:
        document = {"recording": recording, "hours": hours, "run": whole, "reading": reading}
        given.json.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


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
    return {"mapper": mapper, "us_a_scan": 1e6 * sum(spent) / len(spent), "share": sum(spent) / rest}


def alone(measure: Callable[..., dict[str, Any]], *given: object) -> dict[str, Any]:
    """Measure in a process of its own, whose peak memory is the measurement's."""
    context = multiprocessing.get_context("spawn")
    with context.Pool(1) as pool:
        return pool.apply(measure, given)


def driven(folder: Path, seconds: float) -> dict[str, Any]:
    """Record a run on `medium` with hector; return its peaks of memory and its speed, early and late."""
    peaks = {}

    def noted(phase: str, share: float) -> None:
        reached = "early" if phase == "drive" and share * seconds < 61 else phase
        peaks[reached] = peak_mb()

    rtf = validate("medium", seconds=seconds, bag="mcap", out=folder, progress=noted).record.rtf
    first, last = (
        60.0 / sum(1.0 / second for second in part) for part in (rtf["series"][:60], rtf["series"][-60:])
    )
    growth = 1024 * (peaks["evaluate"] - peaks["early"]) / (seconds - 60)
    return {
        "seconds": seconds,
        "drive_mb": peaks["evaluate"],
        "growth_kb": growth,
        "peak_mb": peak_mb(),
        "rtf_first": first,
        "rtf_last": last,
    }


def written(path: Path, storage: Storage, scans: int) -> dict[str, Any]:
    """Write a bag; return the peak memory of this process, and how much it grew after the first minute."""
    rng = np.random.default_rng(0)
    ranges = rng.uniform(0.5, 20.0, (64, BEAMS)).astype(np.float32)
    writer = BagWriter(path, storage, PERIOD)
    early = peak_mb()
    for k in range(scans):
        writer.add(tick(k, ranges[k % len(ranges)]))
        early = peak_mb() if k == round(60.0 / PERIOD) else early
    writer.close()
    size = sum(file.stat().st_size for file in path.iterdir()) / 1e6
    peak = peak_mb()
    return {"storage": storage, "scans": scans, "peak_mb": peak, "growth_mb": peak - early, "file_mb": size}


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
    written(folder / "read", "mcap", scans)
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
    return {"scans": scans, "scans_a_second": scans / own, "rosbags": scans / peer, "share": peer / own}


def peak_mb() -> float:
    """Return this process's peak memory; `ru_maxrss` would be its parent's, where that has more."""
    lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM:"))


if __name__ == "__main__":
    main()
