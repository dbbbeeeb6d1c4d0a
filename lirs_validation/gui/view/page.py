"""A page: the tabs of one client."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import viser
from viser import _messages

from lirs_validation.experiment.scenario import ScenarioCache
from lirs_validation.gui.session.construction import Shown
from lirs_validation.gui.session.playback import ground_point
from lirs_validation.gui.session.uploads import PageLimits, Uploads
from lirs_validation.gui.view.page_context import Guard, PageContext, PageWorker
from lirs_validation.gui.view.playback_tabs import DriveTab, ReplayTab
from lirs_validation.gui.view.scene import Detail, DriveScene, WorldScene
from lirs_validation.gui.view.world_tab import WorldTab, first_sources
from lirs_wct.errors import WctError


def limit_uploads(
    client: viser.ClientHandle, check: Callable[[str, int], None], refused: Callable[[Exception], None]
) -> None:
    """Refuse uploads before they fill the memory.

    viser has no limit of its own and calls back only when all parts of a file are in memory. Therefore this
    function, and no other, uses private parts of viser 1.1.

    Args:
        client: the page.
        check: called with name and announced size, and again with received bytes; raises WctError.
        refused: called with that error.
    """
    gui = client.gui
    connection = client._websock_connection

    def drop(transfer: str, error: WctError) -> None:
        gui._current_file_upload_states.pop(transfer, None)
        refused(error)

    def check_announced(_: int, message: _messages.FileTransferStartUpload) -> None:
        if message.transfer_uuid in gui._current_file_upload_states:
            try:
                check(message.filename, message.size_bytes)
            except WctError as error:
                drop(message.transfer_uuid, error)

    def check_arrived(_: int, message: _messages.FileTransferPart) -> None:
        state = gui._current_file_upload_states.get(message.transfer_uuid)
        if state is not None and state["transferred_bytes"] > state["total_bytes"]:
            try:
                check(state["filename"], state["transferred_bytes"])
            except WctError as error:
                drop(message.transfer_uuid, error)

    connection.register_handler(_messages.FileTransferStartUpload, check_announced)
    connection.register_handler(_messages.FileTransferPart, check_arrived)


class Page:
    """State and tabs of one client, separate from other clients.

    Args:
        client: the page.
        source: source shown first; None = the first bundled world.
        runs: folder of finished runs on the server; None = no folder.
        limits: limits of the server.
        detail: numbers of triangles sent to the browser.
    """

    def __init__(
        self,
        client: viser.ClientHandle,
        source: str | None,
        runs: Path | None,
        limits: PageLimits,
        detail: Detail,
    ) -> None:
        self.client_id = client.client_id
        self.uploads = Uploads(limits)
        self.guard = Guard(client)
        self.worker = PageWorker(self.guard.show, name=f"page {client.client_id}")
        limit_uploads(client, self.uploads.check_room, self.guard.show)
        self._drive_scene = DriveScene(client)
        self._context = context = PageContext(
            client,
            self.worker,
            self.guard,
            WorldScene(client, detail),
            self._drive_scene,
            self.uploads,
            ScenarioCache(),
            limits,
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
            self.drive = DriveTab(context, lambda: self.world.shown, self._drive_begins)
        with tabs.add_tab("Replay", viser.Icon.HISTORY):
            self.replay = ReplayTab(context, runs, self._replay_begins)

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
        self.drive.forget()
        self.replay.forget()
        self._context.scene.unmark()
        self._drive_scene.clear()

    def _drive_begins(self) -> None:
        self.replay.forget()
        self._drive_scene.clear()

    def _replay_begins(self) -> None:
        self.drive.forget()
        self._drive_scene.clear()

    def close(self) -> None:
        """End the page's work; free its simulation and its files."""
        self.worker.close(at_end=self._free)

    def _free(self) -> None:
        self.drive.playback = self.replay.playback = None
        self.uploads.close()
