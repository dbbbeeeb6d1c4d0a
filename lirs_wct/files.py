"""Writing so that nothing half-written is ever seen: a temporary name, then a rename."""

from __future__ import annotations

import os
import re
import secrets
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from lirs_wct.errors import OutputError

_TEMPORARY = re.compile(r"(\..*)\.(\d+)-[0-9a-f]{8}(|\.[^.]*)")
"""What `_beside` names: stem, process, random digits, suffix."""


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
        yield temporary
        temporary.replace(path)
    except OSError as error:
        raise _cannot_write(path, error) from error
    finally:
        with _quiet():
            temporary.unlink(missing_ok=True)


@contextmanager
def atomic_folder(path: Path) -> Iterator[Path]:
    """Give a new empty folder beside `path`; it takes the place of `path` when the block ends well.

    An older folder at `path` is replaced as a whole. When the block raises, Ctrl-C included, the
    temporary folder is removed and the older one stays as it was.

    Raises:
        OutputError: the folder cannot be written, or a file has its name.
    """
    temporary, old = _beside(path), _beside(path)
    try:
        if path.exists() and not path.is_dir():
            raise OutputError(f"{path}: is a file, a folder is to be written there")
        temporary.mkdir(parents=True)
        yield temporary
        _flush(temporary)
        if path.exists():
            path.rename(old)
        try:
            temporary.rename(path)
        except OSError:
            if old.exists():
                old.rename(path)
            raise
    except OSError as error:
        raise _cannot_write(path, error) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        shutil.rmtree(old, ignore_errors=True)


def _flush(folder: Path) -> None:
    """Wait until the disk has every file: else a power cut after the rename leaves empty ones."""
    for path in folder.rglob("*"):
        if path.is_file():
            with path.open("rb+") as file:
                os.fsync(file.fileno())


def remove_leftovers(paths: Iterable[Path]) -> None:
    """Remove what processes that were killed left behind while they wrote these paths.

    What a process that still lives is writing stays.
    """
    wanted = {(path.parent, f".{path.stem[:80]}", path.suffix) for path in paths}
    for folder in {parent for parent, _, _ in wanted}:
        for entry in folder.iterdir() if folder.is_dir() else ():
            found = _TEMPORARY.fullmatch(entry.name)
            if found and (folder, found[1], found[3]) in wanted and not _lives(int(found[2])):
                with _quiet():
                    shutil.rmtree(entry) if entry.is_dir() else entry.unlink()


def _lives(pid: int) -> bool:
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
    return path.with_name(f".{path.stem[:80]}.{os.getpid()}-{secrets.token_hex(4)}{path.suffix}")


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
