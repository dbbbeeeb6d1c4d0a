"""Ground of a world: terrain, laser map or mesh; its solid, its cut-out square."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from lirs_wct.errors import ConfigError
from lirs_wct.geometry import BoolArray, HeightField, OccupancyGrid, WallGrid, sample_surface
from lirs_wct.option import Options, documented, option, positive, within

if TYPE_CHECKING:
    from lirs_wct.geometry.mesh import TriangleMesh

_PANEL: dict[str, Any] = {"panel": "Mesh files"}
DEFAULT_SHARE, LEAST_SHARE = 0.001, 1e-6
"""Default budget of a terrain's mesh files: share of its relief, and least share of its longer side."""


def finite(value: float, label: str) -> None:
    """Check that a number is finite."""
    if not math.isfinite(value):
        raise ConfigError(f"{label} must be finite, got {value}")


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
        check=finite,
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
        "Fewest triangles that stay this near the height field, vertically, everywhere; 0 = all pixels. "
        "Default: 0.1 % of the relief of a terrain, at least a millionth of its longer side.",
        metavar="METERS",
        check=within("[0, inf)", "m"),
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
            raise ConfigError("a draped texture spans the world once: leave out --option texture-size")

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

    def updated(self, new: ExportOptions) -> ExportOptions:
        """Return these options, replaced by new ones where those are set."""
        if new.drape and not (new.texture or self.texture):
            raise ConfigError("--option drape=true lays a picture over the world: give --texture FILE")
        budget = new if (new.max_error, new.max_triangles) != (None, None) else self
        drape = new.drape or (new.texture is None and self.drape and new.texture_size is None)
        return ExportOptions(
            max_error=budget.max_error,
            max_triangles=budget.max_triangles,
            rotate_x=new.rotate_x or self.rotate_x,
            texture=new.texture or self.texture,
            drape=drape,
            wall_texture=new.wall_texture or self.wall_texture,
            texture_size=new.texture_size or (None if drape else self.texture_size),
        )


class Ground:
    """Ground of a world.

    Attributes:
        kind: type of the ground.
        surface: heights from above.
        no_ground: (rows, cols) whether a node of the surface has no ground; None = every node has.
        sample_spacing: Spacing of the source's samples, meters; None = the surface's cell.
        walls: walls of a laser map.
        truth: input map of these walls; None = not known.
        solid: mesh of a mesh ground.
        overhangs: whether that mesh has more than one surface on a vertical line.
    """

    kind: ClassVar[Literal["terrain", "map", "mesh"]]
    surface: HeightField
    no_ground: BoolArray | None = None
    sample_spacing: float | None = None
    walls: WallGrid | None = None
    truth: OccupancyGrid | None = None
    solid: TriangleMesh | None = None
    overhangs: bool = False

    def mesh(self, options: ExportOptions) -> TriangleMesh:
        """Return the ground as a closed solid, heights within the options' budget.

        Walls and a mesh with overhangs are never simplified.
        """
        from lirs_wct.meshing.simplify import simplified_solid
        from lirs_wct.meshing.solid import solid_mesh
        from lirs_wct.meshing.walls import wall_mesh

        if self.walls is not None:
            return wall_mesh(self.walls)
        if options.limited and not self.overhangs:
            return simplified_solid(
                self.surface, max_error=options.max_error, max_triangles=options.max_triangles
            )
        return solid_mesh(self.surface) if self.solid is None else self.solid


@dataclass(frozen=True)
class Terrain(Ground):
    """Ground given by its heights: of a picture, or of an open mesh from above."""

    kind: ClassVar[Literal["terrain"]] = "terrain"
    surface: HeightField
    no_ground: BoolArray | None = None
    sample_spacing: float | None = None


@dataclass(frozen=True)
class LaserMap(Ground):
    """Walls on a level floor."""

    kind: ClassVar[Literal["map"]] = "map"
    surface: HeightField
    walls: WallGrid = field()  # required, other than in the base
    truth: OccupancyGrid | None = None


@dataclass(frozen=True)
class MeshGround(Ground):
    """A mesh and its heights from above.

    Contact with an open mesh is on the front of its faces.
    """

    kind: ClassVar[Literal["mesh"]] = "mesh"
    surface: HeightField
    solid: TriangleMesh = field()
    overhangs: bool = False
    no_ground: BoolArray | None = None


Window = tuple[float, float, float]
"""Center x, y and side, meters."""
FEW_CELLS = 16
"""Cells along a window's side below which it is resampled."""
SAMPLES = 65
"""Nodes along each side of a resampled window."""


def cut_terrain(ground: Ground, window: Window, *, level: bool = True) -> tuple[Terrain, float]:
    """Return a square of a ground, and the height subtracted from it, meters.

    The terrain names the spacing of the samples where the square is resampled.
    """
    whole, no_ground, lift = ground.surface, ground.no_ground, 0.0
    surface = cut_surface(whole, window)
    spacing = max(whole.cell) if surface.cell != whole.cell else None
    if no_ground is not None:
        col, row = (
            np.rint((start + cell * np.arange(n) - first) / step).astype(int)
            for start, cell, n, first, step in zip(
                *(surface.origin, surface.cell, surface.shape[::-1], whole.origin, whole.cell), strict=True
            )
        )
        no_ground = no_ground[np.ix_(whole.shape[0] - 1 - row[::-1], col)]
    if level:
        surface, lift = leveled(surface)
    return Terrain(surface, no_ground, spacing), lift


def cut_surface(surface: HeightField, window: Window) -> HeightField:
    """Keep the nodes of a square (rounded outward), coordinates unchanged.

    A square of few nodes is resampled, because outward rounding could enlarge it by kilometers.
    """
    west, south, east, north = surface.bounds
    (x, y, side), half = window, window[2] / 2
    if x + half <= west or x - half >= east or y + half <= south or y - half >= north:
        raise ConfigError(
            f"window {x:g},{y:g},{side:g} lies outside the terrain: "
            f"x {west:g} to {east:g}, y {south:g} to {north:g} m"
        )
    if side < FEW_CELLS * max(surface.cell):
        bounds = (max(x - half, west), max(y - half, south), min(x + half, east), min(y + half, north))
        return sample_surface(surface, bounds, (SAMPLES, SAMPLES))
    rows, cols = surface.shape
    c0, c1 = _span(x - half - west, x + half - west, surface.cell[0], cols)
    r0, r1 = _span(y - half - south, y + half - south, surface.cell[1], rows)
    z = surface.z[rows - 1 - r1 : rows - r0, c0 : c1 + 1]
    return HeightField(
        np.ascontiguousarray(z), surface.cell, (west + c0 * surface.cell[0], south + r0 * surface.cell[1])
    )


def _span(low: float, high: float, cell: float, count: int) -> tuple[int, int]:
    """Return the first and last node that cover [low, high], at least two nodes."""
    first = min(max(math.floor(low / cell + 1e-9), 0), count - 2)
    last = min(max(math.ceil(high / cell - 1e-9), first + 1), count - 1)
    return first, last


def leveled(surface: HeightField) -> tuple[HeightField, float]:
    """Return a surface lowered to z = 0, and the subtracted height, meters."""
    lowest = surface.z.min()
    return replace(surface, z=surface.z - lowest), float(lowest)
