"""One page of the browser: its tabs, its worker and its folder, which end with it."""

from __future__ import annotations

import viser

from lirs_validation.gui.session.construction import Shown
from lirs_validation.gui.session.uploads import Limits, Uploads
from lirs_validation.gui.session.worker import Worker
from lirs_validation.gui.view.guard import Guard
from lirs_validation.gui.view.scene import Detail, Scene
from lirs_validation.gui.view.upload_limit import limit_uploads
from lirs_validation.gui.view.world_tab import WorldTab, first_sources


class Page:
    """What one client sees and does; nothing of it is shared with another.

    Args:
        client: the page.
        source: shown first; None = the first bundled world.
        limits: of the server.
        detail: triangles that the browser is given.
    """

    def __init__(
        self, client: viser.ClientHandle, source: str | None, limits: Limits, detail: Detail
    ) -> None:
        self.uploads = Uploads(limits)
        self._guard = Guard(client, self.uploads.folder)
        self.worker = Worker(self._guard.show, name=f"page {client.client_id}")
        limit_uploads(client, self.uploads.check_room, self._guard.show)
        scene = Scene(client, detail)
        tabs = client.gui.add_tab_group()
        with tabs.add_tab("World", viser.Icon.MOUNTAIN):
            self.world = WorldTab(
                client,
                self.worker,
                self._guard,
                scene,
                self.uploads,
                limits,
                first_sources(source),
                self._world_changed,
            )

    def _world_changed(self, shown: Shown) -> None:
        """Tell the other tabs which world the page shows."""

    def close(self) -> None:
        """End the page's work; its files go with it."""
        self.worker.close(at_end=self.uploads.close)
