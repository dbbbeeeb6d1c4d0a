"""Options of a world's mesh files: budget, rotation and texture."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from lirs_wct.errors import ConfigError
from lirs_wct.geometry import HeightField
from lirs_wct.option import Options, documented, option, positive

_PANEL: dict[str, Any] = {"panel": "Mesh files"}


DEFAULT_SHARE, LEAST_SHARE = 0.001, 1e-6
"""Default budget of a terrain's mesh files: share of its relief, and least share of its longer side."""


def _budget(value: float, _: str) -> None:
    if not 0 <= value < math.inf:
        raise ConfigError(f"max error must be a finite number of meters, 0 or above, got {value}")


def _finite_turn(value: float, _: str) -> None:
    if not math.isfinite(value):
        raise ConfigError(f"x rotation must be finite, got {value} degrees")


@dataclass(frozen=True, kw_only=True)
class RotationOptions(Options):
    """Rotation of mesh files."""

    rotate_x: float = option(
        0.0,
        "Rotate the mesh files about the x axis. 0 is upright in every consumer. The paper's tool writes "
        "its Z-up STL into a Y-up Collada, which needs its default rotation of -90 to be upright; 0 gives "
        "the same result here.",
        title="x axis rotate",
        metavar="DEG",
        check=_finite_turn,
        **_PANEL,
    )


@documented
@dataclass(frozen=True, kw_only=True)
class ExportOptions(RotationOptions):
    """Budget, rotation and texture of a world's mesh files.

    Raises:
        ConfigError: a value is not legal, both budgets are given, or a draped texture has a size.
    """

    max_error: float | None = option(
        None,
        "Fewest triangles that stay this near the height field, vertically, everywhere; 0 = all "
        "pixels. "
        "Default: 0.1 % of the relief of a terrain, at least a millionth of its longer side.",
        metavar="METERS",
        check=_budget,
        **_PANEL,
    )
    max_triangles: int | None = option(
        None,
        "The best mesh of so many triangles, instead of --max-error.",
        check=positive,
        rare=True,
        **_PANEL,
    )
    texture: Path | None = option(
        None,
        "PNG or JPEG texture, projected from the sides of a cube and repeated; of a laser map, its floor's. "
        "Default: drawn.",
        metavar="FILE",
        **_PANEL,
    )
    drape: bool = option(
        False,
        "Lay --texture over the world from above, once, its top edge in the north: an orthophoto.",
        rare=True,
        **_PANEL,
    )
    wall_texture: Path | None = option(
        None,
        "PNG or JPEG texture of a laser map's walls, as high as they are. Default: drawn.",
        metavar="FILE",
        rare=True,
        **_PANEL,
    )
    texture_size: float | None = option(
        None,
        "Side of the texture before it repeats; default: the longest side, once.",
        metavar="METERS",
        check=positive,
        rare=True,
        **_PANEL,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.max_error is not None and self.max_triangles is not None:
            raise ConfigError("both limit the mesh: give one of the options max-error, max-triangles")
        if self.drape and self.texture_size is not None:
            raise ConfigError("a draped texture spans the world once: leave out the option texture-size")

    @property
    def limited(self) -> bool:
        """Whether a budget is set."""
        return bool(self.max_error) or self.max_triangles is not None

    def with_default(self, surface: HeightField) -> ExportOptions:
        """Return the options with the default budget of a terrain if none is set.

        The share of the longer side, 50 micrometers of 50 m, keeps flat ground at two triangles.
        """
        if self.limited or self.max_error == 0:
            return self
        return replace(self, max_error=max(DEFAULT_SHARE * surface.relief, LEAST_SHARE * max(surface.size)))

    def updated(self, given: ExportOptions) -> ExportOptions:
        """Return these options, replaced by the given ones where those are set.

        Raises:
            ConfigError: `drape` is set without a texture.
        """
        if given.drape and not (given.texture or self.texture):
            raise ConfigError("--option drape=true lays a picture over the world: give --texture FILE")
        budget = given.max_error, given.max_triangles
        if budget == (None, None):
            budget = self.max_error, self.max_triangles
        kept = given.texture is None and self.drape and given.texture_size is None
        drape = given.drape or kept
        return ExportOptions(
            max_error=budget[0],
            max_triangles=budget[1],
            rotate_x=given.rotate_x or self.rotate_x,
            texture=given.texture or self.texture,
            drape=drape,
            wall_texture=given.wall_texture or self.wall_texture,
            texture_size=given.texture_size or (None if drape else self.texture_size),
        )
