"""How well `lirs-wct info` says beforehand whether a planar scanner holds its place in a world.

    python benchmarks/forecast.py [SOURCE ...] [--data FOLDER] [--mapper hector,hector_original]
                                  [--seconds 60] [--seeds 1] [--quick]

Without sources: the bundled worlds and examples, and with `--data` real laser maps and height pictures of
that folder. A run's outcome is its ATE over that of its odometry; a mapper that lost its place or failed is
worse than any that did not. A perfect forecast has a rank correlation of -1 with the outcome.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

from scipy.stats import spearmanr

from benchmarks.steps import arguments, print_rows
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
MAPPER_FAILED = {"lost": math.inf, "error": math.inf, "diverged": math.inf}
"""Outcomes of runs whose mapper failed, by status: behind every other."""


def outcome_of(config: RunConfig, worlds: ScenarioCache) -> float:
    """Return the ATE of a run over its odometry's; infinite where the mapper failed."""
    try:
        record = run(config, scenarios=worlds).record
    except MapperError:
        return math.inf
    ratio: float = record.trajectory["ate_rmse"] / record.trajectory["odometry_ate_rmse"]
    return MAPPER_FAILED.get(record.status, ratio)


def measure(options: argparse.Namespace) -> list[dict[str, Any]]:
    """Return a row a world: the forecast, and each mapper's outcomes."""
    worlds, robot, rows = ScenarioCache(), make_robot(options.robot), []
    for source in options.sources:
        common = {"source": source, "robot": options.robot, "seconds": options.seconds}
        try:
            world = worlds.scenario(RunConfig(source=source)).world
            forecast = scan_support(world, robot)
            row: dict[str, Any] = {
                "world": world.name,
                "expectation": forecast.expectation.rpartition(": ")[2],
            }
            for mapper in options.mapper:
                configs = [RunConfig(**common, mapper=mapper, seed=seed) for seed in options.seeds]
                row[mapper] = [outcome_of(config, worlds) for config in configs]
        except WctError as error:
            print(f"left out: {error}")
            continue
        rows.append(row | {key: getattr(forecast, key) for key in (*FORECASTS, "ground_median")})
    return rows


def correlations(rows: list[dict[str, Any]], mapper: str) -> dict[str, float]:
    """Return Spearman's correlation of each forecast with the lower median outcome of a world."""
    outcomes = [sorted(row[mapper])[(len(row[mapper]) - 1) // 2] for row in rows]
    return {key: float(spearmanr([row[key] for row in rows], outcomes).statistic) for key in FORECASTS}


def came_true(rows: list[dict[str, Any]], mapper: str) -> dict[str, list[int]]:
    """Return runs better than their odometry, and all runs, by expectation."""
    counts: dict[str, list[int]] = {}
    for row in rows:
        better, total = counts.get(row["expectation"], (0, 0))
        better += sum(outcome < 1.0 for outcome in row[mapper])
        counts[row["expectation"]] = [better, total + len(row[mapper])]
    return counts


def main() -> None:
    """Measure and print."""
    defaults: dict[str, Any] = {"sources": (), "data": Path, "robot": "husky", "seconds": 60.0, "seeds": "1"}
    options = arguments(__doc__, "sources", **defaults, mapper="hector,hector_original", quick=False)
    shared = [str(options.data / name) for name in SHARED] if options.data and not options.quick else []
    options.sources = options.sources or [*OWN, *shared]
    options.seconds = 15.0 if options.quick else options.seconds
    options.mapper = list(read_names(options.mapper, "--mapper"))
    options.seeds = read_numbers(options.seeds, "--seeds")
    rows = sorted(measure(options), key=lambda row: -row["wall_p10"])
    print_rows(rows, "hits a scan over the drivable ground, and ATE / odometry's by mapper")
    for mapper in options.mapper if len(rows) > 2 else ():
        ranks = ", ".join(f"{key} {value:.2f}" for key, value in correlations(rows, mapper).items())
        print(f"{mapper}: rank correlation over {len(rows)} worlds: {ranks}")
        for expectation, (better, total) in came_true(rows, mapper).items():
            print(f"    {expectation}: {better} of {total} runs better than odometry")


if __name__ == "__main__":
    main()
