"""A page: the tabs of one client."""

from __future__ import annotations

from pathlib import Path

import viser

from lirs_validation.gui.session.construction import Shown
from lirs_validation.gui.view.page_context import PageContext
from lirs_validation.gui.view.playback_tabs import DriveTab, ReplayTab
from lirs_validation.gui.view.scene import ground_point
from lirs_validation.gui.view.world_tab import WorldTab, first_sources


class Page(PageContext):
    """State and tabs of one client, separate from other clients."""

    def __init__(self, client: viser.ClientHandle, source: str | None, runs: Path | None) -> None:
        super().__init__(client)
        self._add_tabs(source, runs)
        client.gui.add_command("Pause or go on", hotkey="space").on_trigger(self.guard(self._press_play))
        client.scene.on_click()(self.guard(self._click))
        self.world.preview()

    def _add_tabs(self, source: str | None, runs: Path | None) -> None:
        tabs = self.client.gui.add_tab_group()
        with tabs.add_tab("World", viser.Icon.MOUNTAIN):
            self.world = WorldTab(self, first_sources(source), self._world_changed)
        with tabs.add_tab("Drive", viser.Icon.STEERING_WHEEL):
            self.drive = DriveTab(self, lambda: self.world.shown, lambda: self._forget(self.replay))
        with tabs.add_tab("Replay", viser.Icon.HISTORY):
            self.replay = ReplayTab(self, runs, lambda: self._forget(self.drive))

    def _press_play(self, _: object) -> None:
        """Pause the drive or the replay, or let it go on."""
        (self.drive if self.replay.playback is None else self.replay).press_play()

    def _click(self, event: viser.SceneClickEvent) -> None:
        """Pass a click on the ground to the drive."""
        if self.world.shown is None:
            return
        surface = self.world.shown.world.surface
        place = ground_point(surface, event.ray_origin, event.ray_direction)
        if place is not None:
            self.drive.click(place)

    def _world_changed(self, _: Shown) -> None:
        """Drop drive and replay: their world is no longer shown."""
        self._forget(self.drive, self.replay)
        self.scene.unmark()

    def _forget(self, *tabs: DriveTab | ReplayTab) -> None:
        for tab in tabs:
            tab.forget()
        self.drive_scene.clear()

    def close(self) -> None:
        """End the page's work; free its simulation and its files."""
        self.worker.close(at_end=self._free)

    def _free(self) -> None:
        self.drive.playback = self.replay.playback = None
        self.uploads.close()
