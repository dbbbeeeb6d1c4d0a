"""CPU contention: whether other runs share this machine, which spoils a real-time factor."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO

if sys.platform != "win32":
    import fcntl


@dataclass
class Contention:
    """Whether other runs shared the machine; final once its block has ended."""

    found: bool = False


@contextmanager
def cpu_contention() -> Iterator[Contention]:
    """Notice every other block of this kind that overlaps, in any process of this user.

    All hold one file's shared lock; the kernel gives it back even after a kill. Who comes second sees
    the lock, and leaves a byte for those who were there before.
    """
    contention = Contention()
    if sys.platform == "win32":  # has no such locks: none is noticed there
        yield contention
        return
    with _lock_file().open("ab", buffering=0) as file:
        before = _size(file)
        contention.found = not _alone(file)
        if contention.found:
            with suppress(OSError):  # a full disk: those before do not learn of this run
                file.write(b".")
        fcntl.flock(file, fcntl.LOCK_SH)
        yield contention
        contention.found = contention.found or _size(file) != before


def _alone(file: IO[bytes]) -> bool:
    if sys.platform == "win32":
        return True
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def _size(file: IO[bytes]) -> int:
    return os.fstat(file.fileno()).st_size


def _lock_file() -> Path:
    owner = os.getuid() if hasattr(os, "getuid") else "all"
    return Path(tempfile.gettempdir()) / f"lirs-wct-{owner}.lock"
