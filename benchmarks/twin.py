"""Twin test: planted noise recovered, and real logs against their simulations.

    python benchmarks/twin.py [LOG[,TRUTH] ...] [--planted large|small|none] [--mappers NAMES|all|none]
        [--draws 20] [--jobs 1] [--output OUT]

A Husky drives through a generated floor plan with known noise of lidar, wheels and gyro; `lirs-wct twin` is
run on the log of that drive, and on the given logs with `--lidar lms200`. Mappers map each log and its
simulations: is the error on the log in the interval of the simulations? TRUTH is a reference trajectory, or
relations if its name has the word. An `imu.csv.gz` beside a log gives the attitude on the log.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from statistics import median
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
from lirs_extensions.search.twin.replay import Replay, parse_mappers
from lirs_extensions.search.twin.twin import run_twin
from lirs_validation import validate
from lirs_validation.config import MapConfig
from lirs_wct import OccupancyGrid, SourceError
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
    "lost real, simulated", "CPU s",
)  # fmt: skip
ERRORS = ("log", "mapper", "error, m", "interval, m", "inside", "high / low", "lost draws, log")


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
    return (
        log, f"{scans['localized']} of {scans['odd blocks']}", f"{beams['compared']:.2f}",
        f"{fitted} [{low}, {high}]", f"{figures['map_share']:.2f}",
        f"{distance['before']:.3f}, {distance['after']:.3f}", f"{lost['real']:.4f}, {lost['simulated']:.4f}",
    )  # fmt: skip


def replay_rows(log: str, replay: Replay) -> list[tuple[str, ...]]:
    """Return a row for each mapper."""
    rows: list[tuple[str, ...]] = []
    for m in replay.mappers:
        draws, real = m.status[: len(m.drawn)], m.status[len(m.drawn) :]
        status = f"{len(draws) - draws.count('ok')}, {' '.join(real)}" if draws else m.reason
        if m.spread is None or m.real is None:
            rows.append((log, m.mapper, *("-",) * 4, status))
            continue
        low, high = m.spread.low, m.spread.high
        inside = "yes" if m.inside else "above" if m.real > high else "below"
        interval = f"{low:.3f} to {high:.3f}"
        rows.append((log, m.mapper, f"{m.real:.3f}", interval, inside, f"{high / low:.1f}", status))
    return rows


def coverage_rows(replays: Sequence[Replay]) -> list[tuple[str, ...]]:
    """Return how often the interval holds and how wide it is, for each mapper and all."""
    every = [m for replay in replays for m in replay.mappers if m.inside is not None]
    rows: list[tuple[str, ...]] = []
    for name in (*dict.fromkeys(m.mapper for m in every), "all"):
        some = [m for m in every if name in (m.mapper, "all")]
        width = median(m.spread.high / m.spread.low for m in some if m.spread)
        rows.append((name, f"{sum(bool(m.inside) for m in some)} of {len(some)}", f"{width:.1f}"))
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


def show_logs(
    console: Console, logs: Sequence[str], mappers: Sequence[str], draws: int, jobs: int, out: Path
) -> None:
    """Print noise, distances and replays of real logs."""
    noise, errors = Table(*COLUMNS, title="real logs"), Table(*ERRORS, title="replay")
    replays = []
    for given in logs:
        log, _, truth = given.partition(",")
        path, name = Path(log), "/".join(Path(log).parts[-2:])
        kind = "relations" if "relations" in Path(truth).name else "reference"
        known: dict[str, Any] = {kind: truth} if truth else {}
        imu = path.parent / "imu.csv.gz"
        config = MapConfig(log=log, imu=str(imu) if imu.exists() else None, **known)
        begun = time.process_time()
        try:
            result, _ = run_twin(
                config, lidar="lms200", seed=1, out=out, replayed=mappers, draws=draws, jobs=jobs
            )
        except SourceError as error:
            console.print(str(error))
            continue
        noise.add_row(*log_row(name, result.figures()), f"{time.process_time() - begun:.0f}")
        if result.replay is not None:
            replays.append(result.replay)
            for deviation, both in result.replay.figures()["odometry"].items():
                if both["real"] is not None:
                    values = (f"{both[key]:.3f}" for key in ("real", "simulated"))
                    errors.add_row(name, f"odometry, {deviation}", *values)
            for row in replay_rows(name, result.replay):
                errors.add_row(*row)
                print(*row, sep="\t", flush=True)
    console.print(noise)
    if replays:
        console.print(errors)
        coverage = Table("mapper", "inside", "median high / low", title="intervals")
        for row in coverage_rows(replays):
            coverage.add_row(*row)
        console.print(coverage)


def main() -> None:
    """Measure and print."""
    given = arguments(
        __doc__, "logs", logs=(), planted="large", seconds=300.0, mappers="all", draws=20, jobs=1, output=Path
    )
    console = Console(width=170)
    with tempfile.TemporaryDirectory() as made:
        if given.planted != "none":
            show_planted(console, given.planted, given.seconds, Path(made))
        if given.logs:
            names = parse_mappers(given.mappers)
            show_logs(console, given.logs, names, given.draws, given.jobs, given.output or Path(made))


if __name__ == "__main__":
    main()
