"""Draw the maps of the site's first table and print its rows, from the runs of docs/measured.md#verdicts.

python docs/pictures/make_verdict_table.py RUNS                             # writes out/verdicts/
python docs/pictures/make_verdict_table.py RUNS -o docs/pictures/verdicts   # in place of the tracked ones
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from lirs_validation.analysis.results import RunFolder, read_results
from lirs_wct.arrays import ByteArray
from lirs_wct.drawing.canvas import Canvas
from lirs_wct.formats.drive_files import read_tum
from lirs_wct.formats.map_server import read_map

WORLDS = ("simple", "medium", "advanced")
METHODS = (
    *("hector", "gmapping", "cartographer"),
    *("hector_original", "gmapping_original", "cartographer_original", "slam_toolbox_original"),
)
FRAMES = {
    "works": (0, 158, 115),
    "path only": (230, 159, 0),
    "adds nothing": (230, 159, 0),
    "loses its way": (190, 40, 40),
}
"""Color around a map by verdict, best first."""
TRUTH, ESTIMATE = (0, 114, 178), (213, 94, 0)
SIZE, FRAME = 184, 5
"""Pixels of a picture's edge and of its frame; the site shows them at half their size."""
COLORS = 24


def main() -> None:
    """Draw the maps, and print a row for each world."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", type=Path, help="folder of the runs")
    parser.add_argument("-o", "--output", type=Path, default=Path("out/verdicts"))
    given = parser.parse_args()
    given.output.mkdir(parents=True, exist_ok=True)
    runs = read_results(given.runs).runs
    for world in WORLDS:
        sys.stdout.write(f"| {' | '.join(row(world, runs, given.output))} |\n")


def row(world: str, runs: tuple[RunFolder, ...], output: Path) -> Iterator[str]:
    """Draw the maps of a world, and yield the cells of its row."""
    driven = [run for run in runs if run.entry["world"]["name"] == world]
    wheels = np.mean([run.entry["trajectory"]["odometry_ate_rmse"] for run in driven])
    yield f"`{world}`<br>wheels alone<br>{wheels:.3f} m"
    for method in METHODS:
        some = [run for run in driven if run.entry["config"]["mapper"] == method]
        counts = Counter(run.entry["verdict"]["class"] for run in some)
        kind = max(counts, key=lambda name: (counts[name], list(FRAMES).index(name)))
        shown = min(
            (run for run in some if run.entry["verdict"]["class"] == kind), key=lambda run: run.entry["seed"]
        )
        path = output / f"{world}-{method}.png"
        Image.fromarray(picture(shown, FRAMES[kind])).quantize(COLORS).save(path, optimize=True)
        error = np.mean([run.entry["trajectory"]["ate_rmse"] for run in some])
        image = f"[![{method} on {world}: {kind}](pictures/verdicts/{path.name})](measured.md#verdicts)"
        yield f"{image}<br>{kind}<br>{counts[kind]} of {len(some)}, {error:.3f} m"


def picture(run: RunFolder, frame: tuple[int, int, int]) -> ByteArray:
    """Return a run's map with the true path and the mapper's, in a frame, RGB."""
    canvas = Canvas.over(tuple(run.entry["world"]["bounds"]), SIZE - 2 * FRAME)
    shown = np.ascontiguousarray(canvas.grid_picture(read_map(run.folder / "map.yaml")) * 255, dtype=np.uint8)
    west, _, _, north = canvas.bounds
    for name, color in (("truth", TRUTH), ("estimate", ESTIMATE)):
        xy = read_tum(run.folder / f"{name}.tum").xy
        pixels = np.stack([xy[:, 0] - west, north - xy[:, 1]], axis=1) / canvas.pixel
        cv2.polylines(shown, [np.round(pixels * 16).astype(np.int32)], False, color, 2, cv2.LINE_AA, 4)
    framed: ByteArray = cv2.copyMakeBorder(shown, *4 * (FRAME,), cv2.BORDER_CONSTANT, value=frame)
    return framed


if __name__ == "__main__":
    main()
