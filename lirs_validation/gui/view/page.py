"""One page of the browser: its tabs, its worker and its folder, which end with it."""

from __future__ import annotations

from pathlib import Path

import viser

from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.gui.session.construction import Shown
from lirs_validation.gui.session.uploads import Limits, Uploads
from lirs_validation.gui.session.worker import Worker
from lirs_validation.gui.view.drive_scene import DriveScene
from lirs_validation.gui.view.drive_tab import DriveTab
from lirs_validation.gui.view.guard import Guard
from lirs_validation.gui.view.page_context import PageContext
from lirs_validation.gui.view.replay_tab import ReplayTab
from lirs_validation.gui.view.scene import Detail, Scene
from lirs_validation.gui.view.upload_limit import limit_uploads
from lirs_validation.gui.view.world_tab import WorldTab, first_sources


class Page:
    """What one client sees and does; nothing of it is shared with another.

    Args:
        client: the page.
        source: shown first; None = the first bundled world.
        runs: folder of finished runs on the server; None = there is none.
        limits: of the server.
        detail: triangles that the browser is given.
    """

    def __init__(
        self,
        client: viser.ClientHandle,
        source: str | None,
        runs: Path | None,
        limits: Limits,
        detail: Detail,
    ) -> None:
        self.client_id = client.client_id
        self.uploads = Uploads(limits)
        self.guard = Guard(client, self.uploads.folder)
        self.worker = Worker(self.guard.show, name=f"page {client.client_id}")
        limit_uploads(client, self.uploads.check_room, self.guard.show)
        self._drive_scene = DriveScene(client)
        context = PageContext(
            client,
            self.worker,
            self.guard,
            Scene(client, detail),
            self._drive_scene,
            self.uploads,
            ScenarioCache(),
            limits,
        )
        self._add_tabs(context, source, runs)
        self.world.preview()

    def _add_tabs(self, context: PageContext, source: str | None, runs: Path | None) -> None:
        tabs = context.client.gui.add_tab_group()
        with tabs.add_tab("World", viser.Icon.MOUNTAIN):
            self.world = WorldTab(context, first_sources(source), self._world_changed)
        with tabs.add_tab("Drive", viser.Icon.STEERING_WHEEL):
            self.drive = DriveTab(context, lambda: self.world.shown, self._drive_begins)
        with tabs.add_tab("Replay", viser.Icon.HISTORY):
            self.replay = ReplayTab(context, runs, self._replay_begins)

    def _world_changed(self, _: Shown) -> None:
        """Drop drive and replay: their world is no longer shown."""
        self.drive.forget()
        self.replay.forget()
        self._drive_scene.clear()

    def _drive_begins(self) -> None:
        self.replay.forget()
        self._drive_scene.clear()

    def _replay_begins(self) -> None:
        self.drive.forget()
        self._drive_scene.clear()

    def close(self) -> None:
        """End the page's work; its simulation and its files go with it."""
        self.worker.close(at_end=self._free)

    def _free(self) -> None:
        self.drive.drive = self.replay.run = None
        self.uploads.close()
