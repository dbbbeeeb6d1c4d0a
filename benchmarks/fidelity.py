"""Methods as published beside their C++ originals, on the scans of the same runs.

    python benchmarks/fidelity.py [--data FOLDER] [--run NAME ...] [--noise METERS] [--seeds 1-3] [--quick]

Every run has scans, IMU and truth of a simulated Husky, and the trajectories that the C++ originals made of
the scans: HectorSLAM's core (0.05 m, odometry as the start of the match), OpenSLAM's GMapping (30 particles,
its defaults, three seeds) and Google's Cartographer (2D, its defaults, odometry, no IMU; once more with
use_online_correlative_scan_matching, "search"). The table holds ATEs in meters: of the odometry, of each
original, of the same method as published here (`hector_original`) and terrain-aware (`hector`, with
attitude); where a method draws random numbers, the median of the seeds and their range.

Below: Spearman's rank correlation of a method as published with its original, runs within a factor of two of
it, runs on the same side of the odometry's ATE, all by medians. Last, local SLAM of Cartographer pose by
pose, which is deterministic.
"""

from __future__ import annotations

import gzip
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np
from numpy.random import default_rng
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy.stats import spearmanr

from benchmarks.steps import arguments
from lirs_envs.robots.robot import make_robot
from lirs_extensions.originals.cartographer.local_slam import TrajectoryBuilder
from lirs_extensions.originals.cartographer.mapper import CartographerOriginalConfig
from lirs_validation.metrics.trajectory import trajectory_errors
from lirs_wct import Trajectory
from lirs_wct.formats.carmen_log import read_carmen
from lirs_wct.formats.drive_files import read_imu, read_tum
from lirs_wct.formats.laser_log import LaserLog
from lirs_wct.geometry import LaserScan
from lirs_wct.option import read_numbers
from slam_baselines.mapper import Mapper, make_mapper

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "fidelity"
ORIGINALS = {
    "C++ Hector": "original_hector.tum.gz",
    "C++ GMapping": "original_gmapping_s*.tum.gz",
    "C++ Cartographer": "original_cartographer.tum.gz",
    "C++ Cartographer, search": "original_cartographer_correlative.tum.gz",
}
"""Columns of the originals, and their files in the folder of a run."""
SEARCH = "cartographer_original, search"
"""Column of `cartographer_original` with its exhaustive search around each predicted pose."""
PUBLISHED = {
    "hector_original": "C++ Hector",
    "gmapping_original": "C++ GMapping",
    "cartographer_original": "C++ Cartographer",
    SEARCH: "C++ Cartographer, search",
}
"""Methods as published, and the column that they are compared with."""
SEEDED = ("gmapping_original", "gmapping")
COLUMNS = (
    "odometry",
    *("C++ Hector", "hector_original", "hector"),
    *("C++ GMapping", "gmapping_original", "gmapping"),
    *("C++ Cartographer", "cartographer_original", "cartographer"),
    *("C++ Cartographer, search", SEARCH),
)
QUICK = 3
"""Runs of --quick."""

Row = dict[str, Sequence[float]]
"""ATEs in meters by column, one a seed; empty where the run has no such original."""


class Agreement(NamedTuple):
    """How a method as published agrees with its original, by the medians of the seeds.

    Attributes:
        runs: how many have both.
        rank_correlation: Spearman's, of the ATEs; None for fewer than three runs.
        within_factor_two: runs whose ATE is within a factor of two of the original's.
        same_side: runs on the same side of the odometry's ATE.
    """

    runs: int
    rank_correlation: float | None
    within_factor_two: int
    same_side: int


def main() -> None:
    """Map every run and print the table."""
    given = arguments(__doc__, data=DATA, run=(), noise=0.0, seeds="1-3", quick=False)
    found_runs = sorted(path.parent for path in given.data.glob("*/scans.clf.gz"))
    runs = [run for run in found_runs if not given.run or run.name in given.run]
    runs = runs[: QUICK if given.quick else None]
    if not runs:
        sys.exit(f"{given.data}: holds no such run with scans.clf.gz")
    seeds = read_numbers("1" if given.quick else given.seeds, "--seeds")
    rows = {run.name: ates(run, seeds, given.noise) for run in track(runs, "mapping")}
    found = {method: agreement(rows.values(), method) for method in PUBLISHED}
    Console(width=220).print(table(rows))
    for method, figures in found.items():
        Console(width=220).print(formatted(method, figures))
    distances = {run.name: local_distances(run) for run in runs}
    for name, apart in distances.items():
        print(f"local SLAM, {name}: {' / '.join(f'{d:.6f}' for d in apart)} m {DISTANCES}")


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
            mapper = made(method, seed)
            for scan, T_odom_base, imu in zip(scans, log.odometry, readings, strict=True):
                mapper.update(scan, T_odom_base, imu)
            paths.setdefault(method, []).append(mapper.trajectory())
    return {c: [trajectory_errors(truth, path).ate_rmse for path in paths[c]] for c in COLUMNS}


def recorded(run: Path, noise: float = 0.0) -> tuple[LaserLog, list[LaserScan]]:
    """Return the log of a run, and its scans with the laser's mount, of which the log has the plane only."""
    log, mount, rng = read_carmen(run / "scans.clf.gz"), make_robot("husky").T_base_laser, default_rng(0)
    scans = []
    for scan in log.scans:
        ranges = (scan.ranges + noise * rng.standard_normal(len(scan.ranges))).astype(np.float32)
        scans.append(replace(scan, ranges=ranges, T_base_laser=mount))
    return log, scans


def made(method: str, seed: int) -> Mapper:
    """Return the mapper of a column."""
    if method == SEARCH:
        return make_mapper("cartographer_original", use_online_correlative_scan_matching=True)
    return make_mapper(method, seed=seed)


DISTANCES = "(after 1 s / median / largest)"


def local_distances(run: Path) -> tuple[float, float, float]:
    """Return the distances of local SLAM's poses from the original's, meters: see DISTANCES."""
    log, scans = recorded(run)
    builder = TrajectoryBuilder(CartographerOriginalConfig())
    poses = [builder.add_scan(*pair).pose for pair in zip(scans, log.odometry, strict=True)]
    original = unpacked(run / "original_cartographer_local.tum.gz").positions[:, :2]
    apart = np.hypot(*(np.array([(p.x, p.y) for p in poses]) - original).T)
    first = apart[log.stamps <= log.stamps[0] + 1]
    return float(first.max()), float(np.median(apart)), float(apart.max())


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


def formatted(method: str, figures: Agreement) -> str:
    """Return the agreement in words."""
    if not figures.runs:
        return f"{method}: no run has its original"
    correlation = figures.rank_correlation
    return (
        f"{method}: rank correlation {'-' if correlation is None else f'{correlation:.2f}'}, "
        f"within a factor of two {figures.within_factor_two} of {figures.runs}, "
        f"same side of the odometry {figures.same_side} of {figures.runs}"
    )


def table(rows: dict[str, Row]) -> Table:
    """Return the rows for the screen: the median of the seeds, and their range."""
    shown = Table("run", *COLUMNS, title="ATE in meters")
    for run, row in rows.items():
        shown.add_row(run, *(_cell(row[column]) for column in COLUMNS))
    return shown


def _cell(values: Sequence[float]) -> str:
    if not values:
        return "-"
    spread = f" ({min(values):.3f}-{max(values):.3f})" if len(values) > 1 else ""
    return f"{median(values):.3f}{spread}"


if __name__ == "__main__":
    main()
