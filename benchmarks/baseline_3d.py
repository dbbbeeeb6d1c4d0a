"""Mapper `wheel_lio` against its reference (wheels, gyro, gravity) and GenZ-ICP, errors in space.

    python benchmarks/baseline_3d.py [--data FOLDER] [--seeds 1-5] [--out FILE] [--only KIND ...]

A Jackal with a VLP-16 whose sweeps roll stands for 3 s and drives. Kinds of worlds: `smooth` and `terrain`
(generated ones and DEMs of the folder), `wall` (one wall on a plane), `bundled` (also with GenZ-ICP). Each
run adds a line to FILE; a later call goes on where one ended. Rules and the runs that keep them come last.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.natural_terrain import write_terrain
from benchmarks.steps import DATA, arguments, print_rows
from lirs_validation import validate
from lirs_wct.errors import WctError
from lirs_wct.option import read_numbers
from lirs_wct.sources.source import BuildOptions

GENERATED = {"plain": "smooth", "rough hills": "terrain", "dunes": "terrain", "hills with rocks": "terrain"}
"""Kind of each natural terrain, which is made of seed 1."""
ELEVATION = {
    "gz-common__dem_landscape.tif": "smooth",
    "gz-common__dem_moon.tif": "terrain",
    "gz-common__dem_squared.tif": "terrain",
    "tin-terrain__valid_raster.tif": "terrain",
}
WALLS = {"wall 3 m": 20, "wall 9 m": 60, "wall 18 m": 120}
"""Cells of .15 m of each wall."""
BUNDLED = ("simple", "medium", "advanced")
KINDS = ("smooth", "terrain", "wall", "bundled")


def main() -> None:
    """Run what is missing in the file; print the table and the rules."""
    defaults: dict[str, Any] = {"data": DATA / "height", "seeds": "1-5", "seconds": 30.0, "only": KINDS}
    given = arguments(__doc__, **defaults, out=Path("baseline_3d.jsonl"), quick=False)
    seconds, seeds = (10.0, [1]) if given.quick else (given.seconds, read_numbers(given.seeds, "--seeds"))
    with tempfile.TemporaryDirectory() as folder:
        sources = walls(Path(folder))
        sources |= {name: (kind, *write_terrain(name, 1, Path(folder))) for name, kind in GENERATED.items()}
        sources |= {name: ("bundled", name) for name in BUNDLED}
        if not given.quick:
            sources |= {Path(name).stem: (kind, given.data / name) for name, kind in ELEVATION.items()}
        for seed in seeds:
            for name, (kind, source, *options) in sources.items():
                for mapper in ("wheel_lio", *(["genz-icp"] if kind == "bundled" else [])):
                    key = {"kind": kind, "world": name, "mapper": mapper, "seed": seed, "seconds": seconds}
                    known = any(key.items() <= row.items() for row in rows_in(given.out))
                    if kind in given.only and not known:
                        row = key | run(source, mapper, seed, seconds, *options)
                        with given.out.open("a", encoding="utf-8") as out:
                            out.write(json.dumps(row) + "\n")
    rows = [row for row in rows_in(given.out) if row["seed"] in seeds and row["seconds"] == seconds]
    print_rows(table(rows), width=140)
    print("\n".join(rules(rows)))


def rows_in(path: Path) -> list[dict[str, Any]]:
    """Return the runs of a file; none where it is missing."""
    return [json.loads(line) for line in path.read_text("utf-8").splitlines()] if path.exists() else []


def walls(folder: Path) -> dict[str, tuple[Any, ...]]:
    """Write laser maps of 60 m with one wall, 13 m from the middle; return kind and path of each."""
    sources = {}
    for name, cells in WALLS.items():
        grid = np.full((400, 400), 254, np.uint8)
        grid[110:112, 200 - cells // 2 : 200 + cells // 2] = 0
        cv2.imwrite(str(folder / f"{name}.pgm"), grid)
        (folder / f"{name}.yaml").write_text(
            f"image: {name}.pgm\nresolution: 0.15\norigin: [-30, -30, 0]\nnegate: 0\n"
            "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
        )
        sources[name] = "wall", folder / f"{name}.yaml"
    return sources


def run(
    source: Any, mapper: str, seed: int, seconds: float, options: BuildOptions | None = None
) -> dict[str, Any]:
    """Return the figures of a run, or its failure."""
    given: dict[str, Any] = {"lidar": "vlp16", "scan_time": "rolling", "stand": 3.0, "robot": "jackal"}
    try:
        record = validate(
            source, mapper=mapper, seed=seed, seconds=seconds, options=options or BuildOptions(), **given
        ).record
    except WctError as error:
        return {"status": f"failed: {error}"}
    return {
        "status": record.status,
        "length": record.trajectory["length"],
        "ate": record.trajectory["ate_rmse_3d"],
        "reference": record.trajectory["odometry_ate_rmse_3d"],
        "ms": record.mapper["ms_p50"],
        "ms_p95": record.mapper["ms_p95"],
    }


def table(rows: Sequence[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Yield a row a world and mapper: median (least - most) over the seeds."""
    for world, kind, mapper in dict.fromkeys((r["world"], r["kind"], r["mapper"]) for r in rows):
        mine = [r for r in rows if (r["world"], r["mapper"]) == (world, mapper)]
        done = [r for r in mine if r["status"] == "ok"]
        row = {"world": world, "kind": kind, "mapper": mapper, "ok": f"{len(done)} of {len(mine)}"}
        row |= {f"{key} [m]": spread([r[key] for r in done]) for key in ("reference", "ate")}
        row["ATE / reference"] = spread([r["ate"] / r["reference"] for r in done])
        yield row | {"ms": float(np.median([r["ms"] for r in done])) if done else None}


def spread(values: Sequence[float]) -> str:
    """Return median, least and most for people."""
    return f"{np.median(values):.3f} ({min(values):.3f} - {max(values):.3f})" if values else "-"


def rules(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Return a line a rule: how many runs keep it."""
    ours = [r for r in rows if r["status"] == "ok" and r["mapper"] == "wheel_lio"]
    ground = [r for r in ours if r["kind"] in ("smooth", "terrain")]
    wall = [r for r in ours if r["kind"] == "wall"]
    theirs = [r for r in rows if r["status"] == "ok" and r["mapper"] == "genz-icp"]
    genz = {(r["world"], r["seed"]): r["ate"] for r in theirs}
    met = [r for r in ours if (r["world"], r["seed"]) in genz]
    kept = {
        "ground, ATE <= 1.05 x reference + .05 m": [r["ate"] <= 1.05 * r["reference"] + 0.05 for r in ground],
        "ground, ATE <= 1.3 x reference + .1 m": [r["ate"] <= 1.3 * r["reference"] + 0.1 for r in ground],
        "one wall, ATE <= .7 x reference": [r["ate"] <= 0.7 * r["reference"] for r in wall],
        "bundled, ATE <= 1.3 x GenZ-ICP": [r["ate"] <= 1.3 * genz[r["world"], r["seed"]] for r in met],
        "60 ms a sweep on the median": [r["ms"] <= 60 for r in ours],
    }
    return [f"{rule}: {sum(runs)} of {len(runs)}" for rule, runs in kept.items()]


if __name__ == "__main__":
    main()
