"""Logs in MRPT's binary format, which its programs read."""

import gzip
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from benchmarks.mrpt import write_rawlog
from lirs_wct.formats.carmen.log import read_carmen
from lirs_wct.formats.laser_log import LaserLog

OFFICE = Path(__file__).resolve().parents[1] / "examples" / "data" / "office.clf.gz"


@pytest.fixture(scope="module")
def log() -> LaserLog:
    return read_carmen(OFFICE)


def test_a_log_holds_increments_and_ranges(log: LaserLog, tmp_path: Path) -> None:
    write_rawlog(tmp_path / "log.rawlog", log)
    content = gzip.decompress((tmp_path / "log.rawlog").read_bytes())
    starts = [i for i in range(len(content)) if content.startswith(b"\x87CPose2D\x01", i)]
    assert len(starts) == len(log.scans)
    increments = np.array([np.frombuffer(content[i + 9 : i + 33], "<f8") for i in starts])
    poses = [odometry for odometry in log.odometry if odometry is not None]
    walked = poses[0]
    for x, y, yaw in increments.tolist():
        walked = walked @ type(walked)(x, y, yaw)
    assert walked.distance(poses[-1]) < 1e-9
    scan = log.scans[7]
    expected = np.where(scan.hits, scan.ranges, scan.range_max).astype("<f4").tobytes()
    assert expected + scan.hits.astype(np.uint8).tobytes() in content


@pytest.mark.skipif(shutil.which("rawlog-edit") is None, reason="needs Debian's mrpt-apps")
def test_mrpt_reads_it(log: LaserLog, tmp_path: Path) -> None:
    write_rawlog(tmp_path / "log.rawlog", log)
    command = ["rawlog-edit", "--info", "-i", str(tmp_path / "log.rawlog")]
    told = subprocess.run(
        command, capture_output=True, text=True, check=True, stdin=subprocess.DEVNULL
    ).stdout
    found = {
        key.strip(): value.strip() for key, _, value in (line.partition(":") for line in told.splitlines())
    }
    assert found["Actions/SensoryFrame format"] == "Yes"
    assert found["Overall number of objects"] == str(2 * len(log.scans))
    assert f"{log.stamps[-1] - log.stamps[0]:.3f}" in told
