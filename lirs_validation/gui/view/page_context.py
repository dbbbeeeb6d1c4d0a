"""Context shared by the tabs of a page: its worker thread and its messages."""

from __future__ import annotations

import logging
import re
import threading
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import viser

from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.gui.session.controls import without_flags
from lirs_validation.gui.session.uploads import Uploads
from lirs_validation.gui.view.scene import DriveScene, WorldScene
from lirs_wct.errors import WctError

Callback = Callable[[Any], None]
Job = Callable[[], None]
ABSOLUTE_PATH = re.compile(r"(?<![\w.:/])/(?:[^\s/:;,'\"]+/)*([^\s/:;,'\"]+)")
"""A path on the server, of which messages show the last part."""
_LOG = logging.getLogger(__name__)


class Guard:
    """Wrap the callbacks of one page, and show their errors and hints there."""

    def __init__(self, client: viser.ClientHandle) -> None:
        self._client = client
        self._shown: viser.NotificationHandle | None = None
        self._notes: list[str] = []

    def __call__(self, callback: Callback) -> Callback:
        """Return a callback whose errors are shown."""

        def run(event: Any) -> None:
            try:
                callback(event)
            except Exception as error:
                self.show(error)

        return run

    def show(self, error: Exception) -> None:
        """Show an error instead of the last one; log it unless it is a WctError."""
        self._notes.clear()
        if isinstance(error, WctError):
            self._say("Input cannot be used", str(error), "red")
            return
        _LOG.error("a page failed", exc_info=error)
        self._say("The program failed", f"{type(error).__name__}: {error}", "red")

    def note(self, message: str) -> None:
        """Keep a hint until the present work is done."""
        self._notes.append(message)

    def done(self) -> None:
        """Remove the last error and show the collected hints."""
        notes, self._notes = self._notes, []
        if notes:
            self._say("Note", "; ".join(dict.fromkeys(notes)), "yellow")
        else:
            self._clear()

    def _clear(self) -> None:
        if self._shown is not None:
            self._shown.remove()
            self._shown = None

    def _say(self, title: str, message: str, color: Any) -> None:
        self._clear()
        message = ABSOLUTE_PATH.sub(r"\1", without_flags(message))
        self._shown = self._client.add_notification(title, message, color=color)


class PageWorker:
    """Run the jobs of one page in sequence, so that its state needs no locks.

    A job that fails is reported to `on_error`; the thread continues.
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


class PageContext:
    """Parts of one page that its tabs share: connection, thread, messages, scenes, files and worlds."""

    def __init__(self, client: viser.ClientHandle) -> None:
        self.client = client
        self.guard = Guard(client)
        self.worker = PageWorker(self.guard.show, name=f"page {client.client_id}")
        self.scene, self.drive_scene = WorldScene(client), DriveScene(client)
        self.uploads, self.scenarios = Uploads(), ScenarioCache()
