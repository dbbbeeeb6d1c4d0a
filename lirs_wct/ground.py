"""Types of ground: terrain of a picture, laser map, mesh."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import ClassVar, Literal

from lirs_wct.geometry import BoolArray, HeightField, OccupancyGrid, WallGrid
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.meshing.export_options import ExportOptions
from lirs_wct.meshing.simplify import simplified_solid
from lirs_wct.meshing.solid import solid_mesh, wall_mesh


class Ground(ABC):
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

    @abstractmethod
    def mesh(self, settings: ExportOptions) -> TriangleMesh:
        """Return the ground as a closed solid within the settings' budget."""


@dataclass(frozen=True)
class Terrain(Ground):
    """Ground given by its heights: of a picture, or of an open mesh from above."""

    kind: ClassVar[Literal["terrain"]] = "terrain"
    surface: HeightField
    no_ground: BoolArray | None = None
    sample_spacing: float | None = None

    def mesh(self, settings: ExportOptions) -> TriangleMesh:
        """Return surface, skirt and base as a closed solid within the settings' budget."""
        return _simplify(self.surface, settings) if settings.limited else solid_mesh(self.surface)


@dataclass(frozen=True)
class LaserMap(Ground):
    """Walls on a level floor."""

    kind: ClassVar[Literal["map"]] = "map"
    surface: HeightField
    walls: WallGrid = field()  # required, other than in the base
    truth: OccupancyGrid | None = None

    def mesh(self, _: ExportOptions) -> TriangleMesh:
        """Return walls, floor and slab as a closed solid, never simplified."""
        return wall_mesh(self.walls)


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

    def mesh(self, settings: ExportOptions) -> TriangleMesh:
        """Return the mesh; with a budget and without overhangs, its simplified heights."""
        return _simplify(self.surface, settings) if settings.limited and not self.overhangs else self.solid


def _simplify(surface: HeightField, settings: ExportOptions) -> TriangleMesh:
    return simplified_solid(surface, max_error=settings.max_error, max_triangles=settings.max_triangles)
