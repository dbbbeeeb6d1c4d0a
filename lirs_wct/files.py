"""Writing so that nothing half-written is ever seen: a temporary name, then a rename.

What a process that was killed left behind under such names goes when its place is written next.
"""

from __future__ import annotations

import os
import re
import secrets
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from lirs_wct.errors import OutputError
from lirs_wct.manifest import MANIFEST, keep_foreign, write_manifest

_TEMPORARY = re.compile(r"(\..*)\.(\d+)-[0-9a-f]{8}(|\.[^.]*)")
"""What `_beside` names: stem, process, random digits, suffix."""
_WRITING: set[str] = set()
"""Temporary names that this process has given out."""


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Give a temporary path beside `path`; what is written there takes its place when the block ends well.

    The temporary name keeps the suffix, since many libraries choose the format by it. Missing parent
    folders are made. When the block raises, Ctrl-C included, the temporary file is removed and an
    older file at `path` stays as it was.

    Raises:
        OutputError: the file cannot be written, or nothing was.
    """
    temporary = _beside(path)
    try:
        if path.is_dir():
            raise OutputError(f"{path}: is a folder, a file is to be written there")
        path.parent.mkdir(parents=True, exist_ok=True)
        remove_leftovers([path])
        yield temporary
        temporary.replace(path)
    except OSError as error:
        raise _cannot_write(path, error) from error
    finally:
        with _quiet():
            temporary.unlink(missing_ok=True)
        _WRITING.discard(temporary.name)


@contextmanager
def atomic_folder(path: Path) -> Iterator[Path]:
    """Give a new empty folder beside `path`; it takes the place of `path` when the block ends well.

    Of an older folder at `path` those files go that its manifest says were written here; whatever else lies
    there stays (see `keep_foreign`). When the block raises, Ctrl-C included, the temporary folder is
    removed and the older one stays as it was. A link to a folder stays a link.

    Raises:
        OutputError: the folder cannot be written, or a file has its name.
    """
    place = path.resolve() if path.is_symlink() else path
    temporary, old = _beside(place), _beside(place)
    try:
        if path.exists() and not path.is_dir():
            raise OutputError(f"{path}: is a file, a folder is to be written there")
        temporary.mkdir(parents=True)
        remove_leftovers([place])
        yield temporary
        write_manifest(temporary)
        _flush(temporary)
        if place.exists():
            keep_foreign(place, temporary, shown=path)
        _exchange(place, temporary, old)
    except OSError as error:
        raise _cannot_write(path, error) from error
    finally:
        for own in (temporary, old):
            shutil.rmtree(own, ignore_errors=True)
            _WRITING.discard(own.name)


def _exchange(place: Path, new: Path, old: Path) -> None:
    """Put a new folder in a place; an older one that is there gets the name `old`."""
    if place.exists():
        place.rename(old)
    try:
        new.rename(place)
    except OSError:
        if old.exists():
            old.rename(place)
        raise


def _flush(folder: Path) -> None:
    """Wait until the disk has every file: else a power cut after the rename leaves empty ones."""
    for path in folder.rglob("*"):
        if path.is_file():
            with path.open("rb+") as file:
                os.fsync(file.fileno())


def remove_leftovers(paths: Iterable[Path]) -> None:
    """Remove what processes that were killed left behind while they wrote these paths.

    What a process that still lives is writing stays. A folder that is complete, of a process that was killed
    between two renames and left none at its path, is put there.
    """
    wanted = {(path.parent, f".{path.stem[:80]}", path.suffix): path for path in paths}
    for folder in {parent for parent, _, _ in wanted}:
        for name in _hidden(folder):
            found = _TEMPORARY.fullmatch(name)
            path = wanted.get((folder, found[1], found[3])) if found else None
            if found is None or path is None or _in_use(name, int(found[2])):
                continue
            # The manifest is written last.
            if (folder / name / MANIFEST).is_file() and not path.exists():
                (folder / name).rename(path)
            else:
                _remove(folder / name)


def remove_orphans(folder: Path, prefix: str) -> None:
    """Remove what processes that were killed left in a folder under `PREFIXpid-...`."""
    for entry in folder.glob(f"{prefix}*"):
        pid = entry.name.removeprefix(prefix).partition("-")[0]
        if pid.isdigit() and not lives(int(pid)):
            _remove(entry)


def _remove(entry: Path) -> None:
    with _quiet():
        shutil.rmtree(entry) if entry.is_dir() else entry.unlink()


def _hidden(folder: Path) -> list[str]:
    """Return the hidden names in a folder; none where it cannot be read."""
    try:
        return [entry.name for entry in os.scandir(folder) if entry.name[0] == "."]
    except OSError:
        return []


def _in_use(name: str, pid: int) -> bool:
    """Whether the process that gave out a temporary name still writes there; in containers ids come again."""
    return name in _WRITING if pid == os.getpid() else lives(pid)


def lives(pid: int) -> bool:
    """Return whether a process of this machine is running."""
    try:
        os.kill(pid, 0)
        # Dead, but nobody has asked how it ended: where no init process does, that stays so.
        return not re.search(r"\) Z ", Path(f"/proc/{pid}/stat").read_text(encoding="utf-8"))
    except ProcessLookupError:
        return False
    except OSError:
        return True


def _beside(path: Path) -> Path:
    """Return an unused hidden name in the same folder, so that the rename stays on one file system."""
    temporary = path.with_name(f".{path.stem[:80]}.{os.getpid()}-{secrets.token_hex(4)}{path.suffix}")
    _WRITING.add(temporary.name)
    return temporary


def _cannot_write(path: Path, error: OSError) -> OutputError:
    where = f" ({error.filename})" if error.filename and Path(error.filename) != path else ""
    return OutputError(f"{path}: cannot be written: {error.strerror or error}{where}")


@contextmanager
def _quiet() -> Iterator[None]:
    """Pass over trouble while tidying up: the first error is the one to report."""
    try:
        yield
    except OSError:
        return
