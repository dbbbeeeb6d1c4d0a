"""Server of the live page: one page per client, closed when the client disconnects."""

from __future__ import annotations

import re
import socket
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import rich
import viser
from viser import infra

from lirs_validation.gui.page import PageContext, asset
from lirs_validation.gui.scene import ground_point
from lirs_validation.gui.tabs import DriveTab, ReplayTab, WorldTab
from lirs_wct import ConfigError

LOADING = '<div id="root"></div><div class="lirs-loading" role="status">LIRS-WCT is loading ...</div>'


class Page(PageContext):
    """State and tabs of one client, separate from other clients."""

    def __init__(self, client: viser.ClientHandle, source: str | None, runs: Path | None) -> None:
        super().__init__(client)
        tabs = client.gui.add_tab_group()
        with tabs.add_tab("World", viser.Icon.MOUNTAIN):
            self.world = WorldTab(self, source, self._world_changed)
        with tabs.add_tab("Drive", viser.Icon.STEERING_WHEEL):
            self.drive = DriveTab(self, lambda: self.world.shown, lambda: self._forget(self.replay))
        with tabs.add_tab("Replay", viser.Icon.HISTORY):
            self.replay = ReplayTab(self, runs, lambda: self._forget(self.drive))
        client.gui.add_command("Pause or go on", hotkey="space").on_trigger(self.guard(self._press_play))
        client.scene.on_click()(self.guard(self._click))
        self.world.preview()

    def _press_play(self, _: object) -> None:
        """Pause the drive or the replay, or let it go on."""
        (self.drive if self.replay.playback is None else self.replay).press_play()

    def _click(self, event: viser.SceneClickEvent) -> None:
        """Pass a click on the ground to the drive."""
        if (shown := self.world.shown) is not None:
            place = ground_point(shown.world.surface, event.ray_origin, event.ray_direction)
            if place is not None:
                self.drive.click(place)

    def _world_changed(self) -> None:
        """Drop drive and replay: their world is no longer shown."""
        self._forget(self.drive, self.replay)
        self.scene.unmark()

    def _forget(self, *tabs: DriveTab | ReplayTab) -> None:
        for tab in tabs:
            tab.forget()
        self.drive_scene.clear()

    def close(self) -> None:
        """End the page's work; free its simulation and its files."""

        def free() -> None:
            self.drive.playback = self.replay.playback = None
            self.uploads.close()

        self.worker.close(at_end=free)


class Server:
    """Serve pages until stopped; without a source, they show the first bundled world.

    Pages may open the finished runs in the folder `runs`. Port 0 is any free one.
    """

    def __init__(
        self, source: str | None = None, *, runs: Path | None = None, host: str = "127.0.0.1", port: int
    ) -> None:
        self._source, self._runs = source, runs
        self._pages: dict[int, Page] = {}
        _check_free(host, port)
        self._show_warning = warnings.showwarning
        warnings.showwarning = self._warn
        warnings.filterwarnings("always", category=UserWarning, module="lirs_")
        # A client may disconnect while messages to it are queued.
        warnings.filterwarnings("ignore", "Queued a .* on a closed connection", UserWarning)
        rich.get_console().quiet = True  # viser's own announcements; ours have a console of their own
        self._folder = TemporaryDirectory(prefix="lirs-wct-gui-", ignore_cleanup_errors=True)
        write_page(Path(self._folder.name))
        with served_from(Path(self._folder.name)):
            self._viser = viser.ViserServer(host=host, port=port, label="LIRS-WCT", verbose=False)
        gui = self._viser.gui
        gui.configure_theme(
            control_width="medium", show_logo=False, show_share_button=False, brand_color=(0, 128, 200)
        )
        gui.main_panel.dock_right()
        self._viser.on_client_connect(self._open)
        self._viser.on_client_disconnect(self._close)

    @property
    def address(self) -> str:
        """URL of the server."""
        host = self._viser.get_host()
        return f"http://{'127.0.0.1' if host == '0.0.0.0' else host}:{self._viser.get_port()}"

    @property
    def pages(self) -> tuple[Page, ...]:
        """Open pages."""
        return tuple(self._pages.values())

    def serve(self) -> None:
        """Wait until a Ctrl-C."""
        try:
            while True:
                time.sleep(3600)
        finally:
            self.stop()

    def stop(self) -> None:
        """Close every page, then the server."""
        pages = self.pages
        for page in pages:
            page.close()
        for page in pages:
            page.worker.join(5.0)
        warnings.showwarning = self._show_warning
        self._viser.stop()
        self._folder.cleanup()

    def _warn(self, message: Warning | str, *where: Any, **more: Any) -> None:
        """Show a warning in the page whose worker raised it."""
        page = next((page for page in self.pages if page.worker.here), None)
        if page is None:
            self._show_warning(message, *where, **more)
        else:
            page.guard.note(message)

    def _open(self, client: Any) -> None:
        page = Page(client, self._source, self._runs)
        self._pages[client.client_id] = page
        if client.client_id not in self._viser.get_clients():  # gone while its page was made
            self._close(client)

    def _close(self, client: Any) -> None:
        page = self._pages.pop(client.client_id, None)
        if page is not None:
            page.close()


def write_page(folder: Path) -> None:
    """Write viser's page with our title, icon, dark mode and loading state."""
    page = (Path(viser.__file__).parent / "client/build/index.html").read_text(encoding="utf-8")
    start = page.index("<script")
    head = re.sub(r"<title>.*?</title>|<link\s+rel=\"icon\".*?/>", "", page[:start], flags=re.DOTALL)
    body = page[start:].replace('<div id="root"></div>', LOADING)
    (folder / "index.html").write_text(head + asset("head.html") + body, encoding="utf-8")


@contextmanager
def served_from(folder: Path) -> Iterator[None]:
    """Let a server that starts meanwhile serve this folder; viser has no option for it."""
    module: Any = infra
    theirs = module.WebsockServer
    module.WebsockServer = lambda **given: theirs(**given | {"http_server_root": folder})
    try:
        yield
    finally:
        module.WebsockServer = theirs


def _check_free(host: str, port: int) -> None:
    """Raise ConfigError unless the address is free; viser would try other ports endlessly."""
    try:
        family, kind, *_, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except OSError as error:
        raise ConfigError(f"{host}:{port}: cannot be listened at: {error.strerror or error}") from error
