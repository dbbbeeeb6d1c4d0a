"""Each method as published, with attitude, and odometry alone: who holds in which world, seeds 1 to 5.

    python benchmarks/as_published.py [SOURCE ...] [--mapper hector,gmapping,cartographer] [--seeds 1-5]
        [--seconds 120] [--robot husky] [--jobs 1] [-o FOLDER] [--quick] [--json FILE]

Printed as Markdown, one row a world and method. With a folder the runs stay there, and the same command goes
on where it was; `lirs-wct report FOLDER` then shows the same rows. It reports no times.
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
from lirs_validation.analysis.as_published import SUFFIX, conclusion, outcome_of, published_pairs
from lirs_validation.cli.progress import run_with_progress
from lirs_validation.config import EngineOptions, RunConfig
from lirs_validation.report.run_tables import method_tables
from lirs_validation.sweep.experiment import SlamExperiment
from lirs_validation.sweep.suites import cross
from lirs_validation.sweep.sweep import Sweep, make_executor
from lirs_wct.option import read_names, read_numbers
from slam_baselines.mapper import MAPPERS

WORLDS = ("simple", "medium", "advanced")
METHODS = tuple(name for name in MAPPERS if name + SUFFIX in MAPPERS)
"""Methods that also come as published."""


def main() -> None:
    """Run every world, method and seed, and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("sources", nargs="*", default=WORLDS)
    parser.add_argument("--mapper", default=",".join(METHODS), help="methods, without " + SUFFIX)
    parser.add_argument("--seeds", default="1-5", help="such as 1-5 or 1,3")
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--robot", default="husky")
    parser.add_argument("--jobs", type=int, help="runs at a time")
    parser.add_argument("-o", "--output", type=Path, help="keep the runs there")
    parser.add_argument("--quick", action="store_true", help="one seed, 20 s")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    methods = read_names(given.mapper, "--mapper")
    configs = cross(
        tuple(given.sources),
        robot=given.robot,
        mapper=tuple(name for method in methods for name in (method + SUFFIX, method)),
        seed=read_numbers("1" if given.quick else given.seeds, "--seeds"),
        seconds=20.0 if given.quick else given.seconds,
    )
    with tempfile.TemporaryDirectory() as temporary:
        entries = driven(configs, given.output or Path(temporary), given.jobs)
    for table in method_tables(entries):
        print(table.as_markdown())
    if given.json:
        given.json.write_text(json.dumps(rows(entries), indent=1) + "\n", encoding="utf-8")


def driven(configs: Sequence[RunConfig], out: Path, jobs: int | None) -> list[dict[str, Any]]:
    """Run the configs that have no result yet; return all records."""
    sweep = Sweep([SlamExperiment(config) for config in configs], out)
    for _ in run_with_progress(sweep, make_executor(EngineOptions(jobs=jobs)), Console(stderr=True)):
        pass
    return [read_record(out / experiment.name) for experiment in sweep.experiments]


def rows(entries: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the rows with every run's figures."""
    return [
        {
            "world": pair.group["world"],
            "method": pair.group["mapper"],
            "conclusion": conclusion(outcome_of(pair.planar), outcome_of(pair.aware), pair.how),
            "runs": [
                {
                    "mapper": run["config"]["mapper"],
                    "seed": run["seed"],
                    "status": run["status"],
                    "ate": run["trajectory"].get("ate_rmse"),
                    "odometry_ate": run["trajectory"].get("odometry_ate_rmse"),
                }
                for run in pair.runs
            ],
        }
        for pair in published_pairs(entries)
    ]


if __name__ == "__main__":
    main()
