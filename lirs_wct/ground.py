"""The ground of a world: the terrain of a picture, a laser map, or a closed mesh."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

from lirs_wct.arrays import BoolArray
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.geometry.mesh import TriangleMesh
from lirs_wct.geometry.walls import WallGrid
from lirs_wct.meshing.export_options import ExportOptions
from lirs_wct.meshing.simplify import simplified_solid
from lirs_wct.meshing.solid import solid_mesh
from lirs_wct.meshing.wall_solid import wall_mesh


@dataclass(frozen=True)
class Terrain:
    """Ground that is its heights: of a picture, or of an open mesh from above.

    Attributes:
        surface: heights.
        no_ground: (rows, cols) nodes of the surface without ground; None = no such node.
    """

    kind: ClassVar[Literal["terrain"]] = "terrain"
    surface: HeightField
    no_ground: BoolArray | None = None

    def mesh(self, settings: ExportOptions) -> TriangleMesh:
        """Return surface, skirt and base as a closed solid within the settings' budget."""
        return _simplified(self.surface, settings) if settings.limited else solid_mesh(self.surface)


@dataclass(frozen=True)
class LaserMap:
    """Walls on a level floor.

    Attributes:
        surface: the floor.
        walls: cells that stand on it.
        truth: the map that they were taken from; None = it is not known.
    """

    kind: ClassVar[Literal["map"]] = "map"
    surface: HeightField
    walls: WallGrid
    truth: OccupancyGrid | None = None

    def mesh(self, _: ExportOptions) -> TriangleMesh:
        """Return walls, floor and slab as a closed solid, which no budget makes simpler."""
        return wall_mesh(self.walls)


@dataclass(frozen=True)
class ClosedMesh:
    """A closed mesh, with its heights from above.

    Attributes:
        surface: highest points.
        solid: the mesh itself.
        overhangs: whether it is more than its heights from above.
        no_ground: (rows, cols) nodes of the surface where it has no ground; None = no such node.
    """

    kind: ClassVar[Literal["mesh"]] = "mesh"
    surface: HeightField
    solid: TriangleMesh
    overhangs: bool = False
    no_ground: BoolArray | None = None

    def mesh(self, settings: ExportOptions) -> TriangleMesh:
        """Return the mesh, or without overhangs its heights as a solid within the settings' budget."""
        return _simplified(self.surface, settings) if settings.limited and not self.overhangs else self.solid


Ground = Terrain | LaserMap | ClosedMesh


def _simplified(surface: HeightField, settings: ExportOptions) -> TriangleMesh:
    return simplified_solid(surface, max_error=settings.max_error, max_triangles=settings.max_triangles)
