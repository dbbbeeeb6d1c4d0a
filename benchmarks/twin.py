"""Twin test: planted noise recovered, and real logs against their simulations.

    python benchmarks/twin.py [LOG ...] [--planted large|small] [--seconds 300]

A Husky drives through a generated floor plan with known noise of lidar, wheels and gyro; `lirs-wct twin` is
run on the log of that drive, and on the given logs with `--lidar lms200`. Asked are the planted figures
within 10 %, a Kolmogorov distance of at most .10 after the fit, and the share of lost beams within 20 %.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from lirs_envs.generators.floor_plan import floor_plan
from lirs_envs.lidar.noise import LidarNoise
from lirs_envs.sensing.imu import ImuConfig
from lirs_envs.sensing.odometry import OdometryConfig
from lirs_envs.sensing.sensors import SensorNoise, write_noise
from lirs_validation import validate
from lirs_validation.config import MapConfig
from lirs_validation.twin.twin import run_twin
from lirs_wct import OccupancyGrid
from lirs_wct.formats.map_server import write_map

PLANTED = {
    "large": SensorNoise(
        lidar=LidarNoise(sigma=0.02, sigma_relative=0.002, quantization=0.01, dropout=0.01, mixed_pixels=0.3),
        odometry=OdometryConfig(scale_sigma=0.04),
        imu=ImuConfig(rate_sigma=0.01, rate_bias=0.001),
    ),
    "small": SensorNoise(lidar=LidarNoise(sigma=0.005, quantization=0.01, dropout=0.002, mixed_pixels=0.1)),
}
"""Planted noise; that of wheels and gyro in `small` is the default of the simulation."""
PLAN_SEED, SEED = 3, 2
COLUMNS = (
    "log", "localized", "compared", "sigma, mm + mm/m", "map's share", "distance before, after",
    "lost real, simulated", "standstill, mm",
)  # fmt: skip


def planted_log(folder: Path, seconds: float, noise: SensorNoise) -> Path:
    """Return the log of a drive with the planted noise."""
    walls = floor_plan(np.random.default_rng(PLAN_SEED)).walls
    share = np.where(walls.solid, 1.0, 0.0)
    write_map(folder / "plan", OccupancyGrid.from_probability(share, walls.resolution, walls.origin))
    write_noise(folder / "planted.yaml", noise, "planted")
    run = validate(
        str(folder / "plan.yaml"), mapper="cartographer", noise=str(folder / "planted.yaml"),
        seconds=seconds, seed=SEED, out=folder / "out",
    )  # fmt: skip
    return Path(str(run.folder)) / "scans.clf.gz"


def planted_rows(planted: SensorNoise, figures: dict[str, Any]) -> list[tuple[str, ...]]:
    """Return planted and fitted figures with their intervals."""
    noise = figures["noise"]
    names = ("sigma", "sigma_relative", "dropout", "mixed_pixels")
    rows = [(n, getattr(planted.lidar, n), *(noise[k][n] for k in ("fitted", "low", "high"))) for n in names]
    odometry = figures["odometry"]
    rows.append(("scale_sigma", planted.odometry.scale_sigma, *odometry["scale_sigma"]))
    rows.append(("rate_sigma", planted.imu.rate_sigma, *odometry["rate_sigma"]))
    return [(name, *(f"{value:.4f}" for value in values)) for name, *values in rows]


def log_row(log: str, figures: dict[str, Any]) -> tuple[str, ...]:
    """Return a log's row."""
    noise, distance, lost = figures["noise"], figures["kolmogorov"], figures["lost"]
    fitted, low, high = (
        f"{1000 * noise[k]['sigma']:.1f} + {1000 * noise[k]['sigma_relative']:.2f}"
        for k in ("fitted", "low", "high")
    )
    scans, beams = figures["scans"], figures["beams"]
    still = figures["standstill"]
    return (
        log, f"{scans['localized']} of {scans['odd blocks']}", f"{beams['compared']:.2f}",
        f"{fitted} [{low}, {high}]", f"{figures['map_share']:.2f}",
        f"{distance['before']:.3f}, {distance['after']:.3f}", f"{lost['real']:.4f}, {lost['simulated']:.4f}",
        "-" if still is None else f"{1000 * still:.1f}",
    )  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("logs", nargs="*")
    parser.add_argument("--planted", choices=tuple(PLANTED), default="large")
    parser.add_argument("--seconds", type=float, default=300.0)
    given = parser.parse_args(arguments)
    console = Console(width=170)
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        planted = PLANTED[given.planted]
        log = planted_log(folder, given.seconds, planted)
        result, _ = run_twin(MapConfig(log=str(log)), lidar="lms111", seed=1, out=folder)
        table = Table("figure", "planted", "fitted", "low", "high", title="planted noise")
        for row in planted_rows(planted, result.figures()):
            table.add_row(*row)
        console.print(
            table, f"Kolmogorov distance {result.distance_before:.3f}, {result.fitted.distance:.3f}"
        )
        table = Table(*COLUMNS, title="real logs")
        for path in given.logs:
            result, _ = run_twin(MapConfig(log=path), lidar="lms200", seed=1, out=folder)
            table.add_row(*log_row(Path(path).name, result.figures()))
        console.print(table)


if __name__ == "__main__":
    main()
