"""Worlds of the benchmark's tasks: bundled, generated, or built from files known by digest."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from lirs_envs.episodes.world_cache import cached_world
from lirs_envs.generators.arena import ArenaConfig, arena
from lirs_envs.generators.floor_plan import floor_plan
from lirs_envs.generators.natural import EDGE, NATURAL_TERRAINS, NODES, fractal, with_rocks
from lirs_envs.generators.terrain import KINDS, generate
from lirs_wct import BuildOptions, ConfigError, HeightField, SourceError, World, build_world, unknown_name
from lirs_wct.arrays import FloatArray
from lirs_wct.checks import check_seed
from lirs_wct.files import digest
from lirs_wct.ground import Terrain
from lirs_wct.sources.bundled import RECIPES

CELL = EDGE / (NODES - 1)
"""Spacing of a natural terrain's nodes, meters."""


@dataclass(frozen=True, kw_only=True)
class FileSpec:
    """A file that is not part of this package.

    Attributes:
        sha256: digest of its content, hexadecimal.
        size: bytes.
        origin: repository and path of the file.
    """

    sha256: str
    size: int
    origin: str


@dataclass(frozen=True, kw_only=True)
class WorldSpec:
    """Recipe of a world.

    Attributes:
        name: name in its set.
        maker: one of `MAKERS`, or `files`.
        options: names and values of the maker's options.
        files: external input files, the source first.
    """

    name: str
    maker: str
    options: tuple[tuple[str, Any], ...] = ()
    files: tuple[FileSpec, ...] = ()

    def world(self, data: Path | None) -> World:
        """Make the world, of files in a folder where they do not ship.

        Raises:
            SourceError: a file is missing or cannot be used.
        """
        if not self.files:
            return _make_world(self.name, self.maker, self.options)
        return _from_files(tuple(self.places(data)), self.options)

    def places(self, data: Path | None) -> list[Path]:
        """Return the paths of its files."""
        found = [_find(file, data) for file in self.files]
        for file, path in zip(self.files, found, strict=True):
            if path is None:
                where = "no --data folder is given" if data is None else f"{data} does not hold it"
                raise SourceError(f"{self.name}: {where}: {file.origin} (sha256 {file.sha256[:12]}...)")
        return [path for path in found if path is not None]

    def describe(self) -> dict[str, Any]:
        """Return the JSON value."""
        entry: dict[str, Any] = {"maker": self.maker} | dict(self.options)
        return entry | ({"files": [vars(file) for file in self.files]} if self.files else {})


def read_world(name: str, entry: Mapping[str, Any]) -> WorldSpec:
    """Return a world of its JSON value (see `WorldSpec.describe`).

    Options of the maker `files` are those of `BuildOptions`.
    """
    options = dict(entry)
    maker, files = str(options.pop("maker")), options.pop("files", [])
    if (maker == "files") != bool(files) or maker not in (*MAKERS, "files"):
        raise unknown_name("maker of a world", maker, (*MAKERS, "files with a list of files"))
    specs = tuple(FileSpec(**file) for file in files)
    if maker == "files":
        BuildOptions(**options)
    return WorldSpec(name=name, maker=maker, options=tuple(options.items()), files=specs)


def _bundled_world(name: str, *, source: str) -> World:
    if source not in RECIPES:
        raise unknown_name("bundled world", source, RECIPES)
    return cached_world(source)


def _natural(name: str, *, kind: str, seed: int) -> World:
    if kind not in NATURAL_TERRAINS:
        raise unknown_name("natural terrain", kind, NATURAL_TERRAINS)
    check_seed(seed)
    return _terrain(name, NATURAL_TERRAINS[kind](np.random.default_rng(seed)))


def _boulders(name: str, *, seed: int) -> World:
    """Return rolling ground with many boulders, which block the view."""
    check_seed(seed)
    rng = np.random.default_rng(seed)
    return _terrain(name, with_rocks(rng, 3 * fractal(rng), 160, radius=(0.5, 1.2), height=(1.0, 2.0)))


def _terrain(name: str, heights: FloatArray) -> World:
    surface = HeightField.centered(heights.astype(np.float32), (CELL, CELL))
    return World(name, Terrain(surface), scale="generated")


def _course(name: str, *, kind: str, difficulty: float, seed: int) -> World:
    if kind not in KINDS:
        raise unknown_name("course", kind, KINDS)
    check_seed(seed)
    return generate(kind, difficulty, np.random.default_rng(seed)).world()


def _floor_plan(name: str, *, seed: int) -> World:
    check_seed(seed)
    return World(name, floor_plan(np.random.default_rng(seed)), scale="generated")


def _arena(name: str, **parameters: Any) -> World:
    return arena(name, ArenaConfig(**parameters))


MAKERS: Mapping[str, Callable[..., World]] = {
    "bundled": _bundled_world,
    "natural": _natural,
    "boulders": _boulders,
    "course": _course,
    "floor plan": _floor_plan,
    "arena": _arena,
}
"""Makers of worlds without external files, by name."""


@lru_cache(maxsize=4)
def _make_world(name: str, maker: str, options: tuple[tuple[str, Any], ...]) -> World:
    try:
        return MAKERS[maker](name, **dict(options))
    except TypeError as error:
        raise ConfigError(f"world {name!r}: {error}") from error


@lru_cache(maxsize=4)
def _from_files(places: tuple[Path, ...], options: tuple[tuple[str, Any], ...]) -> World:
    given: dict[str, Any] = {key: tuple(v) if isinstance(v, list) else v for key, v in options}
    return build_world(places[0], BuildOptions(**given))


@lru_cache(maxsize=256)
def _find(file: FileSpec, data: Path | None) -> Path | None:
    """Return the file of this content in a folder and those in it."""
    if data is None:
        return None
    for path in sorted(data.rglob("*")):
        if path.is_file() and path.stat().st_size == file.size and digest(path) == file.sha256:
            return path
    return None
