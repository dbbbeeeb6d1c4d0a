"""The garbage collector beside work that is timed."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def heap_at_rest() -> Iterator[None]:
    """Leave what is there to Python's garbage collector until the block is over.

    The compiler and its modules hold a million objects: a look through them takes 0.1 s, in the middle of
    whichever scan it falls on. What the block makes is collected as ever.
    """
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
