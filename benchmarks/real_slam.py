"""3D SLAM systems of other people and ours, next to planar methods: one table of path errors.

    python benchmarks/real_slam.py [SOURCE ...] [--systems kiss-icp,genz-icp,...] [--planar hector,...]
        [--lidar vlp16] [--seeds 1-2] [--seconds 30] [--robot jackal] [--wall-limit 120] [--data FOLDER]
        [-o FOLDER] [--jobs 1] [--quick]

A row per method, a column per world: the ATE of each seed, in space for 3D systems and in the plane for
planar methods, and the median time of a scan. The first rows are the odometry of the same drives. A run that
takes longer than the wall limit is "too slow". With a folder the runs stay there, and the same command goes
on where it was. `pip install` rko-lio and evalio into this environment. Without sources: the bundled
worlds, and two DEMs (smooth, with relief) and two laser maps of the data folder.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from lirs_validation import read_record
from lirs_validation.cli.progress import run_with_progress
from lirs_validation.config import EngineOptions, RunConfig
from lirs_validation.record.run_record import maps_clouds
from lirs_validation.report.table import ReportTable
from lirs_validation.sweep.experiment import SlamExperiment
from lirs_validation.sweep.suites import cross
from lirs_validation.sweep.sweep import Sweep, make_executor
from lirs_wct.option import read_names, read_numbers
from slam_baselines.mapper import ALL_CLOUD_MAPPERS

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
WORLDS = ("simple", "medium", "advanced")
FILES = (
    "height/gz-common__dem_moon.tif",
    "height/gazebo_terrain_generator__prayag_height_map.tif",
    "maps/navigation2/depot.yaml",
    "maps/turtlebot_apps/willow-2010-02-18-0.10.yaml",
)
"""In the data folder: a smooth DEM, one with relief, two laser maps."""
PLANAR = "hector,gmapping,cartographer"
ODOMETRY = {"odometry, plane": "odometry_ate_rmse", "odometry, space": "odometry_ate_rmse_3d"}
"""Rows of the odometry, and their figures in the records of the first 3D system."""
TOO_SLOW = "too slow"


def main() -> None:
    """Run every source, method and seed, and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("sources", nargs="*")
    parser.add_argument("--systems", default=",".join(ALL_CLOUD_MAPPERS))
    parser.add_argument("--planar", default=PLANAR, help="with the robot's own lidar")
    parser.add_argument("--lidar", default="vlp16", help="of the 3D systems")
    parser.add_argument("--seeds", default="1-2", help="such as 1-5 or 1,3")
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--wall-limit", type=float, default=120.0)
    parser.add_argument("--robot", default="jackal")
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--jobs", type=int, default=1, help="runs at a time; times need 1")
    parser.add_argument("-o", "--output", type=Path, help="keep the runs there")
    parser.add_argument("--quick", action="store_true", help="`medium`, one seed, 10 s")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        entries = driven(configs_of(given), given.output or Path(temporary), given.jobs)
    print(table(entries).as_markdown())


def configs_of(given: argparse.Namespace) -> list[RunConfig]:
    """Return the runs, seed by seed; every robot stands still first, so that all drives are the same."""
    sources = given.sources or [*WORLDS, *(str(given.data / name) for name in FILES)]
    return [
        config
        for seed in read_numbers("1" if given.quick else given.seeds, "--seeds")
        for names, lidar in ((given.planar, None), (given.systems, given.lidar))
        if names.strip()
        for config in cross(
            ("medium",) if given.quick else tuple(sources),
            robot=given.robot,
            mapper=read_names(names, "--mapper"),
            lidar=lidar,
            seed=seed,
            seconds=10.0 if given.quick else given.seconds,
            stand=3.0,
            wall_limit=given.wall_limit,
        )
    ]


def driven(configs: Sequence[RunConfig], out: Path, jobs: int) -> list[dict[str, Any]]:
    """Run the configs that have no result yet; return all records."""
    sweep = Sweep([SlamExperiment(config) for config in configs], out)
    for _ in run_with_progress(sweep, make_executor(EngineOptions(jobs=jobs)), Console(stderr=True)):
        pass
    return [read_record(out / experiment.name) for experiment in sweep.experiments]


def table(entries: Sequence[dict[str, Any]]) -> ReportTable:
    """Return the table: a row per method, a column per world."""
    worlds = list(dict.fromkeys(entry["world"]["name"] for entry in entries))
    methods = list(dict.fromkeys(entry["config"]["mapper"] for entry in entries))
    systems = [entry for entry in entries if maps_clouds(entry) and entry["trajectory"]]
    rows = [
        (name, *(cell([e for e in systems if e["world"]["name"] == world], key) for world in worlds), "-")
        for name, key in ODOMETRY.items()
    ]
    for method in methods:
        own = [entry for entry in entries if entry["config"]["mapper"] == method]
        times = [ms for entry in own if (ms := entry["mapper"].get("ms_p50"))]
        key = "ate_rmse_3d" if any(maps_clouds(entry) for entry in own) else "ate_rmse"
        cells = [cell([e for e in own if e["world"]["name"] == world], key) for world in worlds]
        rows.append((method, *cells, f"{np.median(times):.1f}" if times else "-"))
    caption = "ATE of each seed, meters; the last column is the median time of a scan, milliseconds."
    return ReportTable("slam", "", caption, ("method", *worlds, "ms"), tuple(rows), 1)


def cell(entries: Sequence[dict[str, Any]], key: str) -> str:
    """Return a figure of each seed, or the status of a run without it."""
    found: dict[int, str] = {}
    for entry in entries:
        value = entry["trajectory"].get(key)
        slow = entry["status"] == "wall limit"
        text = entry["status"] if value is None else f"{value:.3f}"
        found.setdefault(entry["seed"], TOO_SLOW if slow else text)
    return ", ".join(found.values())


if __name__ == "__main__":
    main()
