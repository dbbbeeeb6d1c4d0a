"""The version stands in pyproject.toml; what repeats it agrees."""

import re
import tomllib
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
VERSION = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]


def test_the_citation_names_the_version() -> None:
    assert yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))["version"] == VERSION


def test_the_changelog_begins_with_the_version_and_its_date() -> None:
    headings = re.findall(r"^## (.*)$", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    released = headings[headings[0] == "Unreleased" :]
    assert re.fullmatch(rf"{re.escape(VERSION)} \(\d{{4}}-\d\d-\d\d\)", released[0])


@pytest.mark.parametrize("page", ["README.md", "docs/index.md", "docs/tutorial/first_verdict.md"])
def test_a_page_installs_the_wheel_of_the_version(page: str) -> None:
    wheels = re.findall(r"lirs_wct-(\S+)-py3", (ROOT / page).read_text(encoding="utf-8"))
    assert wheels == [VERSION]
