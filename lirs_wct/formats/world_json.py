"""A world on disk: metadata in `world.json`, exact arrays in `world.npz`."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lirs_wct.errors import SourceError, reason_of
from lirs_wct.files import atomic_write, referenced_file

SCHEMA = 1
JSON, ARRAYS = "world.json", "world.npz"
CELLS = (1e-5, 1e6)
"""Smallest and largest distance of two nodes of a stored surface, meters."""
TEXTURES = Path("materials") / "textures"
"""Folder in which Gazebo looks for a model's textures."""
TEXTURE_OPTIONS = ("texture", "wall_texture")
"""Settings that are the user's files: a world's folder holds copies."""


def write_world(folder: Path, entry: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> Path:
    """Write the world's two files into a folder and return it."""
    with atomic_write(folder / ARRAYS) as path:
        _write_arrays(path, arrays)
    with atomic_write(folder / JSON) as path:
        path.write_text(json.dumps(entry, indent=1) + "\n", encoding="utf-8")
    return folder


def recorded_source(folder: Path) -> str | None:
    """Return the source of the world in a folder; None = unknown."""
    with checked_content(folder):
        source: str | None = json.loads((folder / JSON).read_text(encoding="utf-8")).get("source")
        return source


def _write_arrays(path: Path, arrays: dict[str, NDArray[Any]]) -> None:
    """Write an .npz with compressed arrays.

    Heights stay uncompressed: compressing them is slow and hardly makes them smaller.
    """
    with zipfile.ZipFile(path, "w") as file:
        for name, array in arrays.items():
            entry = zipfile.ZipInfo(f"{name}.npy")
            entry.compress_type = zipfile.ZIP_STORED if name == "surface" else zipfile.ZIP_DEFLATED
            with file.open(entry, "w", force_zip64=True) as data:
                np.lib.format.write_array(data, array, allow_pickle=False)


def read_world(folder: Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Read a world's metadata and arrays (within `checked_content`)."""
    path = folder / JSON
    entry = json.loads(path.read_text(encoding="utf-8"))
    if entry["schema"] != SCHEMA:
        raise SourceError(f"{path}: schema {entry['schema']} is not the one this version reads ({SCHEMA})")
    with np.load(referenced_file(path, entry["arrays"]), allow_pickle=False) as arrays:
        return entry, dict(arrays)


@contextmanager
def checked_content(folder: Path) -> Iterator[None]:
    """Convert errors from missing or damaged files of a world to SourceError."""
    try:
        yield
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise SourceError(f"{folder / JSON}: not a built world, or damaged: {reason_of(error)}") from error


def texture_path(name: str, role: str, texture: Path | None) -> Path:
    """Return the path of a texture in a world's folder, of the user's file or of a generated one.

    The role is `texture` for the ground, or `wall_texture`.
    """
    stem = name if role == "texture" else f"{name}-walls"
    return TEXTURES / f"{stem}{texture.suffix.lower() if texture else '.png'}"


def keep_textures(name: str, options: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Copy the user's textures into a world's folder; return options with their new paths."""
    kept = options | {"texture": None}
    for role in TEXTURE_OPTIONS:
        texture: Path | None = options.get(role)
        if texture is not None:
            inside = texture_path(name, role, texture)
            with atomic_write(folder / inside) as path:
                path.write_bytes(texture.read_bytes())
            kept[role] = inside.as_posix()
    return kept


def find_textures(options: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return the stored options of a world with the paths of its textures."""
    owner = folder / JSON
    return options | {
        role: referenced_file(owner, options[role]) for role in TEXTURE_OPTIONS if options.get(role)
    }
