"""Worker thread of a page: queued jobs, one of a kind, and an idle loop."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable

Job = Callable[[], None]


class PageWorker:
    """Run the jobs of one page in sequence, so that its state needs no locks.

    Args:
        on_error: called with the exception of a job; the thread continues.
        name: of the thread.
    """

    def __init__(self, on_error: Callable[[Exception], None], name: str = "page") -> None:
        self._on_error = on_error
        self._jobs: OrderedDict[str, Job] = OrderedDict()
        self._idle: Job | None = None
        self._changed = threading.Condition()
        self._closing = False
        self._at_end: Job | None = None
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def submit(self, kind: str, job: Job) -> None:
        """Queue a job; it replaces a waiting one of the same kind."""
        with self._changed:
            if not self._closing:
                self._jobs[kind] = job
                self._changed.notify()

    def repeat(self, slice_of_work: Job | None) -> None:
        """Call a short function repeatedly while no job waits; None = stop."""
        with self._changed:
            self._idle = slice_of_work
            self._changed.notify()

    def close(self, at_end: Job | None = None) -> None:
        """Drop waiting jobs and end the thread after the present job, then `at_end`."""
        with self._changed:
            self._closing, self._idle, self._at_end = True, None, at_end
            self._jobs.clear()
            self._changed.notify()

    def join(self, timeout: float | None = None) -> bool:
        """Wait for the thread's end; return whether it has ended."""
        self._thread.join(timeout)
        return not self._thread.is_alive()

    @property
    def here(self) -> bool:
        """Whether the caller runs in the worker's thread."""
        return threading.current_thread() is self._thread

    def _run(self) -> None:
        while (job := self._next()) is not None:
            self._run_job(job)
        if self._at_end is not None:
            self._run_job(self._at_end)

    def _next(self) -> Job | None:
        with self._changed:
            while not (self._closing or self._jobs or self._idle):
                self._changed.wait()
            if self._closing:
                return None
            return self._jobs.popitem(last=False)[1] if self._jobs else self._idle

    def _run_job(self, job: Job) -> None:
        try:
            job()
        except Exception as error:
            with self._changed:
                self._idle = None
            self._on_error(error)
