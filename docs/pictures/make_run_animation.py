"""Draw the README's moving picture: a Husky drives through a world, beside the map that grows.

python docs/pictures/make_run_animation.py                               # writes out/run.gif
python docs/pictures/make_run_animation.py -o docs/pictures/run.gif      # in place of the tracked one
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np
from matplotlib.colors import to_rgb
from PIL import Image

from lirs_validation import Run, validate
from lirs_wct import LaserScan, Pose2, Pose3
from lirs_wct.arrays import FloatArray
from lirs_wct.drawing.canvas import BLUE, VERMILLION, Canvas, shaded_heights
from slam_baselines.mapper import make_mapper

PIXELS, COLORS = 360, 64
FRAMES, MILLISECONDS = 60, 120
"""Of the picture, and how long each is shown."""
HIT = (0.85, 0.10, 0.15)


def main() -> None:
    """Drive, map the scans once more, and draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--world", default="medium")
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("-o", "--output", type=Path, default=Path("out/run.gif"))
    given = parser.parse_args()
    pictures = frames(validate(given.world, robot="husky", mapper="hector", seconds=given.seconds, seed=1))
    palette = pictures[-1].quantize(COLORS)
    shown = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    given.output.parent.mkdir(parents=True, exist_ok=True)
    shown[0].save(
        given.output, save_all=True, append_images=shown[1:], duration=MILLISECONDS, loop=0, optimize=True
    )


def frames(run: Run) -> list[Image.Image]:
    """Return the pictures: terrain, true path and scan at the left, map and estimated path at the right."""
    log, canvas = run.log, Canvas.over(run.world.surface.bounds, PIXELS)
    T_world_map = log.truth[0].to_pose2()
    terrain = shaded_heights(run.world, canvas)
    mapper = make_mapper("hector", seed=1)
    every = -(-len(log.observations) // FRAMES)
    pictures = []
    for k, observation in enumerate(log.observations):
        mapper.update(observation.scan, observation.odometry, observation.imu)
        if k % every:
            continue
        left, right = terrain.copy(), canvas.grid_picture(mapper.map().moved(T_world_map))
        draw_hits(left, canvas, observation.scan, log.truth[k])
        draw_path(left, canvas, [T.to_pose2() for T in log.truth[: k + 1]], BLUE)
        draw_path(right, canvas, [T_world_map @ T for T in log.estimates[: k + 1]], VERMILLION)
        gap = np.ones((canvas.shape[0], 8, 3))
        pictures.append(Image.fromarray(np.uint8(255 * np.hstack((left, gap, right)))))
    return pictures


def draw_hits(picture: FloatArray, canvas: Canvas, scan: LaserScan, T_world_base: Pose3) -> None:
    """Mark where the beams of a scan hit."""
    ranges, angles = scan.ranges[scan.hits], scan.angles[scan.hits]
    points = np.column_stack((ranges * np.cos(angles), ranges * np.sin(angles), np.zeros(len(ranges))))
    for x, y in pixels(canvas, (T_world_base @ scan.T_base_laser).apply(points)[:, :2]):
        cv2.circle(picture, (x, y), 1, HIT, -1)


def draw_path(picture: FloatArray, canvas: Canvas, path: list[Pose2], color: str) -> None:
    """Draw a path, and the robot at its end."""
    line = pixels(canvas, np.array([(T.x, T.y) for T in path]))
    cv2.polylines(picture, [line], False, to_rgb(color), 2, cv2.LINE_AA)
    tip, left, right = pixels(canvas, path[-1].apply(np.array(((1.2, 0), (-0.8, 0.7), (-0.8, -0.7)))))
    cv2.fillPoly(picture, [np.array((tip, left, right))], to_rgb(color), cv2.LINE_AA)


def pixels(canvas: Canvas, points: FloatArray) -> np.ndarray[tuple[int, int], np.dtype[np.int32]]:
    """Return (n, 2) column and row of points (n, 2), meters."""
    west, _, _, north = canvas.bounds
    return np.int32(np.column_stack((points[:, 0] - west, north - points[:, 1])) / canvas.pixel)


if __name__ == "__main__":
    main()
