"""Everything that a user may say about how a source becomes a world."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from lirs_wct.errors import ConfigError, unknown_name
from lirs_wct.formats.images.header import MAX_PIXELS
from lirs_wct.geometry.pose import Pose2

DEFAULT_SIZE = 50.0
"""Longer side in metres of a picture that brings no scale."""
DEFAULT_HEIGHT = 6.0
"""Relief in metres of a picture that brings no scale."""

Unknown = Literal["floor", "wall", "hole"]
UNKNOWN: tuple[Unknown, ...] = ("floor", "wall", "hole")
DENOISE_METHODS = ("median", "bilateral")
MAX_SIDE = 32_000
"""Pixels along a side to which a picture may be resized."""


@dataclass(frozen=True, kw_only=True)
class BuildOptions:
    """How a source becomes a world; None means "as the source says, else the default".

    Attributes:
        name: name of the world; default: the source's stem.
        kind: read a picture as terrain (`picture`) or as laser map (`map`).
        size: extent of a picture, metres: its longer side, or width and height.
        pixel_size: metres a pixel, instead of `size`.
        height: relief of a picture, metres.
        grayscale: turn a colour picture into gray.
        invert: black is high.
        resolution: metres a cell, for a map picture without YAML or the map of a log, or between the
            heights read off a mesh.
        origin: pose of the lower-left corner of a map picture without YAML.
        wall_height: height of a laser map's walls, metres.
        unknown: what the unknown cells of a laser map are; a hole has no floor.
        speckle: walls of fewer connected cells are dropped from a laser map.
        window: keep only a square: centre x, y and side, metres, in the world's frame.
        max_pixels: refuse pictures with more, read from the header.
        crop: keep only a rectangle of the picture: column, row, width and height, pixels.
        resize: resample the picture to this width and height, pixels; its metres stay.
        deterrace: remove the stairs of a coarse gray scale (within half a level of every pixel).
        denoise: filter against single wrong pixels (`median`) or noise beside edges (`bilateral`).
        smoothing: standard deviation of a Gaussian blur, pixels.
        sharpness: amount of an unsharp mask, applied after smoothing.
        z_scale: multiplies the heights that the rest gives.
        scale: multiplies the width, depth and height that the rest gives.
        rotate_x: turn of the mesh files about the x axis, degrees; 0 is upright in every consumer.
        max_error: largest vertical deviation of the mesh from the surface, metres.
        max_triangles: most triangles of the mesh, instead of `max_error`.
        texture: picture (PNG or JPEG) that the mesh wears; default: one drawn from its heights.
        texture_size: metres that the texture spans before it repeats; default: the longest side.
        log_mapper: name of the mapper that turns a laser log into a map.

    Raises:
        ConfigError: a value is not legal, or two options contradict.
    """

    name: str | None = None
    kind: Literal["picture", "map"] | None = None
    size: float | tuple[float, float] | None = None
    pixel_size: float | None = None
    height: float | None = None
    grayscale: bool = False
    invert: bool = False
    resolution: float | None = None
    origin: Pose2 | None = None
    wall_height: float = 2.5
    unknown: Unknown = "floor"
    speckle: int = 0
    window: tuple[float, float, float] | None = None
    max_pixels: int = MAX_PIXELS
    crop: tuple[int, int, int, int] | None = None
    resize: tuple[int, int] | None = None
    deterrace: bool = False
    denoise: Literal["median", "bilateral"] | None = None
    smoothing: float | None = None
    sharpness: float | None = None
    z_scale: float | None = None
    scale: tuple[float, float, float] | None = None
    rotate_x: float = 0.0
    max_error: float | None = None
    max_triangles: int | None = None
    texture: Path | None = None
    texture_size: float | None = None
    log_mapper: str = "cartographer"

    def __post_init__(self) -> None:
        sizes = self.size if isinstance(self.size, tuple) else (self.size,)
        for option, value in (
            *(("size", s) for s in sizes),
            ("pixel size", self.pixel_size),
            ("height", self.height),
            ("resolution", self.resolution),
            ("wall height", self.wall_height),
            ("window side", self.window[2] if self.window else None),
            ("max pixels", self.max_pixels),
            ("smoothing", self.smoothing),
            ("sharpness", self.sharpness),
            ("z scale", self.z_scale),
            *(("scale", s) for s in self.scale or ()),
            ("max error", self.max_error),
            ("max triangles", self.max_triangles),
            ("texture size", self.texture_size),
        ):
            if value is not None and not 0 < value < float("inf"):
                raise ConfigError(f"{option} must be a finite number above 0, got {value}")
        if self.size is not None and self.pixel_size is not None:
            raise ConfigError("size and pixel size both set the extent: give one of --size, --pixel-size")
        if self.max_error is not None and self.max_triangles is not None:
            raise ConfigError("both limit the mesh: give one of --max-error, --max-triangles")
        if self.unknown not in UNKNOWN:
            raise unknown_name("kind of unknown cell", self.unknown, UNKNOWN)
        if self.speckle < 0:
            raise ConfigError(f"speckle must be 0 or more cells, got {self.speckle}")
        if self.denoise not in (None, *DENOISE_METHODS):
            raise unknown_name("denoise method", self.denoise, DENOISE_METHODS)
        if self.crop is not None and (min(self.crop[:2]) < 0 or min(self.crop[2:]) < 2):
            raise ConfigError(f"crop needs a corner at 0,0 or beyond and at least 2x2 px, got {self.crop}")
        if self.resize is not None and not all(2 <= n <= MAX_SIDE for n in self.resize):
            raise ConfigError(f"resize needs 2 to {MAX_SIDE} px a side, got {self.resize}")
        if not math.isfinite(self.rotate_x):
            raise ConfigError(f"x rotation must be finite, got {self.rotate_x} degrees")
