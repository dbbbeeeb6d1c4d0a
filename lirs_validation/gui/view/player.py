"""Player of a drive: the latest moment while it runs, others by the timeline."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import viser

from lirs_validation.gui.session.construction import Facts
from lirs_validation.gui.session.playback import Playback
from lirs_validation.gui.view.page_context import Guard
from lirs_validation.gui.view.scene import DriveScene

PERIOD = 0.12
"""Seconds between two pictures."""


class Player:
    """A timeline with figures below it.

    Attributes:
        scan: that is shown.

    Args:
        gui: of the page.
        guard: of its callbacks.
        scene: where the drive is shown.
        moved: called when a person moves the timeline, before that moment is shown.
        submit: queues work of the page.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        guard: Guard,
        scene: DriveScene,
        moved: Callable[[], None],
        submit: Callable[[str, Callable[[], None]], None],
    ) -> None:
        self._scene, self._moved, self._submit = scene, moved, submit
        self.playback: Playback | None = None
        self.scan, self._shown_at = 0, 0.0
        self._slider = gui.add_slider("timeline [s]", 0.0, 1.0, 0.1, 0.0, visible=False)
        self._slider.on_update(guard(self._go_to_slider))
        self._facts = gui.add_markdown("")

    def begin(self, playback: Playback, seconds: float) -> None:
        """Show another drive with a timeline of the given length."""
        self.playback, self.scan, self._shown_at = None, 0, 0.0
        self._slider.max = max(0.1, seconds)
        self._slider.visible = True
        self.playback = playback
        self._scene.begin(playback.robot, playback.world)
        self.show(0)

    def end(self) -> None:
        """Show no drive."""
        self.playback = None
        self._slider.visible = False
        self._facts.content = ""

    def show(self, scan: int) -> None:
        """Show a moment, and move the timeline there."""
        if self.playback is None:
            return
        self.scan = max(0, min(scan, self.playback.scans - 1))
        moment = self.playback.moment(self.scan)
        self._scene.show(moment)
        slider: Any = self._slider
        slider.value = min(round(moment.time, 1), float(self._slider.max))
        self._facts.content = as_table(moment.facts)
        self._shown_at = time.monotonic()

    @property
    def due(self) -> bool:
        """Whether another picture is due."""
        return time.monotonic() - self._shown_at >= PERIOD

    def _go_to_slider(self, event: Any) -> None:
        if event.client_id is None or self.playback is None:
            return  # moved by `show`
        wanted = float(self._slider.value)  # now: a moment that is still being shown moves the timeline back
        self._moved()
        self._submit("timeline", lambda: self._show_time(wanted))

    def _show_time(self, time: float) -> None:
        if self.playback is not None and self.playback.scans > 1:
            period = self.playback.moment(1).time - self.playback.moment(0).time
            self.show(round(time / period))


def as_table(facts: Facts) -> str:
    """Return facts as a table in Markdown."""
    rows = (f"| {name} | {value} |".replace("\n", " ") for name, value in facts)
    return "\n".join(("| | |", "|---|---|", *rows))
