"""Everything that a user may say about how a source becomes a world."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from lirs_wct.errors import ConfigError
from lirs_wct.pose import Pose2

DEFAULT_SIZE = 50.0
"""Longer side in metres of a picture that brings no scale."""
DEFAULT_HEIGHT = 6.0
"""Relief in metres of a picture that brings no scale."""


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
        resolution: metres a cell, for a map picture without YAML.
        origin: pose of the lower-left corner of a map picture without YAML.
        wall_height: height of a laser map's walls, metres.
        window: keep only a square: centre x, y and side, metres, in the world's frame.
        max_pixels: refuse pictures with more, read from the header.

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
    window: tuple[float, float, float] | None = None
    max_pixels: int = 5000 * 5000

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
        ):
            if value is not None and not 0 < value < float("inf"):
                raise ConfigError(f"{option} must be a finite number above 0, got {value}")
        if self.size is not None and self.pixel_size is not None:
            raise ConfigError("size and pixel size both set the extent: give one of --size, --pixel-size")
