"""The site builds without a warning, and holds what a reader looks up."""

import importlib
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from tests.command_line import COMMANDS

for library in ("sphinx", "myst_parser", "furo"):
    if find_spec(library) is None:
        pytest.skip(f"{library} is not installed (extra [docs])", allow_module_level=True)

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"


def build(pages: Path, site: Path) -> subprocess.CompletedProcess[str]:
    strictly = ("-b", "html", "-W", "--keep-going", "-q")
    command = [sys.executable, "-m", "sphinx", *strictly, "-c", DOCS, pages, site]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_the_site_builds_without_a_warning_and_holds_the_reference(tmp_path: Path) -> None:
    """One test, since workers of pytest-xdist would each build a site of their own."""
    built = build(DOCS, tmp_path)
    assert built.returncode == 0, built.stderr
    check_command_line(tmp_path)
    check_copies_of_files(tmp_path)


def check_command_line(site: Path) -> None:
    """Every command and option is in the reference."""
    page = re.sub(r"<[^>]+>", "", (site / "reference" / "command_line.html").read_text())
    for name, command in COMMANDS.items():
        assert f"lirs-wct {name}" in page
        assert all(option.positional or option.flag in page for option in command.own.values())
        assert all(option.replace("_", "-") in page for option in command.rare)


def check_copies_of_files(site: Path) -> None:
    """A file of the repository that a page links to is on the site."""
    page = (site / "howto" / "policy.html").read_text()
    if repository_links().repository() is None:
        (copy,) = re.findall(r'href="\.\./(_downloads/[^"]+train_pretrained\.py)"', page)
        assert (site / copy).read_bytes() == (ROOT / "examples" / "train_pretrained.py").read_bytes()
    else:
        assert "/examples/train_pretrained.py" in page


def repository_links() -> Any:
    """Return the extension, which no package holds."""
    sys.path.insert(0, str(DOCS / "_ext"))
    try:
        return importlib.import_module("repository_links")
    finally:
        sys.path.pop(0)


@pytest.mark.parametrize(
    ("target", "page", "home", "link"),
    [
        ("sweeps.md", "docs/benchmark.md", "docs", "sweeps.md"),
        ("../README.md", "docs/results.md", "docs", "project/readme.md"),
        ("docs/sweeps.md", "README.md", "docs/project", "../sweeps.md"),
        ("examples", "README.md", "docs/project", "../reference/examples.md"),
        ("../examples/data/office.yaml", "docs/results.md", "docs", "../examples/data/office.yaml"),
    ],
)
def test_links(target: str, page: str, home: str, link: str) -> None:
    assert repository_links().site_link(target, ROOT / page, ROOT / home, None) == link


def test_files_are_shown_at_the_repository_where_it_has_an_address() -> None:
    page = DOCS / "results.md"
    for target, kind in (("../Makefile", "blob"), ("../benchmarks", "tree")):
        shown = repository_links().site_link(target, page, DOCS, "https://host/lirs/wct")
        assert shown == f"https://host/lirs/wct/{kind}/main/{target[3:]}"


@pytest.mark.slow
@pytest.mark.parametrize("broken", ["[a page](missing.md)", "[a heading](index.md#missing)"])
def test_a_broken_link_fails_the_build(tmp_path: Path, broken: str) -> None:
    pages = tmp_path / "pages"
    pages.mkdir()
    index = pages / "index.md"
    index.write_text("# Title\n\n[a page](index.md)\n")
    assert build(pages, tmp_path / "site").returncode == 0
    index.write_text(f"# Title\n\n{broken}\n")
    built = build(pages, tmp_path / "site")
    assert built.returncode != 0
    assert re.search(r"WARNING: .*missing", built.stderr)
