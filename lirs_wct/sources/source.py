"""Identification of sources: kind, path, world name, and warnings on options without effect."""

from __future__ import annotations

import re
import unicodedata
import warnings
from dataclasses import dataclass
from pathlib import Path

from lirs_wct.errors import ConfigError, SourceError, did_you_mean
from lirs_wct.files import read_manifest
from lirs_wct.formats.map_server import read_metadata
from lirs_wct.formats.point_clouds import is_cloud_ply
from lirs_wct.formats.suffixes import CLOUDS, LOGS, MAPS, MESHES, ZSTD, is_bag_file, way_to_read
from lirs_wct.sources.bundled import RECIPES
from lirs_wct.sources.options import BuildOptions, SourceKind, without_effect

LONGEST_NAME = 200
"""Limit of a name, characters: file systems allow 255, and a world's files have endings of up to 40."""
WHOLE = 0.98
"""Share of a window's side above which it counts as inside the world: windows are cut at nodes."""


@dataclass(frozen=True, slots=True)
class Source:
    """An existing source: kind, path (or bundled name), and name of the world."""

    kind: SourceKind
    path: Path
    name: str

    @property
    def identity(self) -> str:
        """Identity of the source: its absolute path, or its bundled name."""
        return self.path.name if self.kind is SourceKind.BUNDLED else str(self.path.resolve())


def find_source(given: str | Path, options: BuildOptions) -> Source:
    """Return kind, path and name of a source.

    Raises:
        SourceError: no bundled world, file or built folder has this name.
    """
    path = Path(given)
    if str(given) in RECIPES:
        return Source(SourceKind.BUNDLED, path, _name(str(given), options))
    if not path.exists():
        raise SourceError(
            f"{given}: no such file or folder, nor a bundled world (bundled: {', '.join(RECIPES)})"
            f"{did_you_mean(str(given), RECIPES)}"
        )
    kind = _kind(path, options)
    beside = _yaml_beside(path) if kind in (SourceKind.PICTURE, SourceKind.MAP_PICTURE) else None
    if beside is not None and options.kind != "picture" and options.resolution is None:
        warnings.warn(
            f"{path}: read as the laser map that {beside.name} beside it says it is; "
            "--kind picture reads it as a terrain",
            stacklevel=2,
        )
        kind, path = SourceKind.MAP, beside
    return Source(kind, path, _name(_stem(path), options))


def _yaml_beside(path: Path) -> Path | None:
    """Return the ROS map's YAML of the same name next to a picture, if it names the picture."""
    for suffix in MAPS:
        found = path.with_suffix(suffix)
        if found.is_file():
            try:
                if read_metadata(found).image.resolve() == path.resolve():
                    return found
            except SourceError:
                # This YAML is not that of a map.
                continue
    return None


def is_log(path: Path) -> bool:
    """Return whether a path is a CARMEN log or a ROS bag."""
    return _strip_compression(path).suffix.lower() in LOGS or is_bag(path)


def is_bag(path: Path) -> bool:
    """Return whether a path is a ROS bag: a file, or a folder with a bag's files."""
    if path.is_dir():
        return not (path / "world.json").exists() and any(is_bag_file(p) for p in path.iterdir())
    return is_bag_file(path)


def warn_of_useless(source: Source, options: BuildOptions) -> None:
    """Warn of given options that have no effect on a source of this kind."""
    useless = [name.replace("_", "-") for name in without_effect(options, source.kind)]
    if useless:
        verb = "has" if len(useless) == 1 else "have"
        warnings.warn(
            f"{source.path}: {', '.join(useless)} {verb} no effect on a {source.kind.value}", stacklevel=3
        )


def warn_of_shape(source: Source, options: BuildOptions, size: tuple[float, float], exact: bool) -> None:
    """Warn of a window beyond the world, and of a budget for a mesh that is never simplified.

    Args:
        source: source of the world.
        options: given options.
        size: extent of the world, meters.
        exact: whether the world is a laser map, or a mesh with overhangs.
    """
    if options.max_error and exact:
        warnings.warn(
            f"{source.path}: --max-error has no effect: walls and overhangs are written as they are",
            stacklevel=3,
        )
    if options.window is not None and min(size) < WHOLE * options.window[2]:
        x, y, side = options.window
        warnings.warn(
            f"{source.path}: --window {x:g},{y:g},{side:g} reaches beyond the world, {size[0]:.4g} x "
            f"{size[1]:.4g} m of it are left",
            stacklevel=3,
        )


def _kind(path: Path, options: BuildOptions) -> SourceKind:
    if is_bag(path):
        return SourceKind.LOG
    if path.is_dir():
        if not (path / "world.json").is_file():
            if "world.json" in read_manifest(path):
                raise SourceError(f"{path}: is incomplete, its build was broken off: build it again")
            raise SourceError(f"{path}: a folder that was built holds world.json, this one does not")
        return SourceKind.FOLDER
    if path.suffix.lower() in MAPS:
        return SourceKind.MAP
    if path.suffix.lower() in CLOUDS or (path.suffix.lower() == ".ply" and is_cloud_ply(path)):
        return SourceKind.CLOUD
    if path.suffix.lower() in MESHES:
        return SourceKind.MESH
    if is_log(path):
        return SourceKind.LOG
    if way := way_to_read(path):
        raise SourceError(f"{path}: {way}")
    return SourceKind.MAP_PICTURE if options.kind == "map" else SourceKind.PICTURE


def _strip_compression(path: Path) -> Path:
    return path.with_suffix("") if path.suffix.lower() in (".gz", ZSTD) else path


def _stem(path: Path) -> str:
    return _strip_compression(path).stem if path.is_file() else path.name


def _name(stem: str, options: BuildOptions) -> str:
    """Return a name that every consumer accepts; Gazebo's URIs allow no spaces.

    Accents are removed from letters; letters of other scripts are removed.
    """
    given = options.name or stem
    plain = "".join(c for c in unicodedata.normalize("NFKD", given) if not unicodedata.combining(c))
    name = re.sub(r"[^A-Za-z0-9_.-]+", "_", plain).strip("_.-") or "world"
    if not given.isascii():
        warnings.warn(
            f"{given}: the world is named {name}; names hold letters a to z, digits and _.- alone",
            stacklevel=4,
        )
    if len(name) > LONGEST_NAME:
        raise ConfigError(f"--name: a world's name has at most {LONGEST_NAME} characters, got {len(name)}")
    return name
