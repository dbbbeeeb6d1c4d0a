"""A live server, and pages of a real headless Chromium in front of it."""

import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

PATIENCE = 90_000
"""Milliseconds that a page may take for anything: kernels are compiled meanwhile."""


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    pytest.importorskip("viser", reason="viser is not installed (extra [gui])")
    from lirs_validation.gui.server import Server

    monkeypatch.setattr("lirs_validation.gui.scene.PREVIEW_TRIANGLES", 6_000)
    monkeypatch.setattr("lirs_validation.gui.scene.BUILT_TRIANGLES", 8_000)
    server = Server(port=0)
    yield server
    server.stop()
    working = [thread for thread in threading.enumerate() if thread.name.startswith("page ")]
    for thread in working:
        thread.join(20)
        assert not thread.is_alive()


@pytest.fixture
def open_page(browser: Any, server: Any) -> Iterator[Callable[..., Any]]:
    pages = []

    def opened(width: int = 1000, height: int = 900, touch: bool = False) -> Any:
        page = browser.new_page(viewport={"width": width, "height": height}, has_touch=touch, is_mobile=touch)
        pages.append(page)
        page.set_default_timeout(PATIENCE)
        page.goto(server.address)
        page.get_by_text("50 x 50 m").first.wait_for()
        return page

    yield opened
    for page in pages:
        page.close()


@pytest.fixture
def picture(tmp_path: Path) -> Path:
    """A gray hill of 65 x 65 pixels."""
    y, x = np.mgrid[-1:1:65j, -1:1:65j]
    path = tmp_path / "hill.png"
    cv2.imwrite(str(path), (255 * np.exp(-3 * (x**2 + y**2))).astype(np.uint8))
    return path
