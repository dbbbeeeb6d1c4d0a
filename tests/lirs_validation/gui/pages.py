"""How the tests handle a page."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any


def upload(page: Any, button: str, *paths: Path) -> None:
    """Choose files at a button."""
    with page.expect_file_chooser() as chooser:
        page.get_by_role("button", name=button).click()
    chooser.value.set_files(paths)


def drop(page: Any, *paths: Path) -> None:
    """Drop files onto the page."""
    files = [{"name": path.name, "bytes": list(path.read_bytes())} for path in paths]
    page.evaluate(
        """files => {
          const dropped = new DataTransfer();
          files.forEach(f => dropped.items.add(new File([new Uint8Array(f.bytes)], f.name)));
          const target = document.querySelector('canvas');
          ['dragover', 'drop'].forEach(kind => target.dispatchEvent(
            new DragEvent(kind, {dataTransfer: dropped, bubbles: true, cancelable: true})));
        }""",
        files,
    )


def field(page: Any, label: str) -> Any:
    """Return the field beside a label: viser puts them into one row."""
    row = page.locator("label", has_text=label).locator(
        "xpath=ancestor::div[contains(@class,'Flex-root')][1]"
    )
    return row.locator("input").last


def figure(page: Any, name: str) -> str:
    """Return what a table of figures says of a name."""
    row = page.locator("tr", has=page.locator("td", has_text=name)).locator("visible=true").first
    return str(row.locator("td").nth(1).inner_text())


def wait_for(condition: Callable[[], bool], seconds: float = 90.0) -> None:
    """Wait until something holds."""
    until = time.monotonic() + seconds
    while not condition() and time.monotonic() < until:
        time.sleep(0.1)
    assert condition()
