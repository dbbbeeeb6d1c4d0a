"""The report in a browser: no table is cut, on a screen of 1300 pixels and on paper; images are loaded."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from lirs_validation.analysis.results import read_results
from lirs_validation.report.run_report import report_of, report_page
from tests.lirs_validation.records import saved

PAPER = 1047
"""Width of A4 on its side less margins of 10 mm, pixels."""


@pytest.fixture(scope="module")
def shown(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """The page of two mappers with three seeds each, all details open."""
    root: Path = tmp_path_factory.mktemp("report")
    for mapper in ("hector", "gmapping_original"):
        for seed in (1, 2, 3):
            saved(root, "advanced", seed, mapper=mapper, ate=0.0123 * seed, f1=0.9 + 0.02 * seed)
    file = root / "report.html"
    html = report_page(report_of(read_results(root)), "lirs-wct report out")
    file.write_text(html.replace("<details>", "<details open>"), encoding="utf-8")
    opened = browser.new_page(viewport={"width": 1300, "height": 900})
    opened.goto(file.as_uri())
    yield opened
    opened.close()


def cut(shown: Any) -> list[str]:
    """Tables that are wider than their place, and `page` if all of it is."""
    return list(
        shown.evaluate(
            """() => [...document.querySelectorAll(".scroll")]
                .filter(box => box.scrollWidth > box.clientWidth).map(box => box.querySelector("table").id)
                .concat(document.documentElement.scrollWidth > innerWidth ? ["page"] : [])"""
        )
    )


def test_no_table_is_cut_on_a_screen(shown: Any) -> None:
    shown.emulate_media(media="screen")
    shown.set_viewport_size({"width": 1300, "height": 900})
    assert shown.locator("table#map tbody tr").count() == 2
    assert cut(shown) == []


def test_no_table_is_cut_on_paper(shown: Any) -> None:
    shown.emulate_media(media="print")
    shown.set_viewport_size({"width": PAPER, "height": 720})
    assert cut(shown) == []
