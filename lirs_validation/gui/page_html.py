"""HTML page around viser's client: title, icon, loading state, dark mode."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import viser
from viser import infra

LOADING = '<div id="root"><div class="lirs-loading" role="status">LIRS-WCT is loading ...</div></div>'


def asset(name: str) -> str:
    """Return the text of one of our files for browsers."""
    return (Path(__file__).parent / "assets" / name).read_text(encoding="utf-8")


def write_page(folder: Path) -> None:
    """Write viser's page with our head and our loading state."""
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
