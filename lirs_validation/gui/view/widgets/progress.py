"""A bar in the page while something takes long."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

import viser

from lirs_wct.progress import Progress

PATIENCE = 0.4
"""Seconds before a bar appears: what is faster needs none."""
PERIOD = 0.1
"""Seconds between two updates."""


class ProgressLine:
    """A bar with a line of text, hidden while nothing goes on."""

    def __init__(self, gui: viser.GuiApi) -> None:
        self._text = gui.add_markdown("", visible=False)
        self._bar = gui.add_progress_bar(0.0, animated=True, visible=False)

    @contextmanager
    def shown(self, work: str) -> Iterator[Progress]:
        """Show the progress of a piece of work."""
        begun = last = time.monotonic()

        def progress(step: str, share: float) -> None:
            nonlocal last
            now = time.monotonic()
            if now - begun < PATIENCE or (now - last < PERIOD and self._bar.visible):
                return
            last = now
            self._text.content = f"{work}: {step}"
            self._bar.value = 100.0 * min(1.0, max(0.0, share))  # type: ignore[misc]
            self._text.visible = self._bar.visible = True

        try:
            yield progress
        finally:
            self._text.visible = self._bar.visible = False
