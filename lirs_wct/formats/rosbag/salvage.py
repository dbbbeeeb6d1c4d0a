"""MCAP files whose recorder died: complete again up to the last whole record."""

from __future__ import annotations

import shutil
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

MAGIC = b"\x89MCAP0\r\n"
CONTENTS = range(0x01, 0x08)
"""Records of a file's first part: header, schema, channel, message, chunk, index."""
END = b"\x0f" + struct.pack("<QI", 4, 0) + b"\x02" + struct.pack("<QQQI", 20, 0, 0, 0) + MAGIC
"""End of the data, and a footer that says there is no summary."""


def is_cut(path: Path) -> bool:
    """Return whether a file begins as MCAP and does not end so."""
    with path.open("rb") as file:
        begun = file.read(len(MAGIC)) == MAGIC
        size = file.seek(0, 2)
        file.seek(max(0, size - len(MAGIC)))
        return begun and file.read() != MAGIC


@contextmanager
def completed(path: Path) -> Iterator[Path]:
    """Give a temporary copy that holds the whole records of a cut file, and an end."""
    with TemporaryDirectory(prefix="lirs-wct-") as folder:
        copy = Path(folder) / path.name
        shutil.copyfile(path, copy)
        with copy.open("r+b") as file:
            size, at = copy.stat().st_size, len(MAGIC)
            while at + 9 <= size:
                file.seek(at)
                kind, length = struct.unpack("<BQ", file.read(9))
                if kind not in CONTENTS or at + 9 + length > size:
                    break
                at += 9 + length
            file.truncate(at)
            file.seek(at)
            file.write(END)
        yield copy
