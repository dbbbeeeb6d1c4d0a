"""How the tests handle a page."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any


def upload(page: Any, button: str, path: Path) -> None:
    """Choose a file at a button."""
    with page.expect_file_chooser() as chooser:
        page.get_by_role("button", name=button).click()
    chooser.value.set_files(path)


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
