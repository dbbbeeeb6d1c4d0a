"""Make the inputs of the examples and pages: a height picture, an elevation model, a laser map, a log.

    python examples/make_inputs.py                        # writes out/inputs/
    python examples/make_inputs.py -o examples/data       # in place of the tracked ones

Terrains and floor plan are drawn by seeded code; the log is what a simulated TurtleBot 2 with an
RPLIDAR recorded while it drove through the floor plan.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from pathlib import Path

import cv2
import numpy as np
import rasterio
from scipy import ndimage

from lirs_validation import validate
from lirs_wct.arrays import ByteArray


def main() -> None:
    """Write the inputs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("out/inputs"), help="folder")
    data: Path = parser.parse_args().output
    data.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(data / "dunes.png"), dunes(np.random.default_rng(7)))
    write_elevation_model(data / "quarry.tif", quarry(np.random.default_rng(7)))
    cv2.imwrite(str(data / "office.pgm"), office())
    (data / "office.yaml").write_text(
        "image: office.pgm\nresolution: 0.05\norigin: [-6.0, -4.0, 0.0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\n",
        encoding="utf-8",
    )
    record_log(data / "office.yaml", data / "office.clf.gz")


def dunes(rng: np.random.Generator) -> np.ndarray:
    """Return (257, 257) uint16 heights: wind-blown ridges with a few rocks on them."""
    noise = rng.standard_normal((2, 257, 257))
    swell = ndimage.gaussian_filter(noise[0], 40)
    ridges = ndimage.gaussian_filter(noise[1], (6, 30))
    z = swell / np.ptp(swell) + 0.35 * ridges / np.ptp(ridges)
    rows, cols = np.mgrid[:257, :257]
    for row, col in rng.integers(20, 237, (25, 2)):
        if np.hypot(row - 128, col - 128) > 15:
            z[np.hypot(rows - row, cols - col) < rng.uniform(2.5, 5)] += 0.2
    z -= z.min()
    return np.round(z / z.max() * 65535).astype(np.uint16)


def quarry(rng: np.random.Generator) -> np.ndarray:
    """Return (240, 240) float32 heights of a pit with three benches and a ramp, 0.5 m apart, in meters."""
    rows, cols = np.mgrid[:240, :240] / 2 - 60
    noise = rng.standard_normal((3, 240, 240))
    rim = 12 * ndimage.gaussian_filter(noise[0], 30) / ndimage.gaussian_filter(noise[0], 30).std() / 6
    depth = np.clip((46 + rim - np.hypot(cols, 1.25 * rows)) / 9, 0, 3)  # in benches
    step = np.clip((depth % 1) * 6, 0, 1)  # a face, then a flat
    pit = -2.5 * (np.floor(depth) + np.where(depth < 3, step, 0))
    along = np.clip((cols + 5) / 50, 0, 1)  # the ramp climbs eastward, from floor to rim
    ramp = -7.5 + 7.5 * along
    blend = np.clip(2.2 - np.abs(rows) / 2, 0, 1) * (cols > -5)
    ground = pit * (1 - blend) + ramp * blend
    hills = ndimage.gaussian_filter(noise[1], 25)
    rough = ndimage.gaussian_filter(noise[2], 1)
    z = 312 + ndimage.gaussian_filter(ground, 0.7) + hills / hills.std() * 0.6 + rough / rough.std() * 0.02
    return np.round(z, 2).astype(np.float32)


def write_elevation_model(path: Path, heights: np.ndarray) -> None:
    """Write heights as a GeoTIFF in a UTM system."""
    place = rasterio.transform.from_origin(458_000, 5_428_000, 0.5, 0.5)
    shape = {"height": heights.shape[0], "width": heights.shape[1], "count": 1, "dtype": "float32"}
    packed = {"compress": "deflate", "predictor": 3, "zlevel": 9}
    with rasterio.open(
        path, "w", driver="GTiff", crs="EPSG:32633", transform=place, **shape, **packed
    ) as file:
        file.write(heights, 1)


def office() -> ByteArray:
    """Return (160, 240) uint8 floor plan of 12 x 8 m: 254 free, 0 wall, 205 unknown."""
    plan = np.full((160, 240), 205, np.uint8)
    cv2.rectangle(plan, (4, 4), (235, 155), 254, -1)
    cv2.rectangle(plan, (4, 4), (235, 155), 0, 3)
    for x in (80, 160):  # two partitions, a door in each
        cv2.line(plan, (x, 4), (x, 155), 0, 3)
    cv2.rectangle(plan, (78, 60), (82, 88), 254, -1)
    cv2.rectangle(plan, (158, 100), (162, 128), 254, -1)
    for corner, size in (
        ((20, 120), (30, 12)),
        ((110, 30), (12, 30)),
        ((190, 40), (24, 14)),
        ((205, 120), (12, 12)),
    ):
        cv2.rectangle(plan, corner, (corner[0] + size[0], corner[1] + size[1]), 0, -1)
    return plan


def record_log(source: Path, log: Path) -> None:
    """Drive for a minute and keep the recorded scans and odometry."""
    with tempfile.TemporaryDirectory() as out:
        run = validate(source, robot="turtlebot2", lidar="rplidar_a1", seconds=60, seed=1, out=out)
        assert run.folder is not None
        shutil.copy(run.folder / "scans.clf.gz", log)


if __name__ == "__main__":
    main()
