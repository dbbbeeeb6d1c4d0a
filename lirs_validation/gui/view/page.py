"""A page: the tabs of one client."""

from __future__ import annotations

from pathlib import Path

import viser

from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.gui.session.construction import Shown
from lirs_validation.gui.session.uploads import Uploads
from lirs_validation.gui.view.page_context import Guard, PageContext, PageWorker
from lirs_validation.gui.view.playback_tabs import DriveTab, ReplayTab
from lirs_validation.gui.view.scene import DriveScene, WorldScene, ground_point
from lirs_validation.gui.view.world_tab import WorldTab, first_sources


class Page:
    """State and tabs of one client, separate from other clients."""

    def __init__(self, client: viser.ClientHandle, source: str | None, runs: Path | None) -> None:
        self.client_id = client.client_id
        self.uploads = Uploads()
        self.guard = Guard(client)
        self.worker = PageWorker(self.guard.show, name=f"page {client.client_id}")
        self._drive_scene = DriveScene(client)
        self._context = context = PageContext(
            client,
            self.worker,
            self.guard,
            WorldScene(client),
            self._drive_scene,
            self.uploads,
            ScenarioCache(),
        )
        self._add_tabs(context, source, runs)
        client.gui.add_command("Pause or go on", hotkey="space").on_trigger(self.guard(self._press_play))
        client.scene.on_click()(self.guard(self._click))
        self.world.preview()

    def _add_tabs(self, context: PageContext, source: str | None, runs: Path | None) -> None:
        tabs = context.client.gui.add_tab_group()
        with tabs.add_tab("World", viser.Icon.MOUNTAIN):
            self.world = WorldTab(context, first_sources(source), self._world_changed)
        with tabs.add_tab("Drive", viser.Icon.STEERING_WHEEL):
            self.drive = DriveTab(context, lambda: self.world.shown, lambda: self._forget(self.replay))
        with tabs.add_tab("Replay", viser.Icon.HISTORY):
            self.replay = ReplayTab(context, runs, lambda: self._forget(self.drive))

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
        self._context.scene.unmark()

    def _forget(self, *tabs: DriveTab | ReplayTab) -> None:
        for tab in tabs:
            tab.forget()
        self._drive_scene.clear()

    def close(self) -> None:
        """End the page's work; free its simulation and its files."""
        self.worker.close(at_end=self._free)

    def _free(self) -> None:
        self.drive.playback = self.replay.playback = None
        self.uploads.close()
