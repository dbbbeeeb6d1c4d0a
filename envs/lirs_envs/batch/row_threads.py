"""Threads that share the work on rows."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from lirs_wct.arrays import IntArray

PARTS = 4
"""Parts of the rows that each thread takes, one after the other: they do not take equally long."""


class RowThreads:
    """Runs work on parts of rows, on `count` threads, the calling one among them."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._pool = ThreadPoolExecutor(count - 1) if count > 1 else None

    def __getstate__(self) -> dict[str, Any]:
        return {"count": self._count}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(**state)  # type: ignore[misc]

    def close(self) -> None:
        """End the threads; whatever comes after runs in one."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

    def run(self, work: Callable[[IntArray], None], rows: IntArray) -> None:
        """Call `work` with parts of rows, perhaps from several threads at a time, until all are done."""
        if self._pool is None or len(rows) < 2:
            if len(rows):
                work(rows)
            return
        share = -(-len(rows) // (PARTS * self._count))
        parts = deque(rows[k : k + share] for k in range(0, len(rows), share))

        def take() -> None:
            while True:
                try:
                    part = parts.popleft()
                except IndexError:
                    return
                work(part)

        helpers = [self._pool.submit(take) for _ in range(min(self._count, len(parts)) - 1)]
        take()
        for helper in helpers:
            helper.result()
