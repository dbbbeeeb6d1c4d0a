"""How right and how fast the mappers are on real logs, beside the C++ originals.

    python benchmarks/slam.py [--mapper NAME ...] [--seeds N] [--quick] [--data FOLDER]

Intel Research Lab: relative-relation metric of Kuemmerle et al. 2009, once over all relations and once over
those of which both stamps are those of scans (to 1 ms); the floor of these relations is about .015 m. MIT
CSAIL, Orebro and Edmonton (a scan a meter): absolute error against reference poses, after rigid alignment.
One thread, CPU time, compilation apart; every row in a process of its own, MB is what it grows by while
driving. `--quick` drives a fifth of each log with one seed.
"""

from __future__ import annotations

import multiprocessing
import resource
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import fields
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.steps import DATA, arguments, print_rows
from lirs_validation.logs.read_log import read_constraints, read_reference
from lirs_validation.metrics.mapped_log import constraint_errors, reference_errors
from lirs_wct.formats.carmen_log import read_carmen
from lirs_wct.formats.laser_log import LaserLog
from lirs_wct.geometry.pose import Trajectory
from slam_baselines.mapper import MAPPERS, Mapper, make_mapper

LOGS = {
    "intel": "intel/intel.clf.gz",
    "csail": "csail/mit-csail.clf.gz",
    "orebro": "orebro/orebro.clf.gz",
    "edmonton": "edmonton/edmonton.clf.gz",
}
RELATIONS = "intel/intel.relations.gz"
REFERENCES = {
    "csail": "csail/reference_poses.log.gz",
    "orebro": "orebro/reference_poses.tum.gz",
    "edmonton": "edmonton/reference_poses.tum.gz",
}
SEARCH = "cartographer_original-search"
"""Row of `cartographer_original` with its exhaustive search around each predicted pose."""

RIGHT = ("m", "deg", "m at scans", "deg at scans", "lost")
FAST = ("ms a scan", "ms a used", "p50", "p95", "p99", "max", "seconds", "MB")
Figures = Mapping[str, float]

ORIGINALS: Mapping[tuple[str, str], Figures] = {
    ("hector", "intel"): {"m": 0.024, "deg": 0.58, "ms a scan": 0.046},
    ("hector", "csail"): {"m": 6.0, "ms a scan": 0.10},
    ("gmapping", "intel"): {"m": 0.042, "deg": 1.91, "ms a used": 57.5},
    ("gmapping", "csail"): {"m": 0.345, "ms a used": 101},
    ("hector", "orebro"): {"m": 0.47},
    ("hector", "edmonton"): {"m": 0.73},
    ("cartographer_original", "intel"): {"m": 6.23},
    (SEARCH, "intel"): {"m": 0.062},
}
"""The C++ original of the same name on the same log."""


def main() -> None:
    """Measure what is asked for, one row after the other, and print the tables."""
    names = [*sorted(MAPPERS), SEARCH]
    given = arguments(__doc__, mapper=names, log=list(LOGS), seeds=5, quick=False, data=DATA / "logs")
    jobs = [
        (name, log, seed, 0.2 if given.quick else 1.0, given.data)
        for log in given.log
        for name in given.mapper
        for seed in range(1, 1 + (given.seeds if seeded(name) and not given.quick else 1))
    ]
    fresh = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(max_workers=1, mp_context=fresh, max_tasks_per_child=1) as one_by_one:
        rows = list(one_by_one.map(measure, jobs))
    for title, figures in (("How right", RIGHT), ("How fast", FAST)):
        print_rows(table(figures, rows), title, width=140)


def seeded(name: str) -> bool:
    """Whether a mapper draws random numbers."""
    method = MAPPERS[name.removesuffix("-search")]
    return "seed" in {f.name for f in fields(getattr(import_module(method.module), method.config))}


def make(name: str, seed: int) -> Mapper:
    """Return the mapper of a row."""
    if name == SEARCH:
        return make_mapper("cartographer_original", use_online_correlative_scan_matching=True)
    return make_mapper(name, seed=seed)


def measure(job: tuple[str, str, int, float, Path]) -> dict[str, Any]:
    """Drive one mapper through (a share of) one log; return its row."""
    name, log_name, seed, share, data = job
    log = read_carmen(data / LOGS[log_name])
    scans = int(len(log.scans) * share)
    drive(make(name, seed), log, min(scans, 300))  # compiles, or loads what is compiled
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    mapper = make(name, seed)
    updates, seconds = drive(mapper, log, scans)
    stats = mapper.stats
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    used = stats.counts.get("nodes", stats.used)
    p50, p95, p99, most = np.percentile(updates, (50, 95, 99, 100)).tolist()
    row = {"mapper": name, "log": log_name, "seed": seed, "scans": scans, "used": used}
    row |= {"ms a scan": 1e3 * seconds / scans, "ms a used": 1e3 * seconds / max(used, 1)}
    row |= {"p50": p50, "p95": p95, "p99": p99, "max": most, "seconds": seconds, "MB": grown / 1024}
    row |= {"lost": stats.lost}
    return row | judge(log_name, mapper.trajectory(), log, data)


def drive(mapper: Mapper, log: LaserLog, scans: int) -> tuple[list[float], float]:
    """Feed the log; return CPU milliseconds of each update and CPU seconds of all."""
    # One look at the clock an update: it is a system call and takes a microsecond or two.
    times = [time.process_time_ns()]
    for scan, odometry in zip(log.scans[:scans], log.odometry[:scans], strict=True):
        mapper.update(scan, odometry, None)
        times.append(time.process_time_ns())
    return (1e-6 * np.diff(times)).tolist(), 1e-9 * (times[-1] - times[0])


def judge(log_name: str, estimate: Trajectory, log: LaserLog, data: Path) -> dict[str, float]:
    """Return the errors of an estimate, meters and degrees."""
    if log_name in REFERENCES:
        errors = reference_errors(estimate, read_reference(data / REFERENCES[log_name]))
        return {"m": float(np.sqrt((errors.position**2).mean()))}
    relations = read_constraints(data / RELATIONS)
    stamps = np.array([(r.stamp_a, r.stamp_b) for r in relations])
    gaps = np.abs(stamps[..., None] - log.stamps).min(axis=-1).max(axis=-1)
    at_scans = tuple(r for r, gap in zip(relations, gaps, strict=True) if gap <= 1e-3)
    figures = {}
    for where, chosen in (("", relations), (" at scans", at_scans)):
        apart = constraint_errors(estimate, chosen, log.track)
        if len(apart.translation):
            figures[f"m{where}"] = float(apart.translation.mean())
            figures[f"deg{where}"] = float(np.degrees(apart.rotation.mean()))
    return figures


def table(figures: tuple[str, ...], rows: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Yield the figures of the C++ original above those of each mapper's seeds."""
    for case in dict.fromkeys((row["mapper"], row["log"]) for row in rows):
        mine = [row for row in rows if (row["mapper"], row["log"]) == case]
        original: dict[str, Any] = {"seed": "C++", **ORIGINALS.get(case, {})}
        for row in ([original] if case in ORIGINALS else []) + mine:
            named = {"mapper": case[0], "log": case[1], "seed": row["seed"]}
            yield named | {figure: row.get(figure) for figure in figures}


if __name__ == "__main__":
    main()
