"""How the mesh files of a world are made: their budget, turn and texture."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from lirs_wct.errors import ConfigError, SourceError
from lirs_wct.formats.images.picture import read_picture
from lirs_wct.validation import require_above

TEXTURE_SUFFIXES = (".png", ".jpg", ".jpeg")
"""What Gazebo and MuJoCo viewers alike can show."""


@dataclass(frozen=True, kw_only=True)
class ExportSettings:
    """Budget, turn and texture of the mesh that is made of a world.

    Attributes:
        max_error: largest vertical deviation of the mesh from the surface, metres; None = the full grid.
        max_triangles: most triangles of the mesh, instead of `max_error`.
        rotate_x: turn of the mesh files about the x axis, degrees.
        texture: picture; None = one drawn from the heights.
        texture_size: metres that the texture spans before it repeats; None = the longest side.

    Raises:
        ConfigError: a value is not legal, or both budgets are given.
    """

    max_error: float | None = None
    max_triangles: int | None = None
    rotate_x: float = 0.0
    texture: Path | None = None
    texture_size: float | None = None

    def __post_init__(self) -> None:
        if self.max_error is not None and self.max_triangles is not None:
            raise ConfigError("both limit the mesh: give one of --max-error, --max-triangles")
        given = (n for n in ("max_error", "max_triangles", "texture_size") if getattr(self, n) is not None)
        require_above(self, 0, *given, finite=True)
        if not math.isfinite(self.rotate_x):
            raise ConfigError(f"x rotation must be finite, got {self.rotate_x} degrees")

    @property
    def limited(self) -> bool:
        """Whether the mesh has a budget."""
        return self.max_error is not None or self.max_triangles is not None


def checked_texture(path: Path | None, max_pixels: int) -> Path | None:
    """Return the path of a texture that can be used.

    Raises:
        SourceError: it is missing, damaged, or neither PNG nor JPEG.
    """
    if path is None:
        return None
    if path.suffix.lower() not in TEXTURE_SUFFIXES:
        raise SourceError(f"{path}: a texture must be a PNG or JPEG picture ({', '.join(TEXTURE_SUFFIXES)})")
    read_picture(path, max_pixels, alpha=True)
    return path
