"""How well `lirs-wct info` says beforehand whether a planar scanner holds its place in a world.

    python benchmarks/forecast.py [SOURCE ...] [--data FOLDER] [--mapper hector,hector_original]
                                  [--seconds 60] [--seeds 1] [--quick]

Without sources: the bundled worlds and examples, and with `--data` real laser maps and height pictures of
that folder. In each world the forecast (hits of walls and of ground in a scan, over the drivable ground),
then runs of each mapper. A run's outcome is its ATE over that of its odometry; a mapper that lost its place
or failed is worse than any that did not, a drive that ended early counts as far as it went.
Spearman's rank correlation of the forecast with the outcome, over all worlds, is -1 where it is perfect.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from scipy.stats import spearmanr

from benchmarks.steps import arguments
from lirs_envs.robots.robot import make_robot
from lirs_validation.config import RunConfig
from lirs_validation.experiment.run import run
from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.metrics.world_geometry import scan_support
from lirs_wct.errors import MapperError, WctError
from lirs_wct.option import read_names, read_numbers

EXAMPLES = Path(__file__).parents[1] / "examples" / "data"
OWN = ("simple", "medium", "advanced", str(EXAMPLES / "office.yaml"), str(EXAMPLES / "dunes.png"))
SHARED = (
    "maps/navigation2/depot.yaml",
    "maps/turtlebot_apps/willow-2010-02-18-0.10.yaml",
    "maps/mir_robot/maze.yaml",
    "height/PX4-SITL_gazebo-classic__terrain.png",
    "height/Pillow__16bit.cropped.tif",
    "height/gazebo_terrain_generator__prayag_height_map.tif",
    "height/gz-common__dem_squared.tif",
    "height/hmstl__scene.png",
    "height/unitree_mujoco__height_field.png",
    "height/vrc_driving_heightmap.png",
)
FORECASTS = ("wall_median", "wall_p10", "wall_share")
FAILED = 1e6
"""Outcome of a run whose mapper failed: behind every other, whatever these are."""
MAPPER_FAILED = ("lost", "error", "diverged")
"""Statuses that say so."""


def outcome(entry: dict[str, Any]) -> float:
    """ATE over the odometry's; larger than any where the mapper failed."""
    return FAILED if entry["status"] in MAPPER_FAILED else entry["ate"] / entry["odometry"]


def runs(
    source: str, mapper: str, options: argparse.Namespace, worlds: ScenarioCache
) -> list[dict[str, Any]]:
    """Return status and errors of a mapper's run with each seed."""
    found = []
    held = {"source": source, "robot": options.robot, "mapper": mapper, "seconds": options.seconds}
    for seed in read_numbers(options.seeds, "--seeds"):
        config = RunConfig(**held, seed=seed)
        try:
            record = run(config, scenarios=worlds).record
        except MapperError as error:
            found.append({"seed": seed, "status": "error", "reason": str(error)})
            continue
        figures = {"ate": record.trajectory["ate_rmse"], "odometry": record.trajectory["odometry_ate_rmse"]}
        found.append({"seed": seed, "status": record.status, "reason": record.reason} | figures)
    return found


def measured(options: argparse.Namespace, console: Console) -> list[dict[str, Any]]:
    """A row a world: the forecast, and each mapper's runs."""
    worlds, robot, rows = ScenarioCache(), make_robot(options.robot), []
    for source in options.sources:
        try:
            world = worlds.scenario(RunConfig(source=source)).world
            forecast = scan_support(world, robot)
            found = {mapper: runs(source, mapper, options, worlds) for mapper in options.mapper}
        except WctError as error:
            console.print(f"left out: {error}", highlight=False, markup=False)
            continue
        figures = vars(forecast) | {"expectation": forecast.expectation}
        rows.append({"world": world.name, "forecast": figures, "runs": found})
    return rows


def median_outcome(entries: list[dict[str, Any]]) -> float:
    """The lower median over the seeds."""
    return sorted(map(outcome, entries))[(len(entries) - 1) // 2]


def correlations(rows: list[dict[str, Any]], mapper: str) -> dict[str, float]:
    """Spearman's correlation of each forecast with the median outcome of a world."""
    outcomes = [median_outcome(row["runs"][mapper]) for row in rows]
    forecasts = {key: [row["forecast"][key] for row in rows] for key in FORECASTS}
    return {key: float(spearmanr(values, outcomes).statistic) for key, values in forecasts.items()}


def came_true(rows: list[dict[str, Any]], mapper: str) -> dict[str, list[int]]:
    """For each expectation, without its numbers: runs better than their odometry, and all runs."""
    counts: dict[str, list[int]] = {}
    for row in rows:
        expectation = row["forecast"]["expectation"].rpartition(": ")[2]
        held, total = counts.get(expectation, (0, 0))
        better = sum(outcome(entry) < 1.0 for entry in row["runs"][mapper])
        counts[expectation] = [held + better, total + len(row["runs"][mapper])]
    return counts


def table(rows: list[dict[str, Any]], mappers: list[str]) -> Table:
    """Return the forecasts beside the outcomes."""
    columns = ("world", "walls", "10 %", "ground", *(f"{name}: ATE / odometry [m]" for name in mappers))
    found = Table(*columns, title="hits a scan over the drivable ground, and what came of it")
    for row in sorted(rows, key=lambda row: -row["forecast"]["wall_p10"]):
        f = row["forecast"]
        cells = [
            ", ".join(
                e["status"] if outcome(e) == FAILED else f"{e['ate']:.3f} / {e['odometry']:.3f}"
                for e in row["runs"][name]
            )
            for name in mappers
        ]
        hits = (f"{f[key]:.0f}" for key in ("wall_median", "wall_p10", "ground_median"))
        found.add_row(row["world"], *hits, *cells)
    return found


def main() -> None:
    """Measure and print."""
    options = arguments(
        __doc__,
        "sources",
        sources=(),
        data=Path,
        robot="husky",
        mapper="hector,hector_original",
        seconds=60.0,
        seeds="1",
        quick=False,
    )
    shared = [str(options.data / name) for name in SHARED] if options.data and not options.quick else []
    options.sources = options.sources or [*OWN, *shared]
    options.seconds = 15.0 if options.quick else options.seconds
    options.mapper = list(read_names(options.mapper, "--mapper"))
    console = Console()
    rows = measured(options, console)
    console.print(table(rows, options.mapper))
    for mapper in options.mapper if len(rows) > 2 else ():
        ranks = ", ".join(f"{key} {value:.2f}" for key, value in correlations(rows, mapper).items())
        console.print(f"{mapper}: rank correlation over {len(rows)} worlds: {ranks}", highlight=False)
        for expectation, (held, total) in came_true(rows, mapper).items():
            console.print(f"    {expectation}: {held} of {total} runs better than odometry", highlight=False)


if __name__ == "__main__":
    main()
