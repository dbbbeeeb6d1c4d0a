"""Files that are gzipped or not."""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from lirs_wct.errors import SourceError
from lirs_wct.files import atomic_write

MAGIC = b"\x1f\x8b"
LEVEL = 1
"""Level of gzip: higher ones hardly shrink sensor noise further and take many times as long."""


def read_gzipped(path: Path) -> bytes:
    """Return the content of a file, decompressed if it is gzipped.

    Raises:
        SourceError: it cannot be read, or the gzip stream is damaged.
    """
    try:
        data = path.read_bytes()
        return gzip.decompress(data) if data[:2] == MAGIC else data
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise SourceError(f"{path}: the gzip stream is damaged or cut off ({error})") from error
    except OSError as error:
        raise SourceError(f"{path}: cannot be read: {error.strerror or error}") from error


def readable_lines(path: Path) -> Iterator[bytes]:
    """Yield the lines of a file, gzipped or not, up to where it cannot be read."""
    with suppress(OSError, EOFError, zlib.error):
        with path.open("rb") as raw:
            zipped = raw.read(2) == MAGIC
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
        gzip.GzipFile("", "wb", LEVEL, raw, mtime=0) as zipped,
    ):
        yield zipped
