"""Playback of a drive: its state at each scan, and the picture of its map."""

from __future__ import annotations

import math
import zlib
from abc import ABC, abstractmethod
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike

from lirs_validation.gui.session.construction import Facts
from lirs_validation.metrics.alignment import rigid_alignment, rms
from lirs_wct import HeightField, LaserScan, OccupancyGrid, Pose2, Pose3, World
from lirs_wct.arrays import ByteArray, Float32Array, FloatArray
from lirs_wct.drawing.canvas import BLUE, rgb
from lirs_wct.geometry.grid import FREE, OCCUPIED

BLACK, WHITE, UNKNOWN = 0, 254, 205
"""Pixels of occupied, free and unknown cells, as in a map's file."""
LEAST_SCALE = 0.1
"""Smallest error at the upper end of the color scale, meters."""
SIDE = 480
"""Pixels of the longer side."""
DARK = (40, 40, 40)
MARGIN = 1.0
"""Meters around the map."""


@dataclass(frozen=True)
class MapSnapshot:
    """Compressed map at one moment of a drive.

    Attributes:
        time: seconds since the start.
        shape: rows and columns.
        resolution: edge of a cell, meters.
        origin: of the cells in the world frame.
        packed: (rows, cols) pixels of the part that is known, row 0 = south.
    """

    time: float
    shape: tuple[int, int]
    resolution: float
    origin: Pose2
    packed: bytes

    @staticmethod
    def of(grid: OccupancyGrid, time: float) -> MapSnapshot:
        """Compress the known part of a map in the world frame."""
        pixels = np.full(grid.shape, UNKNOWN, np.uint8)
        p = grid.probability
        pixels[p > OCCUPIED] = BLACK
        pixels[p < FREE] = WHITE
        rows, cols = (np.flatnonzero((pixels != UNKNOWN).any(axis=axis)) for axis in (1, 0))
        if len(rows) == 0:
            return MapSnapshot(time, (0, 0), grid.resolution, grid.origin, zlib.compress(b""))
        known = pixels[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
        corner = Pose2(float(cols[0]) * grid.resolution, float(rows[0]) * grid.resolution)
        shape = known.shape[0], known.shape[1]
        return MapSnapshot(
            time, shape, grid.resolution, grid.origin @ corner, zlib.compress(known.tobytes(), 1)
        )

    @property
    def pixels(self) -> ByteArray:
        """(rows, cols) pixels as in a map's file, row 0 = south."""
        return np.frombuffer(zlib.decompress(self.packed), np.uint8).reshape(self.shape)

    @property
    def walls(self) -> FloatArray:
        """(n, 2) centers of the occupied cells, world frame, meters."""
        cells = np.argwhere(self.pixels == BLACK)
        return self.origin.apply((cells[:, ::-1] + 0.5) * self.resolution)

    @property
    def known(self) -> int:
        """Number of known cells."""
        return int((self.pixels != UNKNOWN).sum())


@dataclass(frozen=True)
class Moment:
    """State of a drive at one scan.

    Attributes:
        time: seconds since the start.
        T_world_base: true pose.
        lidar: (3,) position of the lidar, world frame, meters.
        scan: (n, 3) points that the scan hit, world frame, meters.
        truth: (k, 3) true positions until then, world frame, meters.
        estimate: (k, 2) estimated positions until then, world frame.
        map: the latest one; None before the first.
        facts: figures until then.
        verdict: verdict until then, after its heading.
    """

    time: float
    T_world_base: Pose3
    lidar: FloatArray
    scan: Float32Array
    truth: FloatArray
    estimate: FloatArray
    map: MapSnapshot | None
    facts: Facts
    verdict: str

    @property
    def errors(self) -> FloatArray:
        """(k,) distances between true and estimated positions, meters."""
        found: FloatArray = np.linalg.norm(self.truth[:, :2] - self.estimate, axis=1)
        return found


class Playback(ABC):
    """A drive for the page: moments by scan.

    Attributes:
        robot: its name.
        world: world of the drive; None if it is no longer known.
    """

    robot: str
    world: World | None
    _curve: list[tuple[float, float, float]]

    @property
    @abstractmethod
    def scans(self) -> int:
        """Number of scans."""

    @abstractmethod
    def scan_at(self, scan: int) -> tuple[LaserScan, Pose3]:
        """Return a scan and the true pose at it, world frame."""

    @abstractmethod
    def paths_until(self, scan: int) -> tuple[FloatArray, FloatArray]:
        """Return (k, 3) true and (k, 2) estimated positions until a scan, world frame, meters."""

    @abstractmethod
    def map_at(self, time: float) -> MapSnapshot | None:
        """Return the map at a time; None before the first."""

    @abstractmethod
    def facts(self, scan: int, ate: float) -> Facts:
        """Return the figures until a scan; `ate` is the error of the estimate, meters."""

    @abstractmethod
    def rtf_at(self, time: float) -> float:
        """Return the real-time factor of the second that ends at a time; NaN if unknown."""

    @abstractmethod
    def verdict_at(self, scan: int) -> str:
        """Return the verdict until a scan, after its heading."""

    @property
    @abstractmethod
    def marks(self) -> tuple[tuple[float, str], ...]:
        """Seconds and names of events."""

    def curve(self) -> FloatArray:
        """Return (n, 3) time, ATE until then in meters, and RTF, once a second."""
        if self.scans < 2:
            return np.empty((0, 3))
        step = max(1, round(1.0 / (self.scan_at(1)[0].stamp - self.scan_at(0)[0].stamp)))
        for scan in range((len(self._curve) + 1) * step, self.scans, step):
            time, (truth, estimate) = self.scan_at(scan)[0].stamp, self.paths_until(scan)
            self._curve.append((time, ate(truth[:, :2], estimate), self.rtf_at(time)))
        return np.array(self._curve).reshape(-1, 3)

    def moment(self, scan: int) -> Moment:
        """Return the drive at a scan, 0 = before the first motion."""
        reading, T_world_base = self.scan_at(scan)
        truth, estimate = self.paths_until(scan)
        return Moment(
            time=reading.stamp,
            T_world_base=T_world_base,
            lidar=(T_world_base @ reading.T_base_laser).position,
            scan=(T_world_base @ reading.T_base_laser).apply(reading.points).astype(np.float32),
            truth=truth,
            estimate=estimate,
            map=self.map_at(reading.stamp),
            facts=self.facts(scan, ate(truth[:, :2], estimate)),
            verdict=self.verdict_at(scan),
        )


def round_length(length: float) -> float:
    """Return the largest of 1, 2, 5, 10, 20, ... meters up to a length, also below 1."""
    power = 10.0 ** math.floor(math.log10(length))
    return power * max(factor for factor in (1.0, 2.0, 5.0) if factor * power <= length)


def ate(true: FloatArray, estimated: FloatArray) -> float:
    """Return the root mean square error of positions (n, 2) after rigid alignment, meters."""
    aligned = rigid_alignment(estimated, true).apply(estimated)
    return rms(np.linalg.norm(aligned - true, axis=1))


def error_scale(errors: FloatArray) -> float:
    """Return the error at the upper end of the color scale, meters."""
    return max(LEAST_SCALE, float(errors.max()))


def error_colors(errors: FloatArray) -> ByteArray:
    """Return (k, 3) RGB colors of errors: dark violet for 0, yellow for the largest."""
    levels = np.clip(255 * errors / error_scale(errors), 0, 255).astype(np.uint8)
    colors: ByteArray = cv2.applyColorMap(levels[:, None], cv2.COLORMAP_PLASMA)[:, 0, ::-1]
    return colors


def ground_point(surface: HeightField, origin: ArrayLike, direction: ArrayLike) -> tuple[float, float] | None:
    """Return x, y in whole centimeters where a ray first meets the ground; None if it misses."""
    begin, along = np.asarray(origin, np.float64), np.asarray(direction, np.float64)
    west, south, east, north = surface.bounds
    middle = (west + east) / 2, (south + north) / 2, float(surface.z.min())
    reach = float(np.linalg.norm(begin - middle)) + math.hypot(east - west, north - south)
    steps = np.arange(0.0, reach, min(surface.cell) / 2)
    points = begin + steps[:, None] * along
    below = np.flatnonzero(points[:, 2] <= surface.height_at(points[:, 0], points[:, 1]))
    if len(below) == 0 or below[0] == 0:
        return None
    x, y = points[below[0], :2].tolist()
    return round(x, 2), round(y, 2)


def map_picture(moment: Moment) -> ByteArray:
    """Return (rows, cols, 3) RGB of the map, north up, with both paths and a scale bar.

    The true path is blue, the estimated one has the colors of its errors.
    """
    found = moment.map
    if found is None or not found.known:
        return np.full((SIDE, SIDE, 3), UNKNOWN, np.uint8)
    rows, cols = found.shape
    corners = found.origin.apply(
        [(x * cols * found.resolution, y * rows * found.resolution) for x in (0, 1) for y in (0, 1)]
    )
    low, high = corners.min(axis=0) - MARGIN, corners.max(axis=0) + MARGIN
    scale = SIDE / float((high - low).max())
    width, height = (math.ceil(side * scale) for side in (high - low).tolist())
    picture = _draw_cells(found.pixels, found.origin, found.resolution, low, scale, (width, height))
    walls = _pixels(found.walls, low, scale, height)  # thinner than a pixel, yet important
    picture[np.clip(walls[:, 1], 0, height - 1), np.clip(walls[:, 0], 0, width - 1)] = BLACK
    points = _pixels(moment.truth[:, :2], low, scale, height)
    cv2.polylines(picture, [points], False, [int(255 * v) for v in rgb(BLUE)], 2, cv2.LINE_AA)
    few = slice(None, None, max(1, len(moment.estimate) // SIDE))
    points, colors = _pixels(moment.estimate[few], low, scale, height), error_colors(moment.errors)[few]
    for begin, end, color in zip(points[:-1].tolist(), points[1:].tolist(), colors.tolist(), strict=False):
        cv2.line(picture, begin, end, color, 2, cv2.LINE_AA)
    _draw_scale(picture, scale)
    return picture


def _draw_scale(picture: ByteArray, scale: float) -> None:
    """Draw a scale bar with its length, and N at the north edge."""
    length = round_length(picture.shape[1] / scale / 4)
    begin, y = 10, picture.shape[0] - 10
    cv2.line(picture, (begin, y), (begin + round(length * scale), y), DARK, 3)
    cv2.putText(picture, f"{length:g} m", (begin, y - 6), cv2.FONT_HERSHEY_SIMPLEX, 0.5, DARK, 1, cv2.LINE_AA)
    cv2.putText(picture, "N ^", (10, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.5, DARK, 1, cv2.LINE_AA)


def _draw_cells(
    pixels: ByteArray, origin: Pose2, resolution: float, low: FloatArray, scale: float, size: tuple[int, int]
) -> ByteArray:
    """Return the cells in world orientation, in a picture of the given size."""
    width, height = size
    c, s = math.cos(origin.yaw) * resolution * scale, math.sin(origin.yaw) * resolution * scale
    x, y = (origin.x - low[0]) * scale, (origin.y - low[1]) * scale
    onto = np.array(((c, -s, x), (-s, -c, height - 1 - y)))
    drawn = cv2.warpAffine(
        pixels,
        onto,
        (width, height),
        flags=cv2.INTER_NEAREST,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=UNKNOWN,
    )
    return np.repeat(drawn[..., None], 3, axis=-1).astype(np.uint8)


def _pixels(
    path: FloatArray, low: FloatArray, scale: float, height: int
) -> np.ndarray[tuple[int, ...], np.dtype[np.int32]]:
    at = (path - low) * scale
    return np.stack((at[:, 0], height - 1 - at[:, 1]), axis=-1).round().astype(np.int32)
