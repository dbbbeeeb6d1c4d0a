"""Natural terrain without walls: is a mapper worse than its odometry, and does it draw ground as walls?

    python benchmarks/natural_terrain.py [--data FOLDER] [--mapper NAME ...] [--robot NAME ...]
        [--seeds 1-3] [--quick]

Sources are generated terrains, and the height pictures of a folder on which the robot finds a start, each
also as a valley of 80 m with a relief of 8 m. Rules for the `ok` runs of a mapper: in 95 % of them the ATE is
at most 1.05 x the odometry's + 0.02 m, and in none above 1.3 x + 0.05 m. A run draws ground as walls where
more than 20 % of its occupied cells, and at least 50 cells, are farther than 0.10 m from any face steeper
than 45 deg.
"""

from __future__ import annotations

import argparse
import itertools
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.steps import DATA, arguments, print_rows
from lirs_envs.generators.terrain import EDGE, NATURAL_TERRAINS
from lirs_validation import validate
from lirs_wct.errors import WctError
from lirs_wct.option import read_numbers
from lirs_wct.sources.source import BuildOptions

MAPPERS = ("hector", "gmapping", "cartographer")
SUFFIXES = (".png", ".tif", ".pgm", ".jpeg")
ROBOTS = ("husky", "jackal")
USUAL, WORST = (1.05, 0.02), (1.3, 0.05)
"""Ratio to the odometry's ATE and meters beyond it: of 95 % of the runs, and of every run."""
VALLEY = BuildOptions(grayscale=True, size=80.0, height=8.0)
FALSE_SHARE, FALSE_CELLS = 0.2, 50


def main() -> None:
    """Run every source with every robot, mapper and seed; print the table and a line for each mapper."""
    given = arguments(
        __doc__, data=DATA / "height", mapper=MAPPERS, robot=ROBOTS, seeds="1-3", seconds=60.0, quick=False
    )
    given.seconds = 30.0 if given.quick else given.seconds
    seeds = read_numbers("1" if given.quick else given.seeds, "--seeds")
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        generated = {seed: [write_terrain(n, seed, Path(folder)) for n in NATURAL_TERRAINS] for seed in seeds}
        files = sorted(path for path in given.data.glob("*") if path.suffix.lower() in SUFFIXES)
        pictures = [(path, o) for path in files for o in (BuildOptions(grayscale=True), VALLEY)]
        for seed in seeds:
            for path, options in generated[seed] + ([] if given.quick else pictures):
                rows += rows_of(path, options, given, seed)
    columns = "source", "size", "robot", "mapper", "seed", "odometry", "ate", "status", "f1", "false_occupied"
    print_rows([{name: row.get(name) for name in (*columns, "broken")} for row in rows], width=170)
    for name in given.mapper:
        mine = [row for row in rows if row["mapper"] == name and row["status"] == "ok"]
        usual, worst, walls = (
            sum(rule in row["broken"] for row in mine) for rule in ("usual", "worst", "walls")
        )
        share = 1 - usual / max(len(mine), 1)
        print(
            f"{name}: {100 * share:.1f} % of {len(mine)} runs within {USUAL[0]} x + {USUAL[1]} m of the "
            f"odometry, {worst} above {WORST[0]} x + {WORST[1]} m; ground drawn as walls in {walls}"
        )


def rows_of(
    path: Path, options: BuildOptions, given: argparse.Namespace, seed: int
) -> Iterator[dict[str, Any]]:
    """Yield the rows of one source; one row with the reason where a robot cannot drive there."""
    for robot, mapper in itertools.product(given.robot, given.mapper):
        row = {"source": path.stem, "size": options.size, "robot": robot, "mapper": mapper, "seed": seed}
        try:
            run = validate(
                path, robot=robot, mapper=mapper, seconds=given.seconds, seed=seed, options=options
            )
        except WctError as error:
            yield row | {"status": f"not driven: {error}"}
            continue
        record = run.record
        row |= {"odometry": record.trajectory["odometry_ate_rmse"], "ate": record.trajectory["ate_rmse"]}
        row |= {key: record.map[key] for key in ("f1", "false_occupied", "occupied_cells")}
        yield row | {"status": record.status, "broken": broken(row)}


def broken(row: Mapping[str, Any]) -> list[str]:
    """Return which rules a run breaks."""
    limits = {"usual": USUAL, "worst": WORST}.items()
    rules = [name for name, (ratio, slack) in limits if row["ate"] > ratio * row["odometry"] + slack]
    share = row["false_occupied"] or 0.0
    return rules + (["walls"] if share > FALSE_SHARE and share * row["occupied_cells"] >= FALSE_CELLS else [])


def write_terrain(name: str, seed: int, folder: Path) -> tuple[Path, BuildOptions]:
    """Write a terrain as a 16-bit picture; return it with its scale."""
    z = NATURAL_TERRAINS[name](np.random.default_rng(seed))
    z, path = z - z.min(), folder / f"{name} {seed}.png"
    cv2.imwrite(str(path), np.round(z / z.max() * 65535).astype(np.uint16))
    return path, BuildOptions(size=EDGE, height=float(z.max()))


if __name__ == "__main__":
    main()
