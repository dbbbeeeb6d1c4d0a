"""Cache of built worlds in memory and on disk, shared by processes."""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from contextlib import suppress
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

import lirs_wct
from lirs_wct.formats.map_server import read_metadata
from lirs_wct.sources.source import BuildOptions, SourceKind, find_source

FOLDER_VARIABLE = "LIRS_WCT_CACHE"
"""Environment variable with the folder of built worlds; empty = none is kept on disk."""


def cache_folder() -> Path | None:
    """Return the folder of built worlds; None = none is kept on disk."""
    given = os.environ.get(FOLDER_VARIABLE)
    if given is not None:
        return Path(given).expanduser() if given else None
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "lirs-wct" / "worlds"


def cached_world(source: str) -> lirs_wct.World:
    """Return a source's world from the cache, or build it.

    A cached world was built from the same bytes by the same program.
    """
    return _in_memory(source, content_key(source))


@lru_cache(maxsize=4)
def _in_memory(source: str, key: str | None) -> lirs_wct.World:
    folder = cache_folder()
    if key is None or folder is None:
        return lirs_wct.build_world(source)
    place = folder / key
    try:
        return lirs_wct.World.load(place)
    except lirs_wct.SourceError:
        world = lirs_wct.build_world(source)
    with suppress(OSError):  # without write access nothing is kept
        place.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=place.parent) as scratch:
            saved = world.save(Path(scratch) / "world")
            if place.exists():
                shutil.rmtree(place)
            saved.rename(place)
    return world


def content_key(source: str) -> str | None:
    """Return a digest of a source's bytes and the building program; None = the world is not cached."""
    found = find_source(source, BuildOptions())
    if found.kind is SourceKind.FOLDER:
        return None
    digest = hashlib.sha256(_program_digest())
    digest.update(source.encode() if found.kind is SourceKind.BUNDLED else found.path.name.encode())
    files = [] if found.kind is SourceKind.BUNDLED else [found.path]
    if found.kind is SourceKind.MAP:
        files.append(read_metadata(found.path).image)
    if not all(file.is_file() for file in files):
        return None
    for file in files:
        digest.update(file.read_bytes())
    return digest.hexdigest()[:32]


@lru_cache(maxsize=1)
def _program_digest() -> bytes:
    digest = hashlib.sha256(f"{np.__version__} {cv2.__version__}".encode())
    package = Path(lirs_wct.__file__).parent
    for file in sorted((*package.rglob("*.py"), *package.rglob("*.toml"))):
        digest.update(file.read_bytes())
    return digest.digest()
