"""Twin test: planted noise recovered, and real logs against their simulations.

    python benchmarks/twin.py [LOG[,TRUTH] ...] [--planted large|small|none] [--draws 1] [--output OUT]

A Husky drives through a generated floor plan with known noise of lidar, wheels and gyro; `lirs-wct twin` is
run on the log of that drive, and on the given logs with `--lidar lms200`. Six mappers map each log and its
simulations; TRUTH is a reference trajectory, or relations if its name has the word.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.steps import arguments
from lirs_envs.generators.floor_plan import floor_plan
from lirs_envs.lidar.noise import LidarNoise
from lirs_envs.sensing.imu import ImuConfig
from lirs_envs.sensing.sensors import SensorNoise, write_noise
from lirs_envs.sensing.wheel_odometry import OdometryConfig
from lirs_extensions.search.twin.replay import REPLAYED, Replay
from lirs_extensions.search.twin.twin import run_twin
from lirs_validation import validate
from lirs_validation.config import MapConfig
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
    "lost real, simulated", "standstill, mm", "CPU s",
)  # fmt: skip
ERRORS = ("log", "mapper", "error, m", "simulated, m", "ratio", "each simulated log", "status")


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


def replay_rows(log: str, replay: Replay) -> list[tuple[str, ...]]:
    """Return a row for each mapper."""
    rows = []
    for m in replay.mappers:
        values = ("-" if value is None else f"{value:.3f}" for value in (m.real, m.simulated, m.ratio))
        drawn = " ".join("-" if error is None else f"{error:.3f}" for error in m.drawn)
        rows.append((log, m.mapper, *values, drawn, " ".join(m.status) or m.reason))
    return rows


def show_planted(console: Console, name: str, seconds: float, folder: Path) -> None:
    """Print planted and fitted noise."""
    planted = PLANTED[name]
    log = planted_log(folder, seconds, planted)
    result, _ = run_twin(MapConfig(log=str(log)), lidar="lms111", seed=1, out=folder)
    noise, odometry = result.figures()["noise"], result.figures()["odometry"]
    names = ("sigma", "sigma_relative", "dropout", "mixed_pixels")
    rows = [(n, getattr(planted.lidar, n), *(noise[k][n] for k in ("fitted", "low", "high"))) for n in names]
    rows.append(("scale_sigma", planted.odometry.scale_sigma, *odometry["scale_sigma"]))
    rows.append(("rate_sigma", planted.imu.rate_sigma, *odometry["rate_sigma"]))
    table = Table("figure", "planted", "fitted", "low", "high", title="planted noise")
    for figure, *values in rows:
        table.add_row(figure, *(f"{value:.4f}" for value in values))
    console.print(table, f"Kolmogorov distance {result.distance_before:.3f}, {result.fitted.distance:.3f}")


def show_logs(console: Console, logs: Sequence[str], draws: int, out: Path) -> None:
    """Print noise, distances and replays of real logs."""
    noise, errors = Table(*COLUMNS, title="real logs"), Table(*ERRORS, title="replay")
    replays = []
    for given in logs:
        path, _, truth = given.partition(",")
        kind = "relations" if "relations" in Path(truth).name else "reference"
        known: dict[str, Any] = {kind: truth} if truth else {}
        config = MapConfig(log=path, **known)
        begun = time.process_time()
        names = REPLAYED if draws else ()
        result, _ = run_twin(config, lidar="lms200", seed=1, out=out, replayed=names, draws=draws)
        noise.add_row(*log_row(Path(path).name, result.figures()), f"{time.process_time() - begun:.0f}")
        if result.replay is not None:
            replays.append(result.replay)
            for name, both in result.replay.figures()["odometry"].items():
                if both["real"] is not None:
                    values = (both["real"], both["simulated"], both["simulated"] / both["real"])
                    errors.add_row(Path(path).name, f"odometry, {name}", *(f"{v:.3f}" for v in values))
            for row in replay_rows(Path(path).name, result.replay):
                errors.add_row(*row)
    console.print(noise)
    if replays:
        pairs = tuple(m for replay in replays for m in replay.pairs)
        tau = Replay("", pairs).tau
        console.print(
            errors, f"{sum(m.agrees for m in pairs)} of {len(pairs)} within a factor of two, tau {tau}"
        )


def main() -> None:
    """Measure and print."""
    given = arguments(__doc__, "logs", logs=(), planted="large", seconds=300.0, draws=1, output=Path)
    console = Console(width=170)
    with tempfile.TemporaryDirectory() as made:
        if given.planted != "none":
            show_planted(console, given.planted, given.seconds, Path(made))
        if given.logs:
            show_logs(console, given.logs, given.draws, given.output or Path(made))


if __name__ == "__main__":
    main()
