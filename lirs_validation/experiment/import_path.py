"""Where a user's own module is looked for: in the working folder too, and only while it is needed."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


@contextmanager
def importable(folder: Path) -> Iterator[None]:
    """Put a folder first on `sys.path` in a block, unless it is there already."""
    entry = str(folder)
    if entry in sys.path:
        yield
        return
    sys.path.insert(0, entry)
    try:
        yield
    finally:
        with suppress(ValueError):
            sys.path.remove(entry)
