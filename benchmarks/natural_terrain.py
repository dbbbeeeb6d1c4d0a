"""Natural terrain without walls: is a mapper worse than its odometry, and does it draw ground as walls?

    python benchmarks/natural_terrain.py [--data FOLDER] [--mapper NAME ...] [--seeds 1-2] [--quick]

Sources are the height pictures of a folder, where a Husky finds a start, and generated terrains. An `ok` run
breaks the rule where its ATE is above 1.1 x the odometry's + 0.05 m, or where more than 20 % of its occupied
cells, and at least 50 cells, are farther than 0.10 m from any face steeper than 45 deg.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.steps import DATA, arguments, print_rows
from lirs_envs.generators.natural import EDGE, NATURAL_TERRAINS
from lirs_validation import validate
from lirs_wct.errors import WctError
from lirs_wct.option import read_numbers
from lirs_wct.sources.source import BuildOptions

MAPPERS = ("hector", "gmapping", "cartographer")
SUFFIXES = (".png", ".tif", ".pgm", ".jpeg")
RATIO, SLACK = 1.1, 0.05
FALSE_SHARE, FALSE_CELLS = 0.2, 50


def main() -> None:
    """Run every source with every mapper and seed; print the table and how many runs broke the rule."""
    given = arguments(__doc__, data=DATA / "height", mapper=MAPPERS, seeds="1-2", seconds=60.0, quick=False)
    seconds = 30.0 if given.quick else given.seconds
    seeds = read_numbers("1" if given.quick else given.seeds, "--seeds")
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        pictures = [write_terrain(name, seed, Path(folder)) for name in NATURAL_TERRAINS for seed in seeds]
        if not given.quick:
            files = sorted(path for path in given.data.glob("*") if path.suffix.lower() in SUFFIXES)
            pictures += [(path, BuildOptions(grayscale=True)) for path in files]
        for path, options in pictures:
            rows += rows_of(path, options, given.mapper, seconds, seeds)
    columns = "source", "mapper", "seed", "odometry", "ate", "status", "f1", "false_occupied"
    shown = [{name: row.get(name) for name in (*columns, "occupied_cells", "broken")} for row in rows]
    print_rows(shown, "natural terrain, Husky (m)", width=150)
    for name in given.mapper:
        mine = [row for row in rows if row["mapper"] == name and "broken" in row]
        lost = sum(row["status"] == "lost" for row in mine)
        worse, walls = (sum(rule in row["broken"] for row in mine) for rule in ("ATE", "walls"))
        print(
            f"{name}: {sum(bool(row['broken']) for row in mine)} of {len(mine)} runs broke the rule "
            f"(worse than odometry {worse}, ground drawn as walls {walls}); {lost} lost"
        )


def rows_of(
    path: Path, options: BuildOptions, mappers: Sequence[str], seconds: float, seeds: Sequence[int]
) -> Iterator[dict[str, Any]]:
    """Yield the rows of one source; one row with the reason where nothing can drive there."""
    for mapper in mappers:
        for seed in seeds:
            try:
                record = validate(path, mapper=mapper, seconds=seconds, seed=seed, options=options).record
            except WctError as error:
                yield {"source": path.stem, "mapper": mapper, "seed": seed, "status": f"not driven: {error}"}
                return
            row = {"source": path.stem, "mapper": mapper, "seed": seed, "status": record.status}
            row |= {"odometry": record.trajectory["odometry_ate_rmse"], "ate": record.trajectory["ate_rmse"]}
            row |= {key: record.map[key] for key in ("f1", "false_occupied", "occupied_cells")}
            yield row | {"broken": broken(row)}


def broken(row: Mapping[str, Any]) -> list[str]:
    """Return which rules a run breaks; none where it did not end as `ok`."""
    if row["status"] != "ok":
        return []
    rules = ["ATE"] if row["ate"] > RATIO * row["odometry"] + SLACK else []
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
