"""Construction of a world on a page: uploaded files, previews, facts, package."""

from __future__ import annotations

import json
import re
import shutil
import warnings
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path, PureWindowsPath
from tempfile import TemporaryDirectory
from typing import Any

import yaml

from lirs_validation.experiment.scenario import DRIVEN_SIDE, is_large
from lirs_validation.logs.map_log import check_log_file, resolve_source
from lirs_validation.metrics.world_geometry import (
    Facts as Facts,
    ground_facts,
    measured_facts,
    unresolved_robots,
)
from lirs_wct import BuildOptions, Progress, SourceError, World, build_world, no_progress
from lirs_wct.export.package import DEFAULT_FORMATS, GazeboTerrain, write_package
from lirs_wct.formats import BAGS, CLOUDS, LOGS, MAPS, MESHES, ZSTD, map_server
from lirs_wct.sources.build import TEXTURES, coarser, preview_world

MAX_STEM_CHARACTERS = 80
"""Largest length of an uploaded file's name, without its suffix."""
JOINED = b"lirs-files "
"""First bytes of several files that the page's script joined; a JSON list of names and sizes follows."""
SITES = (*MESHES, *CLOUDS, *LOGS, *BAGS, ".gz", ZSTD)
"""Suffixes of meshes, point clouds, logs and bags."""
SIDECAR = re.compile(r"\.([bgjpt]\w{1,3}w|wld|prj|xml|ovr|mtl|bin|db3-\w+)")
"""Suffix of a file that another one names or is read with."""
PREVIEW_NODES = 129
"""Nodes of a preview along its longer side."""


def preview_facts(world: World) -> Facts:
    """Return the facts of a world before it is built, and its limits."""
    west, south, east, north = world.surface.bounds
    facts = [("world", f"{world.name} ({world.kind})"), *ground_facts(world)]
    facts.append(("x and y", f"{west:.5g} to {east:.5g} m, {south:.5g} to {north:.5g} m"))
    if is_large(world):
        facts.append(("window", f"a drive takes {DRIVEN_SIDE:g} m around its start, else the middle"))
    if unresolved := unresolved_robots(world):
        facts.append(("samples", f"{world.sample_spacing:.3g} m apart: too far for {', '.join(unresolved)}"))
    return tuple(facts)


@dataclass(frozen=True)
class Shown:
    """World of a page, its facts, source and options; a preview is coarse, without a package."""

    world: World
    facts: Facts
    source: str
    options: BuildOptions
    package: Path | None = None


def preview(
    source: str, options: BuildOptions, folder: Path, progress: Progress = no_progress, **mapping: Any
) -> Shown:
    """Return a coarse world; a log is checked, and mapped the first time."""
    mapped = str(resolve_source(source, options, folder / "maps", progress, **mapping))
    if mapped != source:
        log = check_log_file(source, **mapping)
        for text in (*((log.sentence,) if log.unfit else ()), *(text for _, text in log.notes)):
            warnings.warn(f"{source}: {text}", stacklevel=2)
    world = preview_world(mapped, options)
    return Shown(coarser(world, PREVIEW_NODES), preview_facts(world), mapped, options)


def build(
    source: str,
    options: BuildOptions,
    folder: Path,
    formats: Collection[str] = DEFAULT_FORMATS,
    terrain: GazeboTerrain = "solid",
    progress: Progress = no_progress,
    **mapping: Any,
) -> Shown:
    """Build a world and write its package to the page's folder, as `lirs-wct build` does."""
    source = str(resolve_source(source, options, folder / "maps", progress, **mapping))
    progress("build", 0.0)
    world, own = build_world(source, options), folder / "worlds"
    package = write_package(world, own, formats=formats, terrain=terrain, overwrite=True, progress=progress)
    facts = *preview_facts(world), ("meters", world.scale), *measured_facts(world)
    return Shown(world, facts, source, options, package)


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

    @contextmanager
    def added(self, name: str, content: bytes) -> Iterator[tuple[Sequence[Path], Path | None]]:
        """Keep an upload; yield its main files, and the only picture beside a mesh.

        After an error, the files that it replaced come back.
        """
        files = joined_files(name, content)
        paths = [self.folder / harmless(name) for name, _ in files]
        former = {path: path.read_bytes() for path in paths if path.is_file()}
        try:
            for file in files:
                self.add(*file)
            main, pictures = main_files(paths), [p for p in paths if p.suffix.lower() in TEXTURES]
            is_texture = main[0].suffix.lower() in MESHES and len(pictures) == 1
            yield main, pictures[0] if is_texture else None
        except Exception:
            for path, content in former.items():
                path.write_bytes(content)
            raise

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


def joined_files(name: str, content: bytes) -> list[tuple[str, bytes]]:
    """Return names and contents of files that the page's script joined into one upload."""
    if not content.startswith(JOINED):
        return [(name, content)]
    head, _, rest = content.removeprefix(JOINED).partition(b"\n")
    names, sizes = zip(*json.loads(head), strict=True)
    return [(name, rest[end - n : end]) for name, n, end in zip(names, sizes, accumulate(sizes), strict=True)]


def main_files(paths: Sequence[Path]) -> Sequence[Path]:
    """Return the maps of an upload, else meshes, clouds and logs, else pictures."""
    maps = [path for path in paths if path.suffix.lower() in MAPS]
    sites = [path for path in paths if path.suffix.lower() in SITES]
    return maps or sites or [path for path in paths if not SIDECAR.fullmatch(path.suffix.lower())] or paths


def with_own_picture(name: str, content: bytes) -> bytes:
    """Return a map's YAML whose picture is the file of that name beside it."""
    try:
        entry = map_server.map_entries(Path(name), content)
        entry["image"] = harmless(str(entry["image"]))
    except (ValueError, KeyError) as error:
        raise SourceError(f"{name}: is no YAML of a map, which names its image") from error
    return yaml.safe_dump(entry).encode()
