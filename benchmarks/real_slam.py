"""Planar methods beside other people's 3D systems: worlds with walls, DEMs, laser maps. It reports no times.

    python benchmarks/real_slam.py [SOURCE ...] [--planar hector,gmapping,cartographer]
        [--cloud kiss-icp,genz-icp] [--lidar vlp16] [--same-lidar hector] [--seeds 1-3] [--seconds 60]
        [--robot husky] [--data FOLDER] [-o FOLDER] [--jobs 1] [--quick] [--json FILE]

The planar methods have the robot's own lidar, those of --same-lidar once more the 3D systems' lidar, of which
they get the ring nearest the horizon. Printed as Markdown, means over the seeds that succeeded; with a folder
the runs stay there, and the same command goes on where it was. kiss-slam is run where it is installed:
`--cloud kiss-icp,genz-icp,kiss-slam`. Without sources: the bundled worlds, and two DEMs and two laser maps of
the data folder.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from lirs_validation import read_record
from lirs_validation.analysis.statistics import repeats
from lirs_validation.cli.progress import run_with_progress
from lirs_validation.config import EngineOptions, RunConfig
from lirs_validation.record.formatting import NOTHING
from lirs_validation.record.metric_catalog import METRICS
from lirs_validation.record.run_record import succeeded
from lirs_validation.report.table import ReportTable
from lirs_validation.sweep.slam_experiment import SlamExperiment
from lirs_validation.sweep.suites import cross
from lirs_validation.sweep.sweep import Sweep, make_executor
from lirs_wct.option import read_names, read_numbers

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
WORLDS = ("simple", "medium", "advanced")
FILES = (
    "height/gz-common__dem_moon.tif",
    "height/tin-terrain__valid_raster.tif",
    "maps/navigation2/depot.yaml",
    "maps/turtlebot_apps/willow-2010-02-18-0.10.yaml",
)
"""In the data folder: two DEMs with their own scale, two laser maps."""
SHOWN = (
    "trajectory.ate_rmse",
    "trajectory.odometry_ate_rmse",
    "trajectory.ate_rmse_3d",
    "map.f1",
    "map.elevation_rmse",
    "map.elevation_rmse_aligned",
    "map.elevation_seen",
)


def main() -> None:
    """Run every source, mapper and seed, and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("sources", nargs="*")
    parser.add_argument("--planar", default="hector,gmapping,cartographer")
    parser.add_argument("--cloud", default="kiss-icp,genz-icp")
    parser.add_argument("--lidar", default="vlp16", help="of the 3D systems")
    parser.add_argument(
        "--same-lidar", default="hector", help="planar methods that also have it; empty = none"
    )
    parser.add_argument("--seeds", default="1-3", help="such as 1-5 or 1,3")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--robot", default="husky")
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--jobs", type=int, help="runs at a time")
    parser.add_argument("-o", "--output", type=Path, help="keep the runs there")
    parser.add_argument("--quick", action="store_true", help="`medium`, one seed, 10 s")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        entries = driven(configs_of(given), given.output or Path(temporary), given.jobs)
    print(table(entries).as_markdown())
    if given.json:
        given.json.write_text(json.dumps(rows(entries), indent=1) + "\n", encoding="utf-8")


def configs_of(given: argparse.Namespace) -> list[RunConfig]:
    """Return the runs: planar methods with the robot's lidar, and with the other; 3D systems."""
    sources = given.sources or [*WORLDS, *(str(given.data / name) for name in FILES)]
    asked = ((given.planar, None), (given.same_lidar, given.lidar), (given.cloud, given.lidar))
    return [
        config
        for names, lidar in asked
        if names.strip()
        for config in cross(
            ("medium",) if given.quick else tuple(sources),
            robot=given.robot,
            mapper=read_names(names, "--mapper"),
            lidar=lidar,
            seed=read_numbers("1" if given.quick else given.seeds, "--seeds"),
            seconds=10.0 if given.quick else given.seconds,
        )
    ]


def driven(configs: Sequence[RunConfig], out: Path, jobs: int | None) -> list[dict[str, Any]]:
    """Run the configs that have no result yet; return all records, source by source."""
    experiments = [SlamExperiment(config) for config in configs]
    order = list(dict.fromkeys(experiment.config.source for experiment in experiments))
    experiments.sort(key=lambda experiment: order.index(experiment.config.source))
    sweep = Sweep(experiments, out)
    for _ in run_with_progress(sweep, make_executor(EngineOptions(jobs=jobs)), Console(stderr=True)):
        pass
    return [read_record(out / experiment.name) for experiment in sweep.experiments]


def table(entries: Sequence[dict[str, Any]]) -> ReportTable:
    """Return the table: a row a world, mapper and lidar."""
    metrics = [metric for key in SHOWN for metric in METRICS if metric.key == key]
    groups: dict[tuple[str, str, str], list[dict[str, Any]]] = {}
    for entry in entries:
        config = entry["config"]
        key = (entry["world"]["name"], config["mapper"], config["lidar"] or "own")
        groups.setdefault(key, []).append(entry)
    shown = []
    for key, runs in groups.items():
        good = [run for run in runs if succeeded(run)]
        cells = []
        for metric in metrics:
            values = [value for run in good if (value := metric.of(run)) is not None]
            found = repeats(values)
            spread = f" ({metric.formatted(min(values))} – {metric.formatted(max(values))})" if values else ""
            cells.append(NOTHING if found is None else metric.formatted(found.mean) + spread)
        shown.append((*key, f"{len(good)} of {len(runs)}", *cells))
    headings = ("world", "mapper", "lidar", "succeeded", *(metric.heading for metric in metrics))
    return ReportTable("real-slam", "", "Mean (least – most) over the seeds.", headings, tuple(shown), 4)


def rows(entries: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return every run's figures."""
    return [
        {
            "world": entry["world"]["name"],
            "mapper": entry["config"]["mapper"],
            "lidar": entry["config"]["lidar"],
            "seed": entry["seed"],
            "status": entry["status"],
        }
        | {metric.key: metric.of(entry) for metric in METRICS if metric.key in SHOWN}
        for entry in entries
    ]


if __name__ == "__main__":
    main()
