"""Methods as published beside their C++ originals, on the scans of the same runs.

    python benchmarks/fidelity.py [--data FOLDER] [--run NAME ...] [--noise METERS] [--seeds 1-3] [--quick]

Every run has scans, IMU and truth of a simulated Husky, and the trajectories that the C++ originals made of
the scans: HectorSLAM's core (0.05 m, odometry as the start of the match), OpenSLAM's GMapping (30 particles,
its defaults, three seeds), Google's Cartographer (2D, its defaults, odometry, no IMU; "search" with
use_online_correlative_scan_matching) and slam_toolbox's Karto (its defaults). The table holds ATEs in meters,
of the odometry, each original, the same method as published here and terrain-aware. Below: Spearman's rank
correlation with the original, runs within a factor of two of it and on the same side of the odometry's ATE,
by medians of the seeds. Last, pose by pose, what is deterministic: local SLAM of Cartographer, and
slam_toolbox as known online, with its CPU time.
"""

from __future__ import annotations

import gzip
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np
from numpy.random import default_rng
from rich.progress import track
from scipy.stats import spearmanr

from benchmarks.slam import SEARCH, make
from benchmarks.steps import DATA, arguments, print_rows
from lirs_envs.robots.robot import make_robot
from lirs_extensions.originals.cartographer.local_slam import TrajectoryBuilder
from lirs_extensions.originals.cartographer.mapper import CartographerOriginalConfig
from lirs_validation.metrics.trajectory import trajectory_errors
from lirs_wct import Trajectory
from lirs_wct.formats.carmen_log import read_carmen
from lirs_wct.formats.drive_files import read_imu, read_tum
from lirs_wct.formats.laser_log import LaserLog
from lirs_wct.geometry import LaserScan, Pose2
from lirs_wct.option import read_numbers
from slam_baselines.mapper import warm_up

TOOLBOX = "slam_toolbox_original"
ORIGINALS = {
    "C++ Hector": "original_hector.tum.gz",
    "C++ GMapping": "original_gmapping_s*.tum.gz",
    "C++ Cartographer": "original_cartographer.tum.gz",
    "C++ Cartographer, search": "original_cartographer_correlative.tum.gz",
    "C++ slam_toolbox": "original_slam_toolbox.tum.gz",
}
"""Columns of the originals, and their files in the folder of a run."""
PUBLISHED = {
    "hector_original": "C++ Hector",
    "gmapping_original": "C++ GMapping",
    "cartographer_original": "C++ Cartographer",
    SEARCH: "C++ Cartographer, search",
    TOOLBOX: "C++ slam_toolbox",
}
"""Methods as published, and the column that they are compared with."""
SEEDED = ("gmapping_original", "gmapping")
COLUMNS = (
    "odometry",
    *("C++ Hector", "hector_original", "hector"),
    *("C++ GMapping", "gmapping_original", "gmapping"),
    *("C++ Cartographer", "cartographer_original", "cartographer"),
    *("C++ Cartographer, search", SEARCH),
    *("C++ slam_toolbox", TOOLBOX),
)
QUICK = 3
"""Runs of --quick."""

Row = dict[str, Sequence[float]]
"""ATEs in meters by column, one a seed; empty where the run has no such original."""


class Agreement(NamedTuple):
    """Rank correlation of a method's ATEs with its original's, and runs of all in which they agree."""

    runs: int
    rank_correlation: float | None
    within_factor_two: int
    same_side: int


def main() -> None:
    """Map every run and print the table."""
    given = arguments(__doc__, data=DATA / "fidelity", run=(), noise=0.0, seeds="1-3", quick=False)
    runs = sorted(path.parent for path in given.data.glob("*/scans.clf.gz"))
    runs = [run for run in runs if not given.run or run.name in given.run][: QUICK if given.quick else None]
    seeds = read_numbers("1" if given.quick else given.seeds, "--seeds")
    rows = {run.name: ates(run, seeds, given.noise) for run in track(runs, "mapping")}
    cells = [{"run": run} | {c: cell(row[c]) for c in COLUMNS} for run, row in rows.items()]
    print_rows(cells, "ATE in meters", width=220)
    for method in PUBLISHED:
        figures = agreement(rows.values(), method)
        correlation = "-" if figures.rank_correlation is None else f"{figures.rank_correlation:.2f}"
        print(
            f"{method}: rank correlation {correlation}, within a factor of two {figures.within_factor_two}, "
            f"same side of the odometry {figures.same_side} of {figures.runs}"
        )
    for run in runs:
        apart = " / ".join(f"{distance:.6f}" for distance in local_distances(run))
        print(f"local SLAM, {run.name}: {apart} m (after 1 s / median / largest)")
    warm_up(TOOLBOX)
    for run in runs:
        if (run / ORIGINALS["C++ slam_toolbox"]).exists():
            far, by_scan, by_node = online_distance(run)
            print(f"{TOOLBOX}, {run.name}: {far:.1e} m, CPU {by_scan:.2f} ms a scan, {by_node:.1f} ms a node")


def ates(run: Path, seeds: Sequence[int], noise: float = 0.0) -> Row:
    """Return the ATEs of one run."""
    log, scans = recorded(run, noise)
    readings, truth = read_imu(run / "imu.csv.gz"), unpacked(run / "truth.tum.gz")
    odometry = Trajectory.from_poses(log.stamps, [pose for pose in log.odometry if pose is not None])
    paths = {column: [unpacked(f) for f in sorted(run.glob(name))] for column, name in ORIGINALS.items()}
    paths["odometry"] = [odometry]
    for method in COLUMNS:
        if method in paths:
            continue
        for seed in seeds if method in SEEDED else seeds[:1]:
            mapper = make(method, seed)
            for scan, T_odom_base, imu in zip(scans, log.odometry, readings, strict=True):
                mapper.update(scan, T_odom_base, imu)
            paths.setdefault(method, []).append(mapper.trajectory())
    return {c: [trajectory_errors(truth, path).ate_rmse for path in paths[c]] for c in COLUMNS}


def recorded(run: Path, noise: float = 0.0) -> tuple[LaserLog, list[LaserScan]]:
    """Return the log of a run, and its scans with the mount in space."""
    log, mount, rng = read_carmen(run / "scans.clf.gz"), make_robot("husky").T_base_laser, default_rng(0)
    scans = []
    for scan in log.scans:
        ranges = (scan.ranges + noise * rng.standard_normal(len(scan.ranges))).astype(np.float32)
        scans.append(replace(scan, ranges=ranges, T_base_laser=mount))
    return log, scans


def local_distances(run: Path) -> tuple[float, float, float]:
    """Return distances of local SLAM's poses from the original's, meters: after 1 s, median, largest."""
    log, scans = recorded(run)
    builder = TrajectoryBuilder(CartographerOriginalConfig())
    poses = [builder.add_scan(*pair)[0] for pair in zip(scans, log.odometry, strict=True)]
    original = unpacked(run / "original_cartographer_local.tum.gz").positions[:, :2]
    apart = np.hypot(*(np.array([(p.x, p.y) for p in poses]) - original).T)
    first = apart[log.stamps <= log.stamps[0] + 1]
    return float(first.max()), float(np.median(apart)), float(apart.max())


def online_distance(run: Path) -> tuple[float, float, float]:
    """Return the largest distance from slam_toolbox, meters, and CPU milliseconds a scan and a node."""
    log, scans = recorded(run)
    mapper, begun = make(TOOLBOX, 1), time.process_time()
    poses = [mapper.update(*pair, None) for pair in zip(scans, log.odometry, strict=True)]
    spent = 1e3 * (time.process_time() - begun)
    start = log.odometry[0] or Pose2()
    original = unpacked(run / ORIGINALS["C++ slam_toolbox"]).positions[:, :2]
    apart = np.hypot(*(start.apply([(p.x, p.y) for p in poses]) - original).T)
    return float(apart.max()), spent / len(scans), spent / mapper.stats.used


def unpacked(path: Path) -> Trajectory:
    """Read a gzipped TUM file."""
    with tempfile.NamedTemporaryFile(suffix=".tum") as file:
        file.write(gzip.decompress(path.read_bytes()))
        file.flush()
        return read_tum(Path(file.name))


def agreement(rows: Any, method: str) -> Agreement:
    """Compare a method as published with its original over the runs that have one."""
    columns = (method, PUBLISHED[method], "odometry")
    triples = [[median(row[c]) for c in columns] for row in rows if row[PUBLISHED[method]]]
    ours, theirs = [t[0] for t in triples], [t[1] for t in triples]
    return Agreement(
        runs=len(triples),
        rank_correlation=float(spearmanr(ours, theirs).statistic) if len(triples) > 2 else None,
        within_factor_two=sum(t / 2 <= o <= 2 * t for o, t, _ in triples),
        same_side=sum((o < d) == (t < d) for o, t, d in triples),
    )


def cell(values: Sequence[float]) -> str:
    """Return the median of the seeds, and their range."""
    if not values:
        return "-"
    spread = f" ({min(values):.3f}-{max(values):.3f})" if len(values) > 1 else ""
    return f"{median(values):.3f}{spread}"


if __name__ == "__main__":
    main()
