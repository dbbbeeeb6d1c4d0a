"""Move the user's files from a replaced folder to the new one.

The manifest of a folder lists the files that this program wrote there, with their digests. It is text as
`sha256sum` writes and checks it (and BagIt, RFC 8493, section 2.1.3). A file is ours if the manifest names it
and its content is unchanged. Every other file is the user's.

1. Before the exchange, `link_foreign` makes the user's files visible in the new folder. A file gets a hard
   link. A folder gets a symbolic link to its path after the exchange, called bridge here. Thus a program that
   saves into `w/mine/` reaches the same folder; a path that is resolved at the very moment of step 2 can fail
   with ELOOP, which the program sees as an error.
2. After the exchange, `move_foreign` exchanges each bridge with its folder, moves the files that appeared
   late, and removes our own unchanged files. It removes a folder only when that is empty.

`move_foreign` may be killed at any step: a second call continues its work.
"""

from __future__ import annotations

import ctypes
import errno
import hashlib
import os
import re
import sys
import warnings
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

FROM_BEFORE = ("world.json", "record.json")
"""A folder with one of these files and no manifest was written before there were manifests."""
SHOWN = 3
"""Number of file names in a warning."""
PASSES = 1000
"""Limit of repetitions while another process keeps creating files in the replaced folder."""
_BRIDGE = re.compile(r"(?:\.\./)+\.[^/]*\.\d+-[0-9a-f]{8}~[^/]*/(.*)", re.DOTALL)
_NO_LINKS = (errno.EPERM, errno.EACCES, errno.ENOTSUP, errno.EXDEV, errno.EMLINK)
MANIFEST = "manifest-sha256.txt"


@dataclass(frozen=True)
class _Entry:
    name: str
    """Path below the folder."""
    shared: bool = False
    """Whether it is a folder that may hold both our files and the user's."""


def link_foreign(old: Path, new: Path, later: str) -> None:
    """Make the user's files visible in a new folder.

    Args:
        old: folder that will be replaced; it stays unchanged.
        new: folder that will replace it.
        later: name of the old folder after the exchange.

    Raises:
        OSError: the files cannot be linked, or could not be moved later.
    """
    ours = read_manifest(old) or {}
    for entry in _entries(old, new, ours):
        path, there = old / entry.name, new / entry.name
        _check_movable(path)
        if entry.shared or entry.name in ours:
            continue
        if os.path.lexists(there):
            if _is_folder(path):
                raise FileExistsError(errno.EEXIST, "a folder has the name of a new file", str(path))
            continue
        there.parent.mkdir(parents=True, exist_ok=True)
        try:
            if _is_folder(path):
                there.symlink_to("../" * len(Path(entry.name).parts) + f"{later}/{entry.name}")
            else:
                os.link(path, there, follow_symlinks=False)
        except FileNotFoundError:
            continue  # the user removed it
        except OSError as error:
            # The exchange does not need the link: without it, the file is missing for some milliseconds.
            if error.errno not in _NO_LINKS:
                raise


def move_foreign(old: Path, new: Path, shown: Path) -> None:
    """Move the user's files from a replaced folder to the new one, and remove the replaced one.

    A user's file whose name is taken becomes NAME~, and a warning names it.

    Args:
        old: replaced folder.
        new: folder at the final path.
        shown: path of the folder in the warning.

    Raises:
        OSError: a file cannot be moved; it stays in the replaced folder.
    """
    ours = read_manifest(old) or {}
    renewed = not (old / MANIFEST).exists() and any((old / name).is_file() for name in FROM_BEFORE)
    kept: dict[str, str] = {}
    for _ in range(PASSES):
        for entry in _entries(old, new, ours):
            # The user, too, may move or create files now: the next pass sees them.
            with suppress(FileNotFoundError, FileExistsError):
                if entry.shared:
                    _remove_empty(old / entry.name)
                elif not _is_ours(old, entry.name, ours):
                    kept |= _move_entry(old, new, entry.name, renewed)
                else:
                    (old / entry.name).unlink()
        if all(path.name == MANIFEST for path in old.iterdir()):
            (old / MANIFEST).unlink(missing_ok=True)
            if _remove_empty(old):
                break
    else:
        raise OSError(errno.ENOTEMPTY, "another program keeps creating files", str(old))
    if kept:
        names = ", ".join(f"{name} as {backup}" for name, backup in list(kept.items())[:SHOWN])
        more = f" and {len(kept) - SHOWN} more" if len(kept) > SHOWN else ""
        warnings.warn(f"{shown}: kept what was not written by this program: {names}{more}", stacklevel=2)


def _entries(old: Path, new: Path, ours: dict[str, str]) -> Iterator[_Entry]:
    """Yield files and the user's folders; a shared folder follows its entries."""
    our_folders = {str(folder) for name in ours for folder in PurePosixPath(name).parents}

    def below(parent: str) -> Iterator[_Entry]:
        for name in sorted(parent + path.name for path in (old / parent).iterdir()):
            if _is_folder(old / name) and (name in our_folders or _is_folder(new / name)):
                yield from below(f"{name}/")
                yield _Entry(name, shared=True)
            elif name != MANIFEST:
                yield _Entry(name)

    return below("")


def _move_entry(old: Path, new: Path, name: str, renewed: bool) -> dict[str, str]:
    """Move one file or folder of the user; return its old and new name if the name was taken."""
    path, there = old / name, new / name
    if _is_bridge(path, name):
        path.unlink()
    elif _is_bridge(there, name):
        _replace_bridge(path, there, name)
    elif not os.path.lexists(there):
        there.parent.mkdir(parents=True, exist_ok=True)
        move(path, there)
    elif _same(path, there) or (renewed and path.is_file() and there.is_file()):
        path.unlink()
    else:
        # Of two versions that the user saved, the later one keeps the name.
        if name not in (read_manifest(new) or {}) and path.lstat().st_mtime > there.lstat().st_mtime:
            exchange(path, there)
        backup = _backup(there, path)
        move(path, backup)
        return {name: backup.name}
    return {}


def _replace_bridge(folder: Path, bridge: Path, name: str) -> None:
    """Put a folder at the path of the bridge that leads to it."""
    if not exchange(folder, bridge):
        bridge.unlink()
        move(folder, bridge)
    elif _is_bridge(folder, name):
        folder.unlink()


def _check_movable(path: Path) -> None:
    """Raise PermissionError if a file or folder cannot be moved away."""
    for folder in (path.parent, path):
        if _is_folder(folder) and not os.access(folder, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(folder))


def _is_ours(folder: Path, name: str, ours: dict[str, str]) -> bool:
    """Whether the manifest names a file and its content is unchanged."""
    path = folder / name
    return name in ours and path.is_file() and not path.is_symlink() and digest(path) == ours[name]


def _is_folder(path: Path) -> bool:
    return path.is_dir() and not path.is_symlink()


def _is_bridge(path: Path, name: str) -> bool:
    """Whether a path is a symbolic link that `link_foreign` made for this name."""
    found = _BRIDGE.fullmatch(str(path.readlink())) if path.is_symlink() else None
    return found is not None and found[1] == name


def _same(path: Path, other: Path) -> bool:
    """Whether two paths are the same file or have the same content."""
    if os.path.samestat(path.lstat(), other.lstat()):
        return True
    plain = all(file.is_file() and not file.is_symlink() for file in (path, other))
    return plain and path.stat().st_size == other.stat().st_size and digest(path) == digest(other)


def _remove_empty(folder: Path) -> bool:
    """Remove a folder if it is empty; return whether it was."""
    try:
        folder.rmdir()
    except OSError as error:
        if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
            raise
        return False
    return True


def _backup(new: Path, old: Path) -> Path:
    """Return the first of NAME~, NAME~2, ... that is free in both folders."""
    number = 1
    while True:
        suffix = "~" if number == 1 else f"~{number}"
        if not any(os.path.lexists(path.with_name(path.name + suffix)) for path in (new, old)):
            return new.with_name(new.name + suffix)
        number += 1


def write_manifest(folder: Path) -> None:
    """List every file that a folder holds now."""
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path.name != MANIFEST)
    lines = (f"{digest(path)}  {path.relative_to(folder).as_posix()}\n" for path in files)
    (folder / MANIFEST).write_text("".join(lines), encoding="utf-8")


def read_manifest(folder: Path) -> dict[str, str] | None:
    """Return the digests by file name; None if the manifest is missing or damaged."""
    try:
        lines = (folder / MANIFEST).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        return None
    return {name: value for value, _, name in (line.partition("  ") for line in lines)}


def digest(path: Path) -> str:
    """Return the SHA-256 digest of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


_CURRENT_FOLDER = -100
_NO_REPLACE = 1
_EXCHANGE = 2
_UNSUPPORTED = (errno.ENOSYS, errno.EINVAL, errno.ENOTSUP)


def exchange(path: Path, other: Path) -> bool:
    """Exchange two paths in one step; return False where the file system cannot."""
    return _renameat2(path, other, _EXCHANGE)


def move(path: Path, target: Path) -> None:
    """Rename a file or folder, and never replace another one.

    Raises:
        FileExistsError: the target exists.
        OSError: the file system refuses the rename.
    """
    if _renameat2(path, target, _NO_REPLACE):
        return
    if os.path.lexists(target):
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(target))
    path.rename(target)


def _renameat2(path: Path, target: Path, flags: int) -> bool:
    """Call `renameat2`; return False where the system or the file system does not have it."""
    if sys.platform == "win32":
        return False
    call = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if call is None:
        return False
    if call(_CURRENT_FOLDER, os.fsencode(path), _CURRENT_FOLDER, os.fsencode(target), flags) == 0:
        return True
    code = ctypes.get_errno()
    if code in _UNSUPPORTED:
        return False
    raise OSError(code, os.strerror(code), str(path), None, str(target))
