"""Which files of a folder are ours: those that its manifest lists and that are still as they were written.

The manifest is text as `sha256sum` writes and checks it (and BagIt, RFC 8493, section 2.1.3).
"""

from __future__ import annotations

import hashlib
import os
import shutil
import warnings
from collections.abc import Iterator
from pathlib import Path

MANIFEST = "manifest-sha256.txt"
FROM_BEFORE = ("world.json", "record.json")
"""A folder with one of these and no manifest was written before there were manifests."""
SHOWN = 3
"""Names of files that a warning shows."""


def write_manifest(folder: Path) -> None:
    """List every file that a folder holds now."""
    files = sorted(path for path in _entries(folder) if path.is_file() and path.name != MANIFEST)
    lines = (f"{_digest(path)}  {path.relative_to(folder).as_posix()}\n" for path in files)
    (folder / MANIFEST).write_text("".join(lines), encoding="utf-8")


def keep_foreign(old: Path, new: Path, shown: Path) -> None:
    """Bring into a folder, by links, every file of an older one that is not ours.

    A file under a name that we write, but with content that we did not, is kept as NAME~; a warning says so.

    Args:
        old: older folder, which stays as it is.
        new: folder with its new files, all of them ours.
        shown: path of the folder in the warning.

    Raises:
        OSError: a file can neither be linked nor copied.
    """
    ours = _read_manifest(old)
    renewed = ours is None and any((old / name).is_file() for name in FROM_BEFORE)
    moved = []
    for path in list(_entries(old)):
        name = path.relative_to(old).as_posix()
        there = new / name
        taken = os.path.lexists(there)
        if name == MANIFEST or (taken and (renewed or there.is_dir() or _same(path, there))):
            continue
        if ours is not None and name in ours and path.is_file() and _digest(path) == ours[name]:
            continue
        if taken:
            there = _backup(there, old / name)
            moved.append((name, there.name))
        there.parent.mkdir(parents=True, exist_ok=True)
        _link(path, there)
    if moved:
        names = ", ".join(f"{name} as {kept}" for name, kept in moved[:SHOWN])
        more = f" and {len(moved) - SHOWN} more" if len(moved) > SHOWN else ""
        warnings.warn(f"{shown}: kept what was not written by this program: {names}{more}", stacklevel=4)


def _entries(folder: Path) -> Iterator[Path]:
    """Yield the files, links and empty folders below a folder."""
    for parent, folders, files in os.walk(folder):
        here = Path(parent)
        yield from (here / name for name in files)
        yield from (here / name for name in folders if (here / name).is_symlink())
        if here != folder and not folders and not files:
            yield here


def _read_manifest(folder: Path) -> dict[str, str] | None:
    """Return the digests of what was written, by name; None without a manifest, or with a damaged one."""
    try:
        lines = (folder / MANIFEST).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        return None
    return {name: digest for digest, _, name in (line.partition("  ") for line in lines)}


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _same(path: Path, other: Path) -> bool:
    """Whether two files have the same content."""
    both = path.is_file() and other.is_file() and path.stat().st_size == other.stat().st_size
    return both and _digest(path) == _digest(other)


def _backup(new: Path, old: Path) -> Path:
    """Return the first of NAME~, NAME~2, ... that is free in both folders."""
    number = 1
    while True:
        suffix = "~" if number == 1 else f"~{number}"
        if not any(os.path.lexists(path.with_name(path.name + suffix)) for path in (new, old)):
            return new.with_name(new.name + suffix)
        number += 1


def _link(path: Path, there: Path) -> None:
    """Give a file a second place: a link where the file system has them, else a copy."""
    if path.is_symlink():
        there.symlink_to(path.readlink())
    elif path.is_dir():
        there.mkdir()
    else:
        try:
            os.link(path, there)
        except OSError:
            shutil.copy2(path, there)
            with there.open("rb") as file:
                os.fsync(file.fileno())
