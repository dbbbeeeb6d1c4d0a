"""Server of the live page: one page per client, closed when the client disconnects."""

from __future__ import annotations

import socket
import threading
import time
import warnings
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import rich
import viser

from lirs_validation.gui.page_html import served_from, write_page
from lirs_validation.gui.view.page import Page
from lirs_wct.errors import ConfigError


class Server:
    """Serves pages until it is stopped.

    Args:
        source: source shown first; None = the first bundled world.
        runs: folder of finished runs that pages may open; None = no folder.
        host: address to listen at.
        port: Port to listen at; 0 = any free one.

    Raises:
        ConfigError: the address cannot be listened at.
    """

    def __init__(
        self,
        source: str | None = None,
        *,
        runs: Path | None = None,
        host: str = "127.0.0.1",
        port: int = 8080,
    ) -> None:
        self._source, self._runs = source, runs
        self._pages: dict[int, Page] = {}
        self._lock = threading.Lock()
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
        with self._lock:
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
        with self._lock:
            pages = list(self._pages.values())
            self._pages.clear()
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
            page.guard.note(str(message))

    def _open(self, client: Any) -> None:
        page = Page(client, self._source, self._runs)
        with self._lock:
            self._pages[client.client_id] = page
        if client.client_id not in self._viser.get_clients():  # gone while its page was made
            self._close(client)

    def _close(self, client: Any) -> None:
        with self._lock:
            page = self._pages.pop(client.client_id, None)
        if page is not None:
            page.close()


def _check_free(host: str, port: int) -> None:
    """Raise ConfigError unless the address is free; viser would try other ports endlessly."""
    try:
        family, kind, *_, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except OSError as error:
        raise ConfigError(f"{host}:{port}: cannot be listened at: {error.strerror or error}") from error
