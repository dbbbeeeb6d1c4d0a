"""The files that a world was made from: where they lie, and what they hold."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from lirs_validation.config import RunConfig
from lirs_wct.errors import SourceError
from lirs_wct.formats.map_server import read_metadata
from lirs_wct.sources.options import SourceKind
from lirs_wct.sources.source import find_source

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
    """Return the files that hold the shape of a config's world, the source first; none of a bundled one.

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
    """Return a recorded config whose source is the very one that the run was made from.

    Args:
        config: as recorded: its source is as it was typed, in whichever folder that was.
        recorded: files that the run was made from; none where it was a bundled world.

    Raises:
        SourceError: neither where it lay nor under the name that was typed lies a source of that content.
    """
    if not recorded:
        return config
    found = []
    for place in dict.fromkeys((_place(config, recorded), config.source)):
        moved = replace(config, source=place)
        try:
            files = source_files(moved)
        except SourceError as error:
            found.append(str(error))
            continue
        if _digests(files) == [str(file["sha256"]) for file in recorded]:
            return moved
        found.append(_other(files, recorded))
    raise SourceError(found[0])


def same_source(config: RunConfig, recorded: Sequence[dict[str, Any]]) -> bool:
    """Tell whether a config's source holds what a run was made from, as far as its record says."""
    try:
        return not recorded or _digests(source_files(config)) == [file["sha256"] for file in recorded]
    except SourceError:
        return False


def _place(config: RunConfig, recorded: Sequence[dict[str, Any]]) -> str:
    """Return where the source lay: of a built folder, which is recorded by its files, the folder."""
    first = Path(str(recorded[0]["path"]))
    built = first.name == "world.json" and Path(config.source).name != first.name
    return str(first.parent if built else first)


def _other(files: Sequence[SourceFile], recorded: Sequence[dict[str, Any]]) -> str:
    """Say which file is another one."""
    for file, known in zip(files, recorded, strict=False):
        if file.sha256 != known["sha256"]:
            return (
                f"{file.path}: is not what the run was made from: sha256 {file.sha256[:SHOWN]}..., "
                f"recorded {known['sha256'][:SHOWN]}... of {known['path']}"
            )
    return f"{files[0].path}: is not what the run was made from: {len(files)} files, {len(recorded)} recorded"


def _digests(files: Sequence[SourceFile]) -> list[str]:
    return [file.sha256 for file in files]


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
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
