"""ROS maps: a YAML and a picture, read and written as map_server and nav2 do."""

from __future__ import annotations

import codecs
import math
import warnings
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from lirs_wct.errors import SourceError, reason_of
from lirs_wct.files import atomic_write
from lirs_wct.formats.picture import MAX_PIXELS, read_picture
from lirs_wct.formats.yaml_text import load_yaml
from lirs_wct.geometry import FREE, OCCUPIED, FloatArray, OccupancyGrid, Pose2

Entry = str | list[str]
"""A value in a map's YAML, not yet read as number."""
MODES = ("trinary", "scale", "raw")
SWITCHES = dict.fromkeys(("true", "yes", "y", "on"), "1") | dict.fromkeys(("false", "no", "n", "off"), "0")
MAX_RESOLUTION = 1000.0
"""Meters of a cell's edge: a map of robots has cells of centimeters."""
MAX_COORDINATE = 1e9
"""Meters of an origin's coordinates at most; farther ones cannot tell cells apart."""
BLACK, WHITE, UNKNOWN = 0, 254, 205
"""Pixels of occupied, free and unknown cells, as map_saver writes them."""
WRITTEN_FREE = 0.196
"""`free_thresh` that keeps a pixel of 205 (p = 0.19608) unknown."""
LUMA = (114, 587, 299)
"""Thousandths of blue, green and red in the gray of a color (Rec. 601)."""
LEVELS = np.arange(256, dtype=np.uint8)[None, :]
"""Every 8-bit pixel value: a look-up table converts large maps fast."""


@dataclass(frozen=True, kw_only=True)
class MapMetadata:
    """Metadata of a map's YAML; see the ROS package map_server."""

    image: Path
    resolution: float
    origin: Pose2
    occupied_thresh: float = OCCUPIED
    free_thresh: float = WRITTEN_FREE
    negate: bool = False
    mode: str = "trinary"

    def __post_init__(self) -> None:
        if not 0 < self.resolution <= MAX_RESOLUTION:
            raise ValueError(
                f"resolution must be a finite number above 0, at most {MAX_RESOLUTION:g} m, "
                f"got {self.resolution}"
            )
        origin = self.origin
        if not max(abs(origin.x), abs(origin.y)) <= MAX_COORDINATE:
            raise ValueError(f"origin must lie within {MAX_COORDINATE:g} m, got {origin.x:g}, {origin.y:g}")
        if self.mode not in MODES:
            raise ValueError(f"unknown mode {self.mode!r}; legal: {', '.join(MODES)}")
        free, occupied = self.free_thresh, self.occupied_thresh
        if not (0 <= free <= 1 and 0 <= occupied <= 1):
            raise ValueError(
                f"thresholds must be from 0 to 1, got free_thresh {free} and occupied_thresh {occupied}"
            )


KEYS = [field.name for field in fields(MapMetadata)]


def read_map(path: Path, max_pixels: int = MAX_PIXELS) -> OccupancyGrid:
    """Read a map YAML and its picture."""
    metadata = read_metadata(path)
    try:
        there = metadata.image.is_file()
    except OSError as error:  # such as a name that is too long
        raise SourceError(f"{path}: its image {metadata.image} {reason_of(error)}") from error
    if not there:
        raise SourceError(f"{path}: its image {metadata.image} is not there")
    free, occupied = metadata.free_thresh, metadata.occupied_thresh
    if occupied < free:
        warnings.warn(
            f"{path}: occupied_thresh {occupied} is below free_thresh {free}; free wins as in nav2",
            stacklevel=2,
        )
    return _grid(metadata, max_pixels)


def read_map_picture(path: Path, resolution: float, max_pixels: int = MAX_PIXELS) -> OccupancyGrid:
    """Read a map's picture without YAML, by map_server's default thresholds."""
    return _grid(MapMetadata(image=path, resolution=resolution, origin=Pose2()), max_pixels)


def read_metadata(path: Path) -> MapMetadata:
    """Read a map YAML."""
    try:
        entry = map_entries(path, path.read_bytes())
        missing = [key for key in ("image", "resolution", "origin") if key not in entry]
        if missing:
            raise ValueError(f"a map needs image, resolution and origin, this has no {', '.join(missing)}")
        origin: list[float] = []
        with suppress(ValueError):
            origin = [float(item) for item in entry["origin"] if isinstance(entry["origin"], list)]
        if len(origin) not in (2, 3) or not all(map(math.isfinite, origin)):
            raise ValueError(f"origin must be [x, y, yaw], got {entry['origin']!r}")
        return MapMetadata(
            image=path.parent / str(entry["image"]),
            resolution=_number(entry, "resolution", math.nan),
            origin=Pose2(*origin),
            occupied_thresh=_number(entry, "occupied_thresh", OCCUPIED),
            free_thresh=_number(entry, "free_thresh", WRITTEN_FREE),
            negate=bool(_number(entry, "negate", 0.0)),
            mode=str(entry.get("mode", "trinary")).lower(),
        )
    except OSError as error:
        raise SourceError(f"{path}: {error.strerror}") from error
    except ValueError as error:
        raise SourceError(f"{path}: {error}") from error


def write_map(stem: Path, grid: OccupancyGrid) -> None:
    """Write `stem.pgm` and `stem.yaml`, trinary; the same grid gives the same bytes."""
    p = grid.probability
    pixels = np.full(grid.shape, UNKNOWN, np.uint8)
    pixels[p > OCCUPIED] = BLACK
    pixels[p < FREE] = WHITE
    pgm, yaml = stem.with_name(f"{stem.name}.pgm"), stem.with_name(f"{stem.name}.yaml")
    with atomic_write(pgm) as path:
        rows, cols = grid.shape
        path.write_bytes(b"P5\n%d %d\n255\n" % (cols, rows) + pixels[::-1].tobytes())
    with atomic_write(yaml) as path:
        path.write_text(
            f"image: {pgm.name}\nmode: trinary\nresolution: {float(grid.resolution)!r}\n"
            f"origin: [{', '.join(map(repr, grid.origin.as_array().tolist()))}]\n"
            f"negate: 0\noccupied_thresh: {OCCUPIED}\nfree_thresh: {WRITTEN_FREE}\n",
            encoding="utf-8",
        )


def _grid(metadata: MapMetadata, max_pixels: int) -> OccupancyGrid:
    picture = read_picture(metadata.image, max_pixels, alpha=True)
    pixels, full = picture.pixels[::-1], picture.full
    level = pixels[..., :3] @ LUMA / 1000 if pixels.ndim == 3 else pixels
    graded = pixels.dtype.kind in "iu"
    if graded and (pixels.ndim == 3 or full != 255):
        # As GraphicsMagick, which nav2 uses: a gray of 16 bits is cut to 8, not rounded.
        level = (np.rint(level * (65535 / full)) // 257).clip(0, 255).astype(np.uint8)
    p = _probability(LEVELS / 255 if graded else level / full, metadata)
    grid = OccupancyGrid.from_probability(p, metadata.resolution, metadata.origin)
    if graded:
        grid = replace(grid, log_odds=grid.log_odds[0][level])
    if pixels.shape[2:] == (4,) and metadata.mode != "raw":
        grid.log_odds[pixels[..., 3] < full] = np.nan
    if pixels.ndim == 3 and metadata.mode == "trinary":
        _warn_of_averages(metadata, pixels.mean(axis=2) / full, grid)
    return grid


def _probability(shade: FloatArray, metadata: MapMetadata) -> FloatArray:
    """Return the probabilities of opaque shades, NaN = unknown; 0 is black, 1 white."""
    if metadata.mode == "raw":
        value = np.round(shade * 255)
        return np.where(value <= 100, value / 100, np.nan)
    # nav2 compares in 32 bits; a shade at a threshold is beyond it, and free wins where both apply.
    single = shade.astype(np.float32)
    p, single = (shade, single) if metadata.negate else (1 - shade, 1 - single)
    span = metadata.occupied_thresh - metadata.free_thresh
    scaled = metadata.mode == "scale" and span > 0
    between = (p - metadata.free_thresh) / span if scaled else np.full(p.shape, np.nan)
    known = np.where(single >= np.float32(metadata.occupied_thresh), 1.0, between)
    return np.where(single <= np.float32(metadata.free_thresh), 0.0, known)


def _warn_of_averages(metadata: MapMetadata, shade: FloatArray, grid: OccupancyGrid) -> None:
    """Warn where the older rule, the mean of all channels with alpha, differs."""
    p = shade if metadata.negate else 1 - shade
    occupied = p > metadata.occupied_thresh
    free = (p < metadata.free_thresh) & ~occupied
    if (occupied != grid.occupied).any() or (free != grid.free).any():
        warnings.warn(
            f"{metadata.image}: {grid.occupied.sum():,} occupied and {grid.free.sum():,} free cells, as in "
            f"nav2 since Jazzy (transparent is unknown); {occupied.sum():,} and {free.sum():,} in Humble and "
            "ROS 1, which average alpha with the colors",
            stacklevel=4,
        )


def map_entries(path: Path, content: bytes) -> dict[str, Entry]:
    """Return the entries of a map's YAML; the first of two keys counts.

    Scalars are text: `1e-2` can become a number and a date can be a file name.
    """
    wide = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        text = content.decode("utf-16" if wide else "utf-8")
    except UnicodeDecodeError:  # yaml-cpp refuses no byte; umlauts of Windows are the usual case
        text = content.decode("cp1252", errors="replace")
    pairs = load_yaml(text, typed=False)
    if not isinstance(pairs, list) or not all(isinstance(pair, tuple) for pair in pairs):
        raise ValueError("line 1 is not `key: value`")
    entry: dict[str, Entry] = {}
    for key, value in pairs:
        if key not in KEYS:
            continue
        if not all(isinstance(item, str) for item in value):
            raise ValueError(f"{key}: a map has no use for nested values")
        first = entry.setdefault(key, value)
        if first != value:
            warnings.warn(f"{path}: {key} stands twice; the first is taken: {first!r}", stacklevel=2)
    return entry


def _number(entry: dict[str, Entry], key: str, default: float) -> float:
    value = entry.get(key, str(default))
    words = SWITCHES if key == "negate" else {}
    if isinstance(value, str):
        with suppress(ValueError):
            return float(words.get(value.lower(), value))
    raise ValueError(f"{key} must be a number, got {value!r}")
