"""A live server, and pages of a real headless Chromium in front of it."""

import shutil
import threading
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

FLAGS = [
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
]
PATIENCE = 90_000
"""Milliseconds that a page may take for anything: kernels are compiled meanwhile."""


def _chromium() -> str:
    if find_spec("viser") is None or find_spec("playwright") is None:
        pytest.skip("viser or playwright is not installed")
    path = shutil.which("chromium") or shutil.which("chromium-browser")
    if path is None:
        pytest.skip("chromium is not installed (apt-get install chromium)")
    return path


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    chromium = _chromium()
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=FLAGS)
        yield browser
        browser.close()


@pytest.fixture
def server() -> Iterator[Any]:
    _chromium()
    from lirs_validation.gui.server import Server
    from lirs_validation.gui.session.uploads import PageLimits
    from lirs_validation.gui.view.scene import Detail

    server = Server(port=0, limits=PageLimits(upload=2 * 2**20), detail=Detail(preview=6_000, built=8_000))
    yield server
    server.stop()
    working = [thread for thread in threading.enumerate() if thread.name.startswith("page ")]
    for thread in working:
        thread.join(20)
        assert not thread.is_alive()


@pytest.fixture
def open_page(browser: Any, server: Any) -> Iterator[Callable[[], Any]]:
    pages = []

    def opened() -> Any:
        page = browser.new_page(viewport={"width": 1000, "height": 900})
        page.set_default_timeout(PATIENCE)
        page.goto(server.address)
        page.get_by_text("50 x 50 m").first.wait_for()
        pages.append(page)
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


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark every test of a page in a browser as slow."""
    for item in items:
        if "browser" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.slow)
