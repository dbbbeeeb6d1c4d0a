"""Files that are written whole (under a temporary name, then a rename), gzipped files, and references.

A killed process leaves temporary files behind. The next write of the same path removes them. A file that
cannot be read raises a SourceError, one that cannot be written an OutputError.
"""

from __future__ import annotations

import csv
import gzip
import hashlib
import json
import os
import re
import secrets
import shutil
import tempfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from lirs_wct.errors import OutputError, SourceError

GZIP = b"\x1f\x8b"
"""First bytes of a gzipped file."""
_TEMPORARY = re.compile(r"(\..*)\.(\d+)-[0-9a-f]{8}(|\.[^.]*)")
"""Stem, process and suffix of a temporary name."""
_WRITING: set[str] = set()
"""Temporary names that this process is using."""


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Yield a temporary path; its file replaces `path` when the block succeeds.

    The temporary name keeps the suffix, since many libraries choose the format by it. Missing parent
    folders are made. When the block raises, Ctrl-C included, the temporary file is removed and an
    older file at `path` stays unchanged.
    """
    temporary = _temporary(path)
    _WRITING.add(temporary.name)
    try:
        if path.is_dir():
            raise OutputError(f"{path}: is a folder, a file is to be written there")
        with _output_errors(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            remove_leftovers([path])
            yield temporary
            temporary.replace(path)
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        _WRITING.discard(temporary.name)


def first_bytes(path: Path, count: int = 64) -> bytes:
    """Return the first bytes of a file."""
    try:
        with path.open("rb") as file:
            head = file.read(count)
    except OSError as error:
        raise SourceError(f"{path}: cannot be read: {error.strerror or error}") from error
    if not head:
        raise SourceError(f"{path}: is empty")
    return head


def read_gzipped(path: Path) -> bytes:
    """Return the content of a file, decompressed if it is gzipped."""
    try:
        data = path.read_bytes()
        return gzip.decompress(data) if data[:2] == GZIP else data
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise SourceError(f"{path}: the gzip stream is damaged or cut off ({error})") from error
    except OSError as error:
        raise SourceError(f"{path}: cannot be read: {error.strerror or error}") from error


def read_text(path: Path, errors: str = "strict") -> str:
    """Return the text of a file in UTF-8, gzipped or not."""
    try:
        return read_gzipped(path).decode("utf-8-sig", errors)
    except UnicodeDecodeError as error:
        raise SourceError(f"{path}: no text: {error}") from error


def readable_lines(path: Path) -> Iterator[bytes]:
    """Yield the lines of a file, gzipped or not, up to where it cannot be read."""
    with suppress(OSError, EOFError, zlib.error):
        with path.open("rb") as raw:
            zipped = raw.read(2) == GZIP
        with gzip.open(path, "rb") if zipped else path.open("rb") as lines:
            yield from lines


@contextmanager
def write_gzipped(path: Path) -> Iterator[gzip.GzipFile]:
    """Yield a file that replaces `path` when the block succeeds; the same data give the same bytes."""
    # Higher levels hardly shrink sensor noise further and take many times as long.
    with (
        atomic_write(path) as temporary,
        temporary.open("wb") as raw,
        gzip.GzipFile("", "wb", compresslevel=1, fileobj=raw, mtime=0) as zipped,
    ):
        yield zipped


def write_json(path: Path, document: object, default: Callable[[Any], Any] | None = None) -> None:
    """Write a document as JSON; `default` converts values that JSON lacks."""
    with atomic_write(path) as temporary:
        text = json.dumps(document, indent=1, allow_nan=False, default=default)
        temporary.write_text(text + "\n", encoding="utf-8")


def write_csv(path: Path, rows: Sequence[Mapping[str, Any]], without_rows: Sequence[str]) -> None:
    """Write rows as CSV; the header is that of the first row, or `without_rows`."""
    with atomic_write(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]) if rows else without_rows)
        writer.writeheader()
        writer.writerows(rows)


@contextmanager
def atomic_folder(path: Path) -> Iterator[Path]:
    """Yield an empty folder; its files move to `path` when the block succeeds.

    Files that the manifest of an older folder names are replaced or removed, all others are the user's and
    stay. `MARKERS` are removed first and written last: a folder without its marker is incomplete, and the
    next write completes it. When the block raises, Ctrl-C included, the older folder stays unchanged.
    """
    target = path.resolve() if path.is_symlink() else path
    if path.exists() and not path.is_dir():
        raise OutputError(f"{path}: is a file, a folder is to be written there")
    with scratch_folder(target) as temporary, _output_errors(path, temporary):
        yield temporary
        write_manifest(temporary)
        for file in filter(Path.is_file, temporary.rglob("*")):
            with file.open("rb+") as written:  # otherwise a power cut after the rename leaves empty files
                os.fsync(written.fileno())
        if target.exists():
            _replace_files(target, temporary, shown=path)
        else:
            temporary.rename(target)


@contextmanager
def scratch_folder(path: Path) -> Iterator[Path]:
    """Yield an empty hidden folder beside a path, which is removed afterwards."""
    temporary = _temporary(path)
    _WRITING.add(temporary.name)
    try:
        with _output_errors(path, temporary):
            temporary.mkdir(parents=True)
        remove_leftovers([path])
        yield temporary
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        _WRITING.discard(temporary.name)


def _replace_files(folder: Path, new: Path, shown: Path) -> None:
    """Replace our files in a folder by new ones."""
    fresh, ours = read_manifest(new), read_manifest(folder)
    for name, digests in fresh.items():
        if name not in MARKERS or name not in ours:  # an edited marker is this program's, too
            _check_free(folder, name, digests | ours.get(name, set()), shown)
    with atomic_write(folder / MANIFEST) as manifest:  # of both, in case this write is broken off
        manifest.write_text(_lines(ours) + _lines(fresh), encoding="utf-8")
    for name in ours.keys() & set(MARKERS):
        if name in fresh:
            (folder / name).unlink(missing_ok=True)
        else:
            _remove_ours(folder, name, ours[name])
    for name in sorted(fresh.keys() - set(MARKERS)):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (new / name).replace(folder / name)
    for name in ours.keys() - fresh.keys():
        _remove_ours(folder, name, ours[name])
    for name in (MANIFEST, *(name for name in MARKERS if name in fresh)):
        (new / name).replace(folder / name)


def _check_free(folder: Path, name: str, digests: set[str], shown: Path) -> None:
    """Raise OutputError if the user has a file of this name, or changed ours."""
    for part in (*Path(name).parents[-2::-1], Path(name)):
        path, is_last = folder / part, part == Path(name)
        legal = _is_ours(folder, name, digests) if is_last else path.is_dir() and not path.is_symlink()
        if os.path.lexists(path) and not legal:
            reason = "was not written by this program, or was changed since"
            raise OutputError(f"{shown / part}: {reason}: move it away, or write to another folder")


def _is_ours(folder: Path, name: str, digests: set[str]) -> bool:
    """Whether a file is unchanged, and lies behind no link of the user."""
    linked = any((folder / part).is_symlink() for part in (Path(name), *Path(name).parents[:-1]))
    return not linked and (folder / name).is_file() and digest(folder / name) in digests


def _remove_ours(folder: Path, name: str, digests: set[str]) -> None:
    """Remove an unchanged file of ours, and the folders that are then empty."""
    if _is_ours(folder, name, digests):
        (folder / name).unlink()
        for parent in Path(name).parents[:-1]:
            with suppress(OSError):
                (folder / parent).rmdir()


MARKERS = ("world.json", "record.json", "episode.json", "twin.json", "collisions.json")
"""Files without which a folder is incomplete."""
MANIFEST = "manifest-sha256.txt"
"""Digests of the files that this program wrote, as `sha256sum` writes and checks them."""


def write_manifest(folder: Path) -> None:
    """List every file that a folder holds now."""
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path.name != MANIFEST)
    listed = {path.relative_to(folder).as_posix(): {digest(path)} for path in files}
    (folder / MANIFEST).write_text(_lines(listed), encoding="utf-8")


def _lines(listed: dict[str, set[str]]) -> str:
    return "".join(f"{value}  {name}\n" for name, digests in listed.items() for value in sorted(digests))


def read_manifest(folder: Path) -> dict[str, set[str]]:
    """Return the digests by file name; none if the manifest is missing or damaged.

    A write that was broken off leaves those of its old and new files.
    """
    digests: dict[str, set[str]] = {}
    with suppress(OSError, UnicodeDecodeError):
        for line in (folder / MANIFEST).read_text(encoding="utf-8").splitlines():
            value, _, name = line.partition("  ")
            if not Path(name).anchor and ".." not in Path(name).parts:  # others lie outside the folder
                digests.setdefault(name, set()).add(value)
    return digests


def digest(path: Path) -> str:
    """Return the SHA-256 digest of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def check_writable(folder: Path | None) -> None:
    """Check before long work that files can be written to a folder, which need not exist; None = no files."""
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
    """Yield a hidden folder whose files move into its parent when the block succeeds."""
    with scratch_folder(folder / "staged") as staged, _output_errors(folder, staged):
        yield staged
        _merge(staged, folder)


def _merge(new: Path, old: Path) -> None:
    """Move the entries of a folder to another one; files of the same names are replaced."""
    for path in sorted(new.iterdir()):
        target = old / path.name
        _merge(path, target) if target.is_dir() else path.replace(target)


def remove_leftovers(paths: Iterable[Path]) -> None:
    """Remove the temporary files of killed processes that were writing these paths."""
    wanted = {(path.parent, f".{path.stem[:80]}", path.suffix) for path in paths}
    for folder in {parent for parent, _, _ in wanted}:
        for entry in os.scandir(folder) if os.access(folder, os.R_OK) else ():
            match = _TEMPORARY.fullmatch(entry.name)
            if match and (folder, match[1], match[3]) in wanted and not _in_use(entry.name, int(match[2])):
                with suppress(OSError):
                    shutil.rmtree(entry) if entry.is_dir() else Path(entry).unlink()


def _in_use(name: str, pid: int) -> bool:
    """Whether a process of this machine still uses a temporary name; containers reuse process ids."""
    if pid == os.getpid():
        return name in _WRITING
    try:
        os.kill(pid, 0)
        # A zombie has ended, but its parent has not read its exit status.
        return not re.search(r"\) Z ", Path(f"/proc/{pid}/stat").read_text(encoding="utf-8"))
    except ProcessLookupError:
        return False
    except OSError:
        return True


def _temporary(path: Path) -> Path:
    """Return an unused hidden name in the same folder, so that the rename stays on one file system."""
    number = f"{os.getpid()}-{secrets.token_hex(4)}"
    return path.with_name(f".{path.stem[:80]}.{number}{path.suffix}")


@contextmanager
def _output_errors(path: Path, hidden: Path | None = None) -> Iterator[None]:
    """Convert errors to one line that shows the path in place of its hidden one."""
    try:
        yield
    except (OSError, OutputError) as error:
        text = str(error)
        if isinstance(error, OSError):
            where = f" ({error.filename})" if error.filename and Path(error.filename) != path else ""
            text = f"{path}: cannot be written: {error.strerror or error}{where}"
        raise OutputError(text if hidden is None else text.replace(str(hidden), str(path))) from error


_SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+._-]+:")
"""Begins a URL, or a driver's prefix of GDAL; one letter is a drive of Windows."""
_PACKAGE = ("model.config", "world.json")
"""Files that mark the top folder of a Gazebo model package, and of a built world."""


def referenced_file(owner: Path, name: str) -> Path:
    """Return the path of a referenced file, which need not exist.

    A relative name begins at the owner's folder, `model://NAME/...` at the folder of its model package. Other
    URLs are refused, and files outside the owner's folder or package, also through `..` or a symbolic link.

    Args:
        owner: File that holds the reference.
        name: Name as the owner spells it: a path, `file://` or `model://`.
    """
    folder = owner.parent.resolve()
    package = next(
        (at for at in (folder, *folder.parents) if any((at / n).is_file() for n in _PACKAGE)), None
    )
    root, base, rest = package or folder, folder, name.strip()
    if rest.startswith("model://") and package is not None:
        root = base = package.parent
        rest = unquote(rest.removeprefix("model://"))
    elif rest.startswith("file://"):
        rest = unquote(urlsplit(rest).path)
    if rest.startswith(("/vsi", "\\\\", "<")) or "\0" in rest or _SCHEME.match(rest):
        raise SourceError(f"{owner}: names {_short(name)}; only files in {root} are read")
    try:
        target = (base / rest).resolve()
    except (OSError, RuntimeError) as error:  # too long, or a loop of links
        raise SourceError(f"{owner}: names {_short(name)}, which is no legal path") from error
    if not target.is_relative_to(root):
        raise SourceError(
            f"{owner}: names {_short(name)}, which is outside {root}; only files in it are read"
        )
    return target


def _short(name: str) -> str:
    text = " ".join(name.split())
    return repr(text if len(text) <= 200 else f"{text[:200]}...")
