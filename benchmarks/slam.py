"""How right and how fast the mappers are on real logs, beside the C++ originals on the same logs.

    python benchmarks/slam.py [--quick] [--json FILE] [--mapper NAME ...] [--seeds N] [--data FOLDER]

Intel Research Lab: relative-relation metric of Kuemmerle et al. 2009. MIT CSAIL: absolute trajectory error
against the published graph poses, after rigid alignment. One thread; CPU time of the updates, compilation
apart. `--quick` drives the first fifth of each log and one seed. The originals' figures were measured on 2
cores of an AMD EPYC and are noisy by 30-50 %, and their times are per scan that they process.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, fields
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from lirs_validation.relations import read_relations, relation_errors
from lirs_wct.formats.carmen import CarmenLog, read_carmen
from lirs_wct.trajectory import Trajectory
from slam_baselines.mapper import MAPPERS, Mapper, make_mapper

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "logs"
ORIGINALS: dict[tuple[str, str], dict[str, float]] = {
    ("hector", "intel"): {"translation": 0.052, "rotation_deg": 1.24, "ms_mean": 0.046},
    ("hector", "csail"): {"ate": 6.0, "ms_mean": 0.10},
    ("gmapping", "intel"): {"translation": 0.066, "rotation_deg": 2.5, "ms_used": 57.5},
    ("gmapping", "csail"): {"ate": 0.345, "ms_used": 101.0},
}
"""PEERS of the same name, where they were measured; cartographer's was not."""


@dataclass(frozen=True)
class Case:
    """A log and how its result is judged: figure names to values."""

    name: str
    log: CarmenLog
    judge: Callable[[Trajectory], dict[str, float]]


def intel(folder: Path) -> Case:
    log = read_carmen(folder / "intel" / "intel.clf.gz")
    relations = read_relations(folder / "intel" / "intel.relations.gz")

    def judge(estimate: Trajectory) -> dict[str, float]:
        errors = relation_errors(estimate, relations, log.track)
        return {
            "translation": float(errors.translation.mean()),
            "rotation_deg": math.degrees(errors.rotation.mean()),
            "relations": len(errors.translation),
        }

    return Case("intel", log, judge)


def csail(folder: Path) -> Case:
    log = read_carmen(folder / "csail" / "mit-csail.clf.gz")
    reference = read_carmen(folder / "csail" / "reference_poses.log.gz").track
    return Case("csail", log, lambda estimate: {"ate": ate(estimate, reference)})


def ate(estimate: Trajectory, reference: Trajectory, within: float = 0.5) -> float:
    """Root mean square distance in metres after rigid alignment, over reference poses with a scan near by."""
    near = np.abs(estimate.stamps[:, None] - reference.stamps[None]).argmin(axis=0)
    close = np.abs(estimate.stamps[near] - reference.stamps) <= within
    a, b = estimate.xy[near][close], reference.xy[close]
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    u, _, vt = np.linalg.svd(a.T @ b)
    turn = u @ np.diag((1, np.linalg.det(u @ vt))) @ vt
    return float(np.sqrt(((a @ turn - b) ** 2).sum(axis=1).mean()))


def seeded(name: str) -> bool:
    """Whether a mapper draws random numbers."""
    module, config, _ = MAPPERS[name]
    return "seed" in {f.name for f in fields(getattr(import_module(module), config))}


def drive(mapper: Mapper, log: CarmenLog, scans: int) -> float:
    """Feed the log; return CPU seconds."""
    begun = time.process_time()
    for scan, odometry in zip(log.scans[:scans], log.odometry[:scans], strict=True):
        mapper.update(scan, odometry, None)
    return time.process_time() - begun


def measure(name: str, case: Case, seed: int, share: float) -> dict[str, Any]:
    options = {"seed": seed} if seeded(name) else {}
    drive(
        make_mapper(name, **options), case.log, min(len(case.log.scans), 150)
    )  # compiles what is not cached
    mapper, scans = make_mapper(name, **options), int(len(case.log.scans) * share)
    seconds = drive(mapper, case.log, scans)
    stats = mapper.stats
    row = {"mapper": name, "log": case.name, "seed": seed, "scans": scans, "seconds": seconds}
    row |= {"ms_mean": 1e3 * seconds / scans, "ms_used": 1e3 * seconds / max(stats.used, 1)}
    row |= {"ms_p50": stats.ms_p50, "ms_p95": stats.ms_p95, "ms_max": stats.ms_max}
    row |= {"used": stats.used, "lost": stats.lost, "memory_mb": stats.memory / 1e6, **stats.counts}
    row |= case.judge(mapper.trajectory())
    for figure, theirs in ORIGINALS.get((name, case.name), {}).items():
        row[f"ratio_{figure}"] = row[figure] / theirs
    return row


def show(rows: list[dict[str, Any]], console: Console) -> None:
    table = Table(title="Mappers on real logs (ratio to the C++ original in brackets)")
    heads = ("mapper", "log", "seed", "error", "rot. [deg]", "CPU ms", "p50", "p95", "max", "lost", "MB")
    for column in heads:
        table.add_column(column, justify="left" if column in ("mapper", "log") else "right")
    for row in rows:
        key = "translation" if "translation" in row else "ate"
        table.add_row(
            row["mapper"], row["log"], str(row["seed"]), _told(row, key, "m"), _told(row, "rotation_deg"),
            _told(row, "ms_mean"), *(f"{row[f'ms_{p}']:.3f}" for p in ("p50", "p95", "max")),
            str(row["lost"]), f"{row['memory_mb']:.0f}",
        )  # fmt: skip
    console.print(table)


def _told(row: dict[str, Any], key: str, unit: str = "") -> str:
    if key not in row:
        return "-"
    ratio = f" ({row['ratio_' + key]:.2f})" if f"ratio_{key}" in row else ""
    return f"{row[key]:.3f} {unit}".strip() + ratio


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="a fifth of each log, one seed")
    parser.add_argument("--json", type=Path, help="also write the rows there")
    parser.add_argument("--mapper", nargs="+", default=["hector"], choices=sorted(MAPPERS))
    parser.add_argument("--seeds", type=int, default=5, help="of mappers that draw random numbers")
    parser.add_argument("--data", type=Path, default=DATA, help="folder with intel/ and csail/")
    arguments = parser.parse_args()
    console = Console(width=120)
    if not arguments.data.is_dir():
        parser.error(f"{arguments.data}: no such folder; --data must hold intel/ and csail/")
    rows = []
    for case in (intel(arguments.data), csail(arguments.data)):
        for name in arguments.mapper:
            seeds = 1 if arguments.quick or not seeded(name) else arguments.seeds
            share = 0.2 if arguments.quick else 1.0
            rows += [measure(name, case, seed, share) for seed in range(1, seeds + 1)]
    show(rows, console)
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=2) + "\n")


if __name__ == "__main__":
    main()
