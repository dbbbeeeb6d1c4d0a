"""The live page: worlds are built, robots driven and finished runs replayed in a browser."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from lirs_wct import BuildOptions, ConfigError, World
from lirs_wct.sources.source import find_source


@dataclass(frozen=True)
class EmbeddedPage:
    """A live page below a Jupyter cell, open until `close` or the kernel's end.

    Attributes:
        address: URL of the page, for browsers on this machine.
        height: Height of the frame, pixels.
    """

    address: str
    height: int
    _server: Any = field(repr=False)
    _folder: tempfile.TemporaryDirectory[str] = field(repr=False)

    def close(self) -> None:
        """End the page and free its simulation."""
        self._server.stop()
        self._folder.cleanup()

    def _repr_html_(self) -> str:
        return f'<iframe src="{self.address}" width="100%" height="{self.height}" frameborder="0"></iframe>'


def show(shown: World | str | Path, *, height: int = 640, port: int = 0) -> EmbeddedPage:
    """Return a live page with a world to view, drive in and change.

    Args:
        shown: a world, or a source of `build_world`.
        height: Height of the frame, pixels.
        port: Port to listen at, on this machine alone; 0 = any free one.

    Raises:
        WctError: there is no such source, the port is taken, or viser is not installed.
    """
    if find_spec("viser") is None:
        raise ConfigError("the live page needs viser: pip install 'lirs-wct[gui]'")
    from lirs_validation.gui.server import Server

    folder = tempfile.TemporaryDirectory(prefix="lirs-wct-")
    if isinstance(shown, World):
        source = f"{folder.name}/{shown.name}"
        shown.save(source)
    else:
        source = str(shown)
        find_source(source, BuildOptions())
    server = Server(source, port=port)
    return EmbeddedPage(server.address, height, server, folder)
