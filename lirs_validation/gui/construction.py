"""Construction of a world on a page: uploaded files, previews, facts, package."""

from __future__ import annotations

import re
import shutil
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath
from tempfile import TemporaryDirectory

import yaml

from lirs_validation.logs.map_log import resolve_source
from lirs_validation.metrics.world_geometry import mesh_error
from lirs_wct import BuildOptions, SourceError, World, build_world
from lirs_wct.export.package import DEFAULT_FORMATS, GazeboTerrain, write_package
from lirs_wct.formats import MAPS, map_server
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
    """World of a page, its facts, source and options; a preview is coarse, without a package."""

    world: World
    facts: Facts
    source: str
    options: BuildOptions
    package: Path | None = None


def preview(source: str, options: BuildOptions, folder: Path, progress: Progress = no_progress) -> Shown:
    """Return a coarse world of a source; a log is mapped the first time."""
    source = str(resolve_source(source, options, folder / "maps", progress))
    world = preview_world(source, options, PREVIEW_NODES)
    return Shown(world, preview_facts(world), source, options)


def build(
    source: str,
    options: BuildOptions,
    folder: Path,
    formats: Collection[str] = DEFAULT_FORMATS,
    terrain: GazeboTerrain = "solid",
    progress: Progress = no_progress,
) -> Shown:
    """Build a world and write its package to the page's folder, as `lirs-wct build` does."""
    source = str(resolve_source(source, options, folder / "maps", progress))
    progress("build", 0.0)
    world, own = build_world(source, options), folder / "worlds"
    package = write_package(world, own, formats=formats, terrain=terrain, overwrite=True, progress=progress)
    return Shown(world, built_facts(world), source, options, package)


def zip_folder(folder: Path) -> bytes:
    """Return a folder as a zip archive; entries begin with the folder's own name."""
    with TemporaryDirectory() as temporary:
        archive = shutil.make_archive(f"{temporary}/folder", "zip", folder.parent, folder.name)
        return Path(archive).read_bytes()


class Uploads:
    """Folder of one page for its uploads, maps, worlds and runs, removed with the page."""

    def __init__(self) -> None:
        self._temporary = TemporaryDirectory(prefix="lirs-wct-gui-", ignore_cleanup_errors=True)
        self.folder = Path(self._temporary.name) / "map"  # the world of a map.yaml has its folder's name
        self.folder.mkdir()

    def add(self, name: str, content: bytes) -> Path:
        """Keep a file under its name without folders and unsafe characters; another is replaced."""
        path = self.folder / harmless(name)
        if path.suffix.lower() in MAPS:
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
    """Return a map's YAML whose picture is the file of that name beside it."""
    try:
        entry = map_server.map_entries(Path(name), content)
        entry["image"] = harmless(str(entry["image"]))
    except (ValueError, KeyError) as error:
        raise SourceError(f"{name}: is no YAML of a map, which names its image") from error
    return yaml.safe_dump(entry).encode()
