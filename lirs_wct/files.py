"""Atomic writes (a temporary name, then a rename) and gzipped files.

A killed process leaves temporary files behind. The next write of the same path removes them.
"""

from __future__ import annotations

import csv
import gzip
import json
import os
import re
import secrets
import shutil
import sys
import tempfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from lirs_wct.errors import OutputError, SourceError
from lirs_wct.foreign_files import exchange, link_foreign, move_foreign, write_manifest

if sys.platform != "win32":
    import fcntl

GZIP = b"\x1f\x8b"
"""First bytes of a gzipped file."""
GZIP_LEVEL = 1
"""Level of gzip: higher ones hardly shrink sensor noise further and take many times as long."""
_TEMPORARY = re.compile(r"(\..*)\.(\d+)-[0-9a-f]{8}(~?)(|\.[^.]*)")
"""Stem, process, mark and suffix of a temporary name. The mark ~: the folder may hold the user's files."""
_STAGED = ".staged-"
_WRITING: set[str] = set()
"""Temporary names that this process is using."""


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Yield a temporary path; its file replaces `path` when the block succeeds.

    The temporary name keeps the suffix, since many libraries choose the format by it. Missing parent
    folders are made. When the block raises, Ctrl-C included, the temporary file is removed and an
    older file at `path` stays unchanged.

    Raises:
        OutputError: the file cannot be written, or the block wrote none.
    """
    temporary = _temporary(path)
    _WRITING.add(temporary.name)
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
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        _WRITING.discard(temporary.name)


def read_gzipped(path: Path) -> bytes:
    """Return the content of a file, decompressed if it is gzipped.

    Raises:
        SourceError: it cannot be read, or the gzip stream is damaged.
    """
    try:
        data = path.read_bytes()
        return gzip.decompress(data) if data[:2] == GZIP else data
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise SourceError(f"{path}: the gzip stream is damaged or cut off ({error})") from error
    except OSError as error:
        raise SourceError(f"{path}: cannot be read: {error.strerror or error}") from error


def readable_lines(path: Path) -> Iterator[bytes]:
    """Yield the lines of a file, gzipped or not, up to where it cannot be read."""
    with suppress(OSError, EOFError, zlib.error):
        with path.open("rb") as raw:
            zipped = raw.read(2) == GZIP
        with gzip.open(path, "rb") if zipped else path.open("rb") as lines:
            yield from lines


@contextmanager
def write_gzipped(path: Path) -> Iterator[gzip.GzipFile]:
    """Yield a file that replaces `path` when the block succeeds; the same data give the same bytes.

    Raises:
        OutputError: the file cannot be written.
    """
    with (
        atomic_write(path) as temporary,
        temporary.open("wb") as raw,
        gzip.GzipFile("", "wb", GZIP_LEVEL, raw, mtime=0) as zipped,
    ):
        yield zipped


def write_json(path: Path, document: object, default: Callable[[Any], Any] | None = None) -> None:
    """Write a document as JSON; `default` converts values that JSON lacks.

    Raises:
        OutputError: the file cannot be written.
    """
    with atomic_write(path) as temporary:
        text = json.dumps(document, indent=1, allow_nan=False, default=default)
        temporary.write_text(text + "\n", encoding="utf-8")


def write_csv(path: Path, rows: Sequence[Mapping[str, Any]], without_rows: Sequence[str]) -> None:
    """Write rows as CSV; the header is that of the first row, or `without_rows`.

    Raises:
        OutputError: the file cannot be written.
    """
    with atomic_write(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]) if rows else without_rows)
        writer.writeheader()
        writer.writerows(rows)


@contextmanager
def atomic_folder(path: Path) -> Iterator[Path]:
    """Yield a new empty folder; it replaces the folder at `path` when the block succeeds.

    The files that the manifest of the older folder names are removed, if unchanged. All other files are the
    user's and stay (see `lirs_wct.foreign_files`). When the block raises, Ctrl-C included, the temporary
    folder is removed and the older one stays unchanged. A link to a folder stays a link.

    Raises:
        OutputError: the folder cannot be written, or a file has its name.
    """
    target = path.resolve() if path.is_symlink() else path
    temporary = _temporary(target)
    _WRITING.add(temporary.name)
    try:
        if path.exists() and not path.is_dir():
            raise OutputError(f"{path}: is a file, a folder is to be written there")
        temporary.mkdir(parents=True)
        remove_leftovers([target])
        yield temporary
        write_manifest(temporary)
        _flush(temporary)
        with _lock(target.parent):
            _replace_folder(target, temporary, shown=path)
    except (OSError, OutputError) as error:
        raise _cannot_write(path, error, hidden=temporary) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        _WRITING.discard(temporary.name)


def check_writable(folder: Path | None) -> None:
    """Check before long work that files can be written to a folder.

    Args:
        folder: which may not exist yet; None = nothing is to be written.

    Raises:
        OutputError: they cannot.
    """
    if folder is None:
        return
    try:
        existing = next(path for path in (folder, *folder.absolute().parents) if path.exists())
        if not existing.is_dir():
            raise OutputError(f"{folder}: cannot be written: {existing} is a file")
        with tempfile.TemporaryFile(dir=existing):
            pass
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written: {error.strerror or error}") from error


@contextmanager
def staged_files(folder: Path) -> Iterator[Path]:
    """Yield a hidden folder whose files move into its parent when the block succeeds.

    When the block raises, Ctrl-C included, the files in the folder stay unchanged.

    Raises:
        OutputError: a file cannot be written.
    """
    staged = folder / f"{_STAGED}{os.getpid()}-{secrets.token_hex(4)}"
    try:
        remove_orphans(folder, _STAGED)
        staged.mkdir()
        yield staged
        _merge(staged, folder)
    except (OSError, OutputError) as error:
        raise _cannot_write(folder, error, hidden=staged) from error
    finally:
        shutil.rmtree(staged, ignore_errors=True)


def _merge(new: Path, old: Path) -> None:
    """Move the entries of a folder to another one; files of the same names are replaced."""
    for path in sorted(new.iterdir()):
        target = old / path.name
        _merge(path, target) if target.is_dir() else path.replace(target)


@contextmanager
def _lock(folder: Path) -> Iterator[None]:
    """Let one process at a time exchange folders below a folder; the system frees a dead process's lock."""
    if sys.platform == "win32":  # it has no locks of folders
        yield
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        # Some network file systems have no locks. One writer at a time is safe there, too.
        with suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        # A child process may have inherited the descriptor: closing it here would not unlock.
        with suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_UN)
        os.close(descriptor)


def _replace_folder(path: Path, new: Path, shown: Path) -> None:
    """Replace a folder by a new one, and move the user's files; requires the lock."""
    for leftover, _, found in _leftovers([path]):
        if found[3]:
            _recover(leftover, path)
    if not path.exists():
        new.rename(path)
        return
    replaced = _temporary(path, mark="~")
    link_foreign(path, new, later=replaced.name)
    new.rename(replaced)
    try:
        _exchange(replaced, path)
    except OSError:
        replaced.rename(new)
        raise
    move_foreign(replaced, path, shown)


def _exchange(new: Path, path: Path) -> None:
    """Exchange two folders; without support by the file system, `path` is missing for a moment."""
    if exchange(new, path):
        return
    old = _temporary(path, mark="~")
    path.rename(old)
    try:
        new.rename(path)
    except OSError:
        old.rename(path)
        raise
    old.rename(new)


def _recover(leftover: Path, path: Path) -> None:
    """Complete an exchange of folders that a killed process began; requires the lock."""
    if not leftover.is_dir():
        return
    if path.exists():
        move_foreign(leftover, path, shown=path)
    else:
        leftover.rename(path)


def _flush(folder: Path) -> None:
    """Wait until the disk has every file: otherwise a power cut after the rename leaves empty files."""
    for path in folder.rglob("*"):
        if path.is_file():
            with path.open("rb+") as file:
                os.fsync(file.fileno())


def remove_leftovers(paths: Iterable[Path]) -> None:
    """Remove the temporary files of killed processes that were writing these paths.

    Files of a running process stay. A folder that may hold the user's files is merged into its path.
    """
    for leftover, path, found in _leftovers(paths):
        if found[3]:
            # The next write of this path tries again, and reports the error.
            with suppress(OSError), _lock(path.parent):
                _recover(leftover, path)
        elif not _in_use(leftover.name, int(found[2])):
            _remove(leftover)


def _leftovers(paths: Iterable[Path]) -> Iterator[tuple[Path, Path, re.Match[str]]]:
    """Yield each temporary file or folder of these paths, its path and the parts of its name."""
    wanted = {(path.parent, f".{path.stem[:80]}", path.suffix): path for path in paths}
    for folder in {parent for parent, _, _ in wanted}:
        for name in _hidden(folder):
            found = _TEMPORARY.fullmatch(name)
            path = wanted.get((folder, found[1], found[4])) if found else None
            if found is not None and path is not None:
                yield folder / name, path, found


def remove_orphans(folder: Path, prefix: str) -> None:
    """Remove the files `PREFIXpid-...` of killed processes from a folder."""
    for entry in folder.glob(f"{prefix}*"):
        pid = entry.name.removeprefix(prefix).partition("-")[0]
        if pid.isdigit() and not lives(int(pid)):
            _remove(entry)


def _remove(entry: Path) -> None:
    with suppress(OSError):
        shutil.rmtree(entry) if entry.is_dir() else entry.unlink()


def _hidden(folder: Path) -> list[str]:
    """Return the hidden names in a folder; none where it cannot be read."""
    try:
        return [entry.name for entry in os.scandir(folder) if entry.name[0] == "."]
    except OSError:
        return []


def _in_use(name: str, pid: int) -> bool:
    """Whether a process still uses a temporary name; containers reuse process ids."""
    return name in _WRITING if pid == os.getpid() else lives(pid)


def lives(pid: int) -> bool:
    """Return whether a process of this machine is running."""
    try:
        os.kill(pid, 0)
        # A zombie has ended, but its parent has not read its exit status.
        return not re.search(r"\) Z ", Path(f"/proc/{pid}/stat").read_text(encoding="utf-8"))
    except ProcessLookupError:
        return False
    except OSError:
        return True


def _temporary(path: Path, mark: str = "") -> Path:
    """Return an unused hidden name in the same folder, so that the rename stays on one file system."""
    number = f"{os.getpid()}-{secrets.token_hex(4)}"
    return path.with_name(f".{path.stem[:80]}.{number}{mark}{path.suffix}")


def _cannot_write(path: Path, error: OSError | OutputError, hidden: Path | None = None) -> OutputError:
    """Return the error of a path; the message shows it in place of its hidden one."""
    text = str(error)
    if isinstance(error, OSError):
        where = f" ({error.filename})" if error.filename and Path(error.filename) != path else ""
        text = f"{path}: cannot be written: {error.strerror or error}{where}"
    return OutputError(text if hidden is None else text.replace(str(hidden), str(path)))
