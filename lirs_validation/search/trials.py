"""Trials of a search: concurrent, and their scores kept in a file for resumption."""

from __future__ import annotations

import hashlib
import json
import multiprocessing
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any, Generic, TypeVar

from lirs_wct.errors import OutputError, WctError

Score = TypeVar("Score")
Arguments = tuple[Any, ...]
"""Arguments of the function that measures a trial."""


def trial_key(entry: Mapping[str, Any]) -> str:
    """Return the digest of everything that decides a trial."""
    return hashlib.sha256(json.dumps(entry, sort_keys=True).encode()).hexdigest()[:16]


class TrialArchive(Generic[Score]):
    """Measures trials, counts them and keeps their scores.

    Attributes:
        count: number of different trials that were requested, those of an earlier search included.

    Args:
        path: of the file.
        kind: class of the scores, a dataclass.
        pool: measures in other processes; None = in this one.
    """

    def __init__(self, path: Path, kind: type[Score], pool: Executor | None = None) -> None:
        self.count = 0
        self._path, self._pool = path, pool
        self._kept: dict[str, Score] = _read_archive(path, kind)
        self._used: set[str] = set()

    def scores(
        self, measure: Callable[..., Score], trials: Sequence[tuple[str, Arguments]], method: str
    ) -> list[Score]:
        """Return the scores of trials, in their order.

        Args:
            measure: returns the score of a trial's arguments.
            trials: key and arguments of each.
            method: name of the method in messages.

        Raises:
            WctError: a worker process died, or the file cannot be written.
        """
        pending = {key: arguments for key, arguments in trials if key not in self._kept}
        for key, score in zip(pending, self._measure(measure, list(pending.values()), method), strict=True):
            self._keep(key, score)
        keys = [key for key, _ in trials]
        self.count += len(set(keys) - self._used)
        self._used |= set(keys)
        return [self._kept[key] for key in keys]

    def _measure(
        self, measure: Callable[..., Score], trials: Sequence[Arguments], method: str
    ) -> Iterator[Score]:
        """Yield the scores of new trials in their order."""
        if self._pool is None:
            for arguments in trials:
                yield measure(*arguments)
            return
        futures: list[Future[Score]] = [self._pool.submit(measure, *arguments) for arguments in trials]
        try:
            for future in futures:
                yield future.result()
        except BrokenProcessPool:
            raise WctError(
                f"a process that drove {method} died; the same command continues the search"
            ) from None
        finally:
            for future in futures:
                future.cancel()

    def _keep(self, key: str, score: Any) -> None:
        """Append a score to the file.

        Raises:
            OutputError: it cannot be written.
        """
        self._kept[key] = score
        try:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps({"key": key} | asdict(score)) + "\n")
        except OSError as error:
            raise OutputError(f"{self._path}: cannot be written: {error.strerror or error}") from error


def _read_archive(path: Path, kind: type[Score]) -> dict[str, Score]:
    """Return the scores in an archive; an incomplete last line is removed."""
    if not path.is_file():
        return {}
    lines = path.read_bytes().splitlines(keepends=True)
    whole = [line for line in lines if line.endswith(b"\n")]
    if whole != lines:
        path.write_bytes(b"".join(whole))
    found: dict[str, Score] = {}
    for number, line in enumerate(whole, start=1):
        try:
            entry: dict[str, Any] = json.loads(line)
            key = entry.pop("key")
            found[key] = kind(**entry)
        except (ValueError, KeyError, TypeError, AttributeError):
            raise OutputError(f"{path}: line {number} is damaged; remove it to drive again") from None
    return found


@contextmanager
def process_pool(jobs: int) -> Iterator[Executor | None]:
    """Give the processes for concurrent drives; None for one job."""
    if jobs == 1:
        yield None
        return
    pool = ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn"))
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
