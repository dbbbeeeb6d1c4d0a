"""A method as published beside its C++ original, on the scans of the same runs.

    python benchmarks/fidelity.py [--data FOLDER] [--json FILE]

Every run has scans, IMU and truth of a simulated Husky, and the trajectory that the C++ original made of the
scans (HectorSLAM's core, 0.05 m, odometry as the start of the match). Columns: ATE in metres of the odometry,
the original, the same method as published here (`hector_original`) and terrain-aware (`hector`, with
attitude). Below: Spearman's rank correlation with the original, runs within a factor of two of it, runs on
the same side of the odometry's ATE.
"""

from __future__ import annotations

import argparse
import gzip
import json
import tempfile
from dataclasses import replace
from pathlib import Path

from rich.console import Console
from rich.table import Table
from scipy.stats import spearmanr

from lirs_envs.robots.catalog import make_robot
from lirs_validation.metrics.trajectory import trajectory_errors
from lirs_wct import Trajectory
from lirs_wct.formats.carmen.log import read_carmen
from lirs_wct.formats.imu_csv import read_imu
from lirs_wct.formats.tum import read_tum
from slam_baselines.mapper import make_mapper

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "fidelity"
COLUMNS = ("run", "odometry", "C++ original", "hector_original", "hector")


def main() -> None:
    """Map every run and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, default=DATA, help="folder with a folder a run")
    parser.add_argument("--json", type=Path, help="also write the rows there")
    given = parser.parse_args()
    runs = sorted(path.parent for path in given.data.glob("*/original_hector.tum.gz"))
    if not runs:
        parser.error(f"{given.data}: holds no run with original_hector.tum.gz")
    rows = [row(run) for run in runs]
    Console().print(table(rows))
    Console().print(agreement(rows))
    if given.json:
        given.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def row(run: Path) -> dict[str, str | float]:
    """Return the ATEs of one run."""
    log, readings = read_carmen(run / "scans.clf.gz"), read_imu(run / "imu.csv.gz")
    truth = unpacked(run / "truth.tum.gz")
    mount = make_robot("husky").T_base_laser
    paths = {
        "odometry": Trajectory.from_poses(log.stamps.tolist(), list(log.odometry)),
        "C++ original": unpacked(run / "original_hector.tum.gz"),
    }
    for name in ("hector_original", "hector"):
        mapper = make_mapper(name)
        for scan, odometry, imu in zip(log.scans, log.odometry, readings, strict=True):
            # The log has the mount in the plane only.
            mapper.update(replace(scan, T_base_laser=mount), odometry, imu)
        paths[name] = mapper.trajectory()
    return {"run": run.name} | {name: trajectory_errors(truth, path).ate_rmse for name, path in paths.items()}


def unpacked(path: Path) -> Trajectory:
    """Read a gzipped TUM file."""
    with tempfile.NamedTemporaryFile(suffix=".tum") as file:
        file.write(gzip.decompress(path.read_bytes()))
        file.flush()
        return read_tum(Path(file.name))


def table(rows: list[dict[str, str | float]]) -> Table:
    """Return the rows for the screen."""
    shown = Table(*COLUMNS, title="ATE [m]")
    for entry in rows:
        shown.add_row(*(f"{entry[c]:.3f}" if c != "run" else str(entry[c]) for c in COLUMNS))
    return shown


def agreement(rows: list[dict[str, str | float]]) -> str:
    """Return how well the method as published agrees with its original, in words."""
    ours, theirs, odometry = (
        [float(entry[c]) for entry in rows] for c in ("hector_original", "C++ original", "odometry")
    )
    pairs = list(zip(ours, theirs, odometry, strict=True))
    within = sum(t / 2 <= o <= 2 * t for o, t, _ in pairs)
    side = sum((o < d) == (t < d) for o, t, d in pairs)
    correlation = float(spearmanr(ours, theirs).statistic)
    return (
        f"rank correlation {correlation:.2f}, within a factor of two {within} of {len(rows)}, "
        f"same side of the odometry {side} of {len(rows)}"
    )


if __name__ == "__main__":
    main()
