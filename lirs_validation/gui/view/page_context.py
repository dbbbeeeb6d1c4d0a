"""Context shared by all tabs of a page, and the guard of its callbacks."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import viser

from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.gui.session.uploads import PageLimits, Uploads
from lirs_validation.gui.session.worker import PageWorker
from lirs_validation.gui.view.scene import DriveScene, WorldScene
from lirs_wct.errors import WctError

Callback = Callable[[Any], None]
_LOG = logging.getLogger(__name__)


class Guard:
    """Wrap the callbacks of one page, and show their errors and hints there.

    Args:
        client: the page.
        folder: folder of the page; messages omit its path.
    """

    def __init__(self, client: viser.ClientHandle, folder: Path) -> None:
        self._client, self._folder = client, folder
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
        for folder in (f"{self._folder}/maps/", f"{self._folder}/worlds/", f"{self._folder}/"):
            message = message.replace(folder, "")
        self._shown = self._client.add_notification(title, message, color=color)


@dataclass(frozen=True)
class PageContext:
    """The parts of one page.

    Attributes:
        client: connection to the browser.
        worker: thread of the page's jobs.
        guard: display of errors.
        scene: display of the world.
        drive_scene: display of the drive.
        uploads: files of the page.
        scenarios: cache of worlds.
        limits: limits of the server.
    """

    client: viser.ClientHandle
    worker: PageWorker
    guard: Guard
    scene: WorldScene
    drive_scene: DriveScene
    uploads: Uploads
    scenarios: ScenarioCache
    limits: PageLimits
