"""MRPT's icp-slam and rbpf-slam (Debian: mrpt-apps) on CARMEN logs, beside `gmapping_original`.

    python benchmarks/mrpt.py [--data FOLDER] [--logs intel,simple-1,...] [--rawlog LOG TARGET] [--limit S]

Intel Research Lab: mean translational error of the relations, meters. Simulated runs: ATE against the truth,
meters. The programs run with the configurations that MRPT ships, without windows and pictures;
gmapping_original with seed 1. `--rawlog` only converts a log.

MRPT 2.5.8's carmen2rawlog is not used: all its stamps are equal (they are scaled by 1e-12), its field of view
is half a degree a beam unless the log says otherwise, and rbpf-slam crashes on its output, which has no
actions.
"""

from __future__ import annotations

import gzip
import re
import resource
import struct
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.slam import LOGS, RELATIONS
from benchmarks.steps import DATA, arguments, print_rows
from lirs_validation.logs.read_log import read_constraints
from lirs_validation.metrics.mapped_log import constraint_errors
from lirs_validation.metrics.trajectory import trajectory_errors
from lirs_wct import LaserScan, Pose2, Trajectory
from lirs_wct.formats.carmen_log import read_carmen
from lirs_wct.formats.drive_files import read_tum
from lirs_wct.formats.laser_log import LaserLog
from slam_baselines.mapper import make_mapper

CONFIGS = Path("/usr/share/mrpt/config_files")
PROGRAMS = {
    "icp-slam": CONFIGS / "icp-slam" / "icp-slam_demo_classic.ini",
    "rbpf-slam": CONFIGS / "rbpf-slam" / "gridmapping_intel.ini",
}
QUIET = {
    "SAVE_MAP_IMAGES": "0",
    "SAVE_3D_SCENE": "0",
    "SHOW_PROGRESS_IN_WINDOW": "0",
    "SHOW_PROGRESS_3D_REAL_TIME": "0",
    "LOG_FREQUENCY": "1000000",
    "verbosity_level": "ERROR",
}
RUNS = ("simple-1", "medium-1", "willow-1")
EPOCH = 11644473600
"""Seconds from 1601, where MRPT's time begins, to 1970."""


def main() -> None:
    """Run each program on each log and print the table."""
    given = arguments(__doc__, data=DATA, logs=",".join(("intel", *RUNS)), rawlog=Path, limit=900.0)
    if given.rawlog:
        write_rawlog(given.rawlog[1], read_carmen(given.rawlog[0]))
        return
    rows = []
    for name in given.logs.split(","):
        folder = given.data / "fidelity" / name
        intel = given.data / "logs" / LOGS["intel"]
        log = read_carmen(intel if name == "intel" else folder / "scans.clf.gz")
        paths = {"odometry": (log.track, 0.0)}
        paths |= {program: run(program, log, given.limit) for program in PROGRAMS}
        paths["gmapping_original"] = map_here(log)
        row = {key: f"{error(name, *path, log, given.data)}" for key, path in paths.items()}
        rows.append({"log": name} | row)
    print_rows(rows, "error in meters (CPU seconds)", width=120)


def run(program: str, log: LaserLog, limit: float) -> tuple[Trajectory, float]:
    """Run a program of MRPT on a log; return its path and its CPU seconds."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        write_rawlog(folder / "log.rawlog", log)
        text = PROGRAMS[program].read_text(encoding="utf-8")
        for key, value in (QUIET | {"logOutput_dir": str(folder / "out")}).items():
            text = re.sub(rf"^{key}\s*=.*$", f"{key} = {value}", text, flags=re.MULTILINE)
        (folder / "config.ini").write_text(text, encoding="utf-8")
        begun = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
        command = [program, str(folder / "config.ini"), str(folder / "log.rawlog")]
        subprocess.run(command, check=True, capture_output=True, stdin=subprocess.DEVNULL, timeout=limit)
        rows = np.loadtxt(folder / "out" / "log_estimated_path.txt")
    # icp-slam: k x y yaw; rbpf-slam: k x y z yaw pitch roll seconds.
    yaw = 3 if rows.shape[1] == 4 else 4
    poses = [Pose2(*row[[1, 2, yaw]]) for row in rows]
    seconds = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - begun
    return Trajectory.from_poses(log.stamps[: len(poses)], poses), seconds


def map_here(log: LaserLog) -> tuple[Trajectory, float]:
    """Return the final path of gmapping_original and its CPU seconds, compilation included."""
    mapper, begun = make_mapper("gmapping_original", seed=1), time.process_time()
    for scan, odometry in zip(log.scans, log.odometry, strict=True):
        mapper.update(scan, odometry, None)
    return mapper.trajectory(), time.process_time() - begun


def error(name: str, path: Trajectory, seconds: float, log: LaserLog, data: Path) -> str:
    """Return the error of a path in meters, and its CPU seconds."""
    if name == "intel":
        relations = read_constraints(data / "logs" / RELATIONS)
        meters = float(constraint_errors(path, relations, log.track).translation.mean())
    else:
        meters = trajectory_errors(read_tum(data / "fidelity" / name / "truth.tum.gz"), path).ate_rmse
    return f"{meters:.3f} ({seconds:.0f})"


def write_rawlog(target: Path, log: LaserLog) -> None:
    """Write a log in MRPT's binary format: an action with the odometry's increment, then the scan."""
    previous = log.odometry[0] or Pose2()
    with gzip.open(target, "wb", compresslevel=1) as file:
        for scan, odometry in zip(log.scans, log.odometry, strict=True):
            pose = odometry or previous
            stamp = struct.pack("<Q", round((scan.stamp + EPOCH) * 1e7))
            file.write(_collection("CActionCollection", 0, _movement(previous.inverse() @ pose, stamp)))
            file.write(_collection("CSensoryFrame", 2, _scan(scan, stamp)))
            previous = pose


def _object(name: str, version: int, content: bytes) -> bytes:
    return bytes((0x80 | len(name),)) + name.encode() + bytes((version,)) + content + b"\x88"


def _collection(name: str, version: int, content: bytes) -> bytes:
    return _object(name, version, struct.pack("<I", 1) + content)


def _movement(increment: Pose2, stamp: bytes) -> bytes:
    """Return an odometry increment with MRPT's default motion model (Gaussian)."""
    reading = _object("CPose2D", 1, struct.pack("<3d", increment.x, increment.y, increment.yaw))
    gauss = struct.pack("<6f", 0.01, 0.0573, 0.01745, 0.05, 0.01, 0.00349)
    thrun = struct.pack("<I6f", 300, 0.05, 0.0698, 0.01, 0.00573, 0.001, 0.00087)
    rest = struct.pack("<B2fBii", 0, 0, 0, 0, 0, 0)
    content = struct.pack("<I", 0) + reading + struct.pack("<I", 0) + gauss + thrun + rest + stamp
    return _object("CActionRobotMovement2D", 6, content)


def _scan(scan: LaserScan, stamp: bytes) -> bytes:
    n, hits = len(scan.ranges), scan.hits
    mount = np.eye(4)
    mount[:3, :3], mount[:3, 3] = scan.T_base_laser.rotation, scan.T_base_laser.position
    matrix = _object("CMatrixD", 0, struct.pack("<II", 4, 4) + mount.astype("<f8").tobytes())
    head = struct.pack("<fBf", scan.angle_increment * (n - 1), 1, scan.range_max)
    ranges = np.where(hits, scan.ranges, scan.range_max).astype("<f4").tobytes()
    valid = hits.astype(np.uint8).tobytes()
    tail = struct.pack("<f", 0.01) + stamp + struct.pack("<fId", 0.0044, 0, 0.0)
    content = head + _object("CPose3D", 1, matrix) + struct.pack("<I", n) + ranges + valid + tail
    return _object("CObservation2DRangeScan", 6, content)


if __name__ == "__main__":
    main()
