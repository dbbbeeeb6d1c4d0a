"""Provenance of a result: versions, code, machine, source files; staleness."""

from __future__ import annotations

import hashlib
import importlib.metadata
import importlib.util
import os
import platform
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

from lirs_validation.config import RunConfig
from lirs_wct.errors import SourceError
from lirs_wct.files import MANIFEST, digest, read_manifest
from lirs_wct.formats.map_server import read_metadata
from lirs_wct.sources.source import SourceKind, find_source

PACKAGES = ("lirs-wct", "mujoco", "gymnasium", "numpy", "scipy", "numba")
OWN = ("lirs_wct", "lirs_envs", "slam_baselines", "lirs_validation", "lirs_extensions")

CODE = (".py", ".xml", ".npz")
"""Endings of the files that decide a result."""


def versions() -> dict[str, str]:
    """Return the versions of Python, relevant packages and our code (`code`)."""
    return {"python": platform.python_version()} | _package_versions() | {"code": code()}


@cache
def _package_versions() -> dict[str, str]:
    return {p: importlib.metadata.version(p) for p in PACKAGES}


@cache
def code() -> str:
    """Return eight hex digits of our code, robots and weights.

    They distinguish two states of one version.
    """
    digest = hashlib.sha256()
    for package in OWN:
        spec = importlib.util.find_spec(package)
        for folder in (spec.submodule_search_locations or ()) if spec else ():
            for path in sorted(path for path in Path(folder).rglob("*") if path.suffix in CODE):
                digest.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:8]


def machine() -> dict[str, Any]:
    """Return the machine's properties, on which a run's times depend."""
    return {"system": platform.platform(), "processor": _processor(), "cores": os.cpu_count()}


def _processor() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text(encoding="utf-8").splitlines() if cpuinfo.is_file() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


SHOWN = 12
"""Hex digits of a digest that a message shows."""


@dataclass(frozen=True)
class SourceFile:
    """A file that a world was made from.

    Attributes:
        path: absolute.
        sha256: digest of its content, hexadecimal.
    """

    path: str
    sha256: str


def source_files(config: RunConfig) -> tuple[SourceFile, ...]:
    """Return a world's source files, the source first; empty for bundled worlds.

    Raises:
        SourceError: there is no such source, or a file of it cannot be read.
    """
    source = find_source(config.source, config.build)
    if source.kind is SourceKind.BUNDLED:
        return ()
    paths = [source.path]
    if source.kind is SourceKind.FOLDER:
        paths = [source.path / "world.json", source.path / "world.npz"]
    elif source.kind is SourceKind.MAP:
        paths.append(read_metadata(source.path).image)
    return tuple(SourceFile(str(path.absolute()), _sha256(path)) for path in paths)


def with_recorded_source(config: RunConfig, recorded: Sequence[dict[str, Any]]) -> RunConfig:
    """Return a recorded config with the same source content as in the run.

    Args:
        config: recorded config; its source is as it was typed, in whichever folder that was.
        recorded: files that the run was made from; none where it was a bundled world.

    Raises:
        SourceError: the source is gone from its place, or its content is another one.
    """
    if not recorded:
        return config
    placed = replace(config, source=_place(config, recorded))
    for file in source_files(placed):
        if file.sha256 not in [known["sha256"] for known in recorded]:
            raise SourceError(
                f"{file.path}: is not what the run was made from: sha256 {file.sha256[:SHOWN]}..."
            )
    return placed


def same_source(config: RunConfig, recorded: Sequence[dict[str, Any]]) -> bool:
    """Return whether a config's source has the recorded content."""
    try:
        files = source_files(config) if recorded else ()
    except SourceError:
        return False
    return [file.sha256 for file in files] == [file["sha256"] for file in recorded]


def _place(config: RunConfig, recorded: Sequence[dict[str, Any]]) -> str:
    """Return the recorded place of the source.

    For a built folder, the folder, although its files are recorded.
    """
    first = Path(str(recorded[0]["path"]))
    built = first.name == "world.json" and Path(config.source).name != first.name
    return str(first.parent if built else first)


def _sha256(path: Path) -> str:
    """Return the digest of a file; one that did not change is read once.

    Raises:
        SourceError: it cannot be read.
    """
    try:
        state = path.stat()
        return _digest_of(path.absolute(), state.st_mtime_ns, state.st_size)
    except OSError as error:
        raise SourceError(f"{path}: cannot be read: {error.strerror or error}") from error


@lru_cache(maxsize=256)
def _digest_of(path: Path, changed: int, size: int) -> str:
    return digest(path)


def same_code(found: Any) -> bool:
    """Return whether this very code and package version made a result."""
    return (
        isinstance(found, dict)
        and found.get("code") == code()
        and found.get("lirs-wct") == versions()["lirs-wct"]
    )


def damaged_files(folder: Path, marker: str) -> list[str]:
    """Return missing or changed files of a result's folder, by its manifest.

    The marker is left out: who reads it notices damage. A manifest that does not name it is damaged.
    """
    manifest = read_manifest(folder)
    if manifest.pop(marker, None) is None:
        return [MANIFEST]
    return [name for name, digests in manifest.items() if not _is_whole(folder / name, digests)]


def _is_whole(path: Path, digests: set[str]) -> bool:
    try:
        return digest(path) in digests
    except OSError:
        return False


def world_files(config: RunConfig) -> list[Path]:
    """Return a source's files, judged by its name; empty for bundled worlds."""
    path = Path(config.source)
    if path.is_dir():
        return [path / "world.json", path / "world.npz"]
    siblings = path.parent.glob(f"{path.stem}.*") if path.suffix in (".yaml", ".yml") else ()
    textures = (config.build.texture, config.build.wall_texture)
    return [path, *siblings, *filter(None, textures)]


def is_stale(result: Path, found: Any, inputs: Iterable[Path | None]) -> bool:
    """Tell whether other code wrote a result, or an input changed after it was written.

    Args:
        result: file that was written last.
        found: the versions that the result says it is of.
        inputs: files that it was made from, where they are known.
    """
    return not same_code(found) or is_older(result, inputs)


def is_older(result: Path, inputs: Iterable[Path | None]) -> bool:
    """Tell whether an input was written, moved or copied after the result was."""
    written = result.stat().st_mtime
    for path in inputs:
        with suppress(OSError):
            if path is not None and max(path.stat().st_mtime, path.stat().st_ctime) > written:
                return True
    return False
