"""Thread pool for pieces of work that depend on each other."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from queue import SimpleQueue
from threading import Lock
from typing import Any

Work = Callable[[], Sequence[Any]]
"""A piece of work; it returns the pieces that depend on it."""


class WorkThreads:
    """Pool of `count` threads, including the calling one; a forked process makes its own."""

    def __init__(self, count: int) -> None:
        self.count = count
        self._make_pool()

    def _make_pool(self) -> None:
        self._pid = os.getpid()
        self._pool = ThreadPoolExecutor(self.count - 1) if self.count > 1 else None

    def __getstate__(self) -> dict[str, Any]:
        return {"count": self.count}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(**state)  # type: ignore[misc]

    def close(self) -> None:
        """End the threads; later work runs in the calling thread."""
        if self._pool is not None and self._pid == os.getpid():
            self._pool.shutdown()
        self._pool = None

    def run(self, pieces: Sequence[Work]) -> None:
        """Do pieces of work, and the pieces that they return, until all are done.

        Several pieces may run at the same time.
        """
        if not pieces:
            return
        if self._pool is not None and self._pid != os.getpid():
            self._make_pool()  # Threads do not survive a fork.
        job = _Job(pieces, 1 if self._pool is None else self.count)
        helpers = [] if self._pool is None else [self._pool.submit(job.work) for _ in range(self.count - 1)]
        try:
            job.work()
        finally:
            for helper in helpers:
                helper.result()


class _Job:
    """Queue of pieces of work for `count` threads."""

    def __init__(self, pieces: Sequence[Work], count: int) -> None:
        self._count, self._open, self._lock = count, len(pieces), Lock()
        self._waiting: SimpleQueue[Work | None] = SimpleQueue()
        for piece in pieces:
            self._waiting.put(piece)

    def work(self) -> None:
        """Do pieces until all are done, or one has raised."""
        while (piece := self._waiting.get()) is not None:
            try:
                more = piece()
            except BaseException:
                self._end()
                raise
            with self._lock:  # Count them before another thread can take and finish one.
                self._open += len(more) - 1
                over = not self._open
            for later in more:
                self._waiting.put(later)
            if over:
                self._end()

    def _end(self) -> None:
        for _ in range(self._count):
            self._waiting.put(None)
