"""Construction of a world on a page: uploaded files, previews, facts, package."""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath
from tempfile import TemporaryDirectory

import yaml

from lirs_validation.logs.map_log import resolve_source
from lirs_validation.metrics.world_geometry import mesh_error
from lirs_wct import BuildOptions, SourceError, World, build_world
from lirs_wct.export.package import DEFAULT_FORMATS, GazeboTerrain, write_package
from lirs_wct.formats import map_server, suffixes
from lirs_wct.progress import Progress, no_progress
from lirs_wct.sources.build import preview_world

Facts = tuple[tuple[str, str], ...]
"""Names and values, to be shown as a table."""
MAX_STEM_CHARACTERS = 80
"""Largest length of an uploaded file's name, without its suffix."""
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

    def __init__(self, folder: Path, nodes: int = PREVIEW_NODES) -> None:
        self._folder, self._nodes = folder, nodes

    def preview(self, source: str, options: BuildOptions, progress: Progress = no_progress) -> Shown:
        """Return a coarse world of a source; a log is mapped the first time.

        Raises:
            WctError: the source or an option cannot be used.
        """
        source = str(resolve_source(source, options, self._folder / "maps", progress))
        world = preview_world(source, options, self._nodes)
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


def zip_folder(folder: Path) -> bytes:
    """Return a folder as a zip archive; entries begin with the folder's own name."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                archive.write(path, Path(folder.name) / path.relative_to(folder))
    return content.getvalue()


class Uploads:
    """Files of one page, in a folder that is removed with the page.

    Attributes:
        folder: Folder of the page, also for its maps, worlds and runs.
    """

    def __init__(self) -> None:
        self._temporary = TemporaryDirectory(prefix="lirs-wct-gui-", ignore_cleanup_errors=True)
        self.folder = Path(self._temporary.name)

    def add(self, name: str, content: bytes) -> Path:
        """Keep a file under its name without folders and unsafe characters; another is replaced.

        Raises:
            SourceError: A YAML is not that of a map.
        """
        path = self.folder / harmless(name)
        if path.suffix.lower() in suffixes.MAPS:
            content = with_own_picture(path.name, content)
        path.write_bytes(content)
        return path

    def close(self) -> None:
        """Remove the folder."""
        self._temporary.cleanup()


def harmless(name: str) -> str:
    """Return a file's own name without folders, of letters, digits, dots, hyphens and underscores.

    >>> harmless("../../etc/my map.YAML")
    'my_map.YAML'
    """
    last = PureWindowsPath(name).name  # takes both kinds of slashes
    stem, dot, suffix = re.sub(r"[^A-Za-z0-9_.-]+", "_", last).rpartition(".")
    return f"{stem.strip('._-')[:MAX_STEM_CHARACTERS] or 'file'}{dot}{suffix[:10]}"


def with_own_picture(name: str, content: bytes) -> bytes:
    """Return a map's YAML whose picture is the file of that name beside it.

    Raises:
        SourceError: it is not the YAML of a map.
    """
    try:
        entry = map_server.map_entries(Path(name), content)
        entry["image"] = harmless(str(entry["image"]))
    except (ValueError, KeyError) as error:
        raise SourceError(f"{name}: is no YAML of a map, which names its image") from error
    return yaml.safe_dump(entry).encode()
