"""Picture of a run in a report: paths over the hillshade, true-pose map, built map.

For a mapper of point clouds, the error of its elevation map replaces the built map.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from lirs_validation.analysis.results import RunFolder, recorded_world_config
from lirs_validation.drawing import error_picture, shown_bounds
from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.metrics.elevation import ELEVATION, ElevationMap, read_elevation
from lirs_validation.metrics.map import contradicted
from lirs_validation.record.run_record import maps_clouds
from lirs_wct import OccupancyGrid, Trajectory, WctError
from lirs_wct.arrays import ByteArray, FloatArray
from lirs_wct.drawing.canvas import BLUE, VERMILLION, Canvas, bounds_shown, rgb, shaded_heights
from lirs_wct.formats import drive_files, map_server

BUDGET = 3_000_000
"""Bytes of all pictures on the page, encoded."""
MOST_BYTES = 60_000
"""Largest size of one run's encoded picture, bytes."""
TILES = (340, 280, 220, 160)
"""Edges of a panel, pixels; the largest within the budget is used."""
QUALITY = 62
GAP = 8
FINE = 4
"""`cv2.polylines` takes fractions of a pixel as so many bits."""


@dataclass(frozen=True)
class RunPicture:
    """A run's picture as a data URL, empty without a picture; `note` lists missing parts."""

    url: str
    note: str = ""
    name: str = ""


class Painter:
    """Painter of runs with a cache of worlds, since runs come world by world."""

    def __init__(self, runs: int) -> None:
        """Divide the budget among the runs."""
        self._budget = min(MOST_BYTES, BUDGET // max(runs, 1))
        self._scenarios = ScenarioCache()

    def paint(self, run: RunFolder) -> RunPicture:
        """Return the run's picture."""
        try:
            truth, estimate = (
                drive_files.read_tum(run.folder / f"{name}.tum") for name in ("truth", "estimate")
            )
            true_pose, built = map_server.read_map(run.folder / "map_true_pose.yaml"), _read_built_map(run)
        except WctError as error:
            return RunPicture("", str(error))
        if not true_pose.known.any():
            return RunPicture("", "nothing was mapped")
        for tile in TILES:
            picture, note = self._panels(run, (truth, estimate), true_pose, built, tile)
            url = _webp(picture)
            if len(url) <= self._budget:
                return RunPicture(url, note)
        return RunPicture("", "its picture would not fit the page's budget")

    def _panels(
        self,
        run: RunFolder,
        tracks: tuple[Trajectory, Trajectory],
        true_pose: OccupancyGrid,
        built: OccupancyGrid | ElevationMap | None,
        tile: int,
    ) -> tuple[FloatArray, str]:
        """Return the panels side by side, the truth first, and a note on missing parts."""
        truth, estimate = tracks
        world, note = None, ""
        try:
            world = self._scenarios.scenario(recorded_world_config(run.entry)).world
            canvas = Canvas.over(shown_bounds(world, truth, true_pose), tile)
            ground = shaded_heights(world, canvas)
        except WctError as error:
            canvas, note = Canvas.over(bounds_shown(truth, true_pose), tile), f"without its terrain: {error}"
            ground = canvas.grid_picture(true_pose)
        panels = [with_paths(ground, canvas, truth.xy, estimate.xy) / 255.0, canvas.grid_picture(true_pose)]
        if isinstance(built, OccupancyGrid):
            made = canvas.grid_picture(built)
            wrong = contradicted(built, true_pose)
            made[canvas.mark_pixels(wrong, built.resolution, built.origin)] = rgb(VERMILLION)
            panels.append(made)
        elif built is not None and world is not None:
            panels.append(error_picture(canvas, world, built))
        return _beside(panels), note


def _read_built_map(run: RunFolder) -> OccupancyGrid | ElevationMap | None:
    """Read the built map; None for point-cloud mappers in worlds with overhangs."""
    if not maps_clouds(run.entry):
        return map_server.read_map(run.folder / "map.yaml")
    if not (run.folder / ELEVATION).is_file():
        return None
    return read_elevation(run.folder / ELEVATION)[0]


def with_paths(picture: FloatArray, canvas: Canvas, truth: FloatArray, estimate: FloatArray) -> ByteArray:
    """Return a picture with the true and the estimated path, as bytes.

    The picture has levels (rows, cols, 3) in [0, 1], the paths positions (n, 2) in meters.
    """
    painted: ByteArray = np.ascontiguousarray(picture * 255, dtype=np.uint8)
    for track, color, width in ((truth, BLUE, 7), (estimate, VERMILLION, 2)):
        xy = (track - (canvas.bounds[0], canvas.bounds[3])) / (canvas.pixel, -canvas.pixel) - 0.5
        points = np.round(xy * 2**FINE).astype(np.int32)
        shade = tuple(round(255 * c) for c in rgb(color))
        cv2.polylines(painted, [points], False, shade, width, cv2.LINE_AA, FINE)
    return painted


def _beside(panels: Sequence[FloatArray]) -> FloatArray:
    rows = panels[0].shape[0]
    gap = np.ones((rows, GAP, 3))
    return np.concatenate([part for panel in panels for part in (panel, gap)][:-1], axis=1)


def _webp(picture: FloatArray) -> str:
    pixels: ByteArray = np.round(picture[..., ::-1] * 255).astype(np.uint8)
    _, data = cv2.imencode(".webp", pixels, (cv2.IMWRITE_WEBP_QUALITY, QUALITY))
    return "data:image/webp;base64," + base64.b64encode(data.tobytes()).decode()
