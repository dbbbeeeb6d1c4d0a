"""Construction of a world on a page: source, options, previews, facts, package."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.logs.map_log import resolve_source
from lirs_validation.metrics.world_geometry import mesh_error
from lirs_wct.export.package import DEFAULT_FORMATS, GazeboTerrain, write_package
from lirs_wct.geometry.heightfield import fewer_nodes
from lirs_wct.ground import Ground, Terrain
from lirs_wct.meshing.ground_texture import checked_texture
from lirs_wct.progress import Progress, no_progress
from lirs_wct.sources.build import READERS, build_world, warn_of_result
from lirs_wct.sources.picture import read_terrain
from lirs_wct.sources.source import BuildOptions, Source, SourceKind, find_source
from lirs_wct.world import World

Facts = tuple[tuple[str, str], ...]
"""Names and values, to be shown as a table."""
PREVIEW_NODES = 129
"""Nodes of a preview along its longer side."""


def preview_facts(world: World) -> Facts:
    """Return the facts of a world before it is built."""
    surface, walls = world.surface, world.walls
    width, depth = surface.size
    relief = ("heights", f"{float(surface.z.min()):.2f} to {float(surface.z.max()):.2f} m")
    if walls is not None:
        cells = f"{int(walls.solid.sum())} cells of {walls.resolution:g} m"
        relief = ("walls", f"{cells}, {walls.height:g} m high")
    return ("world", f"{world.name} ({world.kind})"), ("size", f"{width:.5g} x {depth:.5g} m"), relief


def built_facts(world: World) -> Facts:
    """Return the facts of a built world, with mesh, mesh error and source of scale."""
    (rows, cols), mesh = world.surface.shape, world.file_mesh
    terrain = world.walls is None
    return (
        *preview_facts(world),
        *(() if world.place is None else (("place on earth", world.place.label()),)),
        *((("grid", f"{cols} x {rows} nodes"),) if terrain else ()),
        ("meters", world.scale),
        ("triangles", f"{len(mesh.faces):,}"),
        ("mesh error", f"{mesh_error(world, mesh):.4f} m at the nodes" if terrain else "exact"),
        ("watertight", "yes" if mesh.is_watertight_as_written else "no"),
        ("start poses", str(len(world.spawn_poses))),
    )


@dataclass(frozen=True)
class Shown:
    """A world to look at.

    Attributes:
        world: the world; coarser and without start poses in a preview.
        facts: names and values for the page's table.
        source: source of the world; for a log, its map.
        options: options of its construction.
        package: folder of the package; None for a preview.
    """

    world: World
    facts: Facts
    source: str
    options: BuildOptions
    package: Path | None = None


class Construction:
    """Makes previews and packages of one page's source in the page's folder."""

    def __init__(
        self, folder: Path, nodes: int = PREVIEW_NODES, scenarios: ScenarioCache | None = None
    ) -> None:
        self._folder, self._nodes = folder, nodes
        self._scenarios = scenarios or ScenarioCache()

    def preview(self, source: str, options: BuildOptions, progress: Progress = no_progress) -> Shown:
        """Return a coarse world of a source; a log is mapped the first time.

        Raises:
            WctError: the source or an option cannot be used.
        """
        source = str(resolve_source(source, options, self._folder / "maps", progress))
        found = find_source(source, options)
        ground, scale = self._coarse(found, options)
        for texture in (options.texture, options.wall_texture):
            checked_texture(texture, options.max_pixels)
        world = World(found.name, ground, scale=scale).with_export(options)
        warn_of_result(found, options, world)
        return Shown(world, preview_facts(world), source, options)

    def build(
        self,
        source: str,
        options: BuildOptions,
        formats: Collection[str] = DEFAULT_FORMATS,
        terrain: GazeboTerrain = "solid",
        progress: Progress = no_progress,
    ) -> Shown:
        """Build a world and write its package, as `lirs-wct build` does.

        Raises:
            WctError: the source or an option cannot be used, or the package cannot be written.
        """
        source = str(resolve_source(source, options, self._folder / "maps", progress))
        progress("build", 0.0)
        world = build_world(source, options)
        package = write_package(
            world,
            self._folder / "worlds",
            formats=formats,
            terrain=terrain,
            overwrite=True,  # the folder is the page's own
            progress=progress,
        )
        return Shown(world, built_facts(world), source, options, package)

    def _coarse(self, source: Source, options: BuildOptions) -> tuple[Ground, str]:
        if source.kind is SourceKind.FOLDER:
            world = World.load(source.path)
            return world.ground, world.scale
        ground, scale, _ = READERS[source.kind](source, options)
        if READERS[source.kind] is read_terrain:
            return Terrain(fewer_nodes(ground.surface, self._nodes)), "preview"
        return ground, scale

    def forget(self) -> None:
        """Drop all cached files; a new file may have the name of an old one."""
        self._scenarios.clear()


def zip_folder(folder: Path) -> bytes:
    """Return a folder as a zip archive; entries begin with the folder's own name."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                archive.write(path, Path(folder.name) / path.relative_to(folder))
    return content.getvalue()
