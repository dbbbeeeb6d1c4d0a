"""The live page inside a notebook."""

import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from urllib.error import URLError
from urllib.request import urlopen

import numpy as np
import pytest

from lirs_validation import show
from lirs_wct import HeightField, World
from lirs_wct.errors import ConfigError, WctError
from lirs_wct.ground import Terrain

SLOPE = HeightField.centered(np.linspace(0, 1, 33 * 33, dtype=np.float32).reshape(33, 33), (0.5, 0.5))


def test_a_world_shows_in_a_frame(browser: Any) -> None:
    page = show(World("my slope", Terrain(SLOPE)))
    try:
        tab = browser.new_page()
        tab.set_content(page._repr_html_())
        frame = tab.frame_locator("iframe")
        frame.locator("canvas").first.wait_for(timeout=90_000)
        frame.get_by_text("my slope").first.wait_for(timeout=90_000, state="attached")
        assert len(repr(page)) < 300
        tab.close()
    finally:
        page.close()
    with pytest.raises(URLError):
        urlopen(page.address, timeout=2)


@pytest.mark.skipif(find_spec("viser") is None, reason="viser is not installed (extra [gui])")
def test_what_is_no_source(tmp_path: Path) -> None:
    with pytest.raises(WctError, match=r"missing\.png"):
        show(tmp_path / "missing.png")


def test_without_viser(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    monkeypatch.setattr("lirs_validation.gui.find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r"pip install 'lirs-wct\[gui\]'"):
        show("simple")
