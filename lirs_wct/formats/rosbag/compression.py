"""Decompression of bags: whole files and chunks, also when cut off, and messages."""

from __future__ import annotations

import sys
from pathlib import Path

import lz4.frame

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

MAGIC = b"\x28\xb5\x2f\xfd"
"""First bytes of zstd data; no message in CDR begins with them."""
PIECE = 1 << 20


def decompress_message(data: bytes | memoryview) -> bytes | memoryview:
    """Decompress a message if its recorder compressed messages."""
    return zstd.decompress(data) if data[: len(MAGIC)] == MAGIC else data


class ZstdStream(zstd.ZstdFile):
    """Readable zstd stream; damage raises OSError, as in gzip."""

    def read(self, size: int | None = -1) -> bytes:
        """Return up to `size` bytes; all by default."""
        try:
            return bytes(super().read(size))
        except zstd.ZstdError as error:
            raise OSError(str(error)) from error


def decompress_file(path: Path, target: Path) -> str:
    """Decompress a file as far as possible; return its fault, empty = none."""
    inflater = zstd.ZstdDecompressor()
    with path.open("rb") as source, target.open("wb") as sink:
        while piece := source.read(PIECE):
            try:
                sink.write(inflater.decompress(piece))
            except (zstd.ZstdError, EOFError) as error:
                return "" if inflater.eof else str(error)
    return "" if inflater.eof else "its end is missing"


def decompress_start(data: bytes, compression: str) -> bytes:
    """Decompress the start of a chunk of MCAP.

    Raises:
        Exception: any exception of the libraries, for damaged data or another compression.
    """
    if not compression:
        return data
    inflater = {"zstd": zstd.ZstdDecompressor, "lz4": lz4.frame.LZ4FrameDecompressor}[compression]()
    return bytes(inflater.decompress(data))
