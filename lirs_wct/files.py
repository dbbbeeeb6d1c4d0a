"""Writing so that nothing half-written is ever seen: a temporary name, then a rename."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from lirs_wct.errors import OutputError


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


def _beside(path: Path) -> Path:
    """Return an unused hidden name in the same folder, so that the rename stays on one file system."""
    return path.with_name(f".{path.stem[:80]}.{os.getpid()}-{secrets.token_hex(4)}{path.suffix}")


def _cannot_write(path: Path, error: OSError) -> OutputError:
    where = f" ({error.filename})" if error.filename and Path(error.filename) != path else ""
    return OutputError(f"{path}: cannot be written: {error.strerror or error}{where}")


@contextmanager
def _quiet() -> Iterator[None]:
    """Pass over trouble while tidying up: the first error is the one to tell."""
    try:
        yield
    except OSError:
        return
