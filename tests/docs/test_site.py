"""The site builds without a warning, and holds what a reader looks up."""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path

import pytest

for library in ("sphinx", "myst_parser", "furo"):
    pytest.importorskip(library, reason=f"{library} is not installed (extra [docs])")

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"


def build(pages: Path, site: Path) -> subprocess.CompletedProcess[str]:
    strictly = ("-b", "html", "-W", "--keep-going", "-q")
    command = [sys.executable, "-m", "sphinx", *strictly, "-c", DOCS, pages, site]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    built = build(DOCS, folder)
    assert built.returncode == 0, built.stderr
    return folder


def documented(site: Path) -> set[str]:
    """Return the names of Sphinx's inventory."""
    data = (site / "objects.inv").read_bytes()
    start = data.index(b"zlib.\n") + len(b"zlib.\n")
    return {line.split(" ")[0] for line in zlib.decompress(data[start:]).decode().splitlines()}


@pytest.mark.slow
@pytest.mark.parametrize("package", ["lirs_wct", "lirs_validation"])
def test_every_public_name_is_in_the_reference(site: Path, package: str) -> None:
    names = importlib.import_module(package).__all__
    missing = {f"{package}.{name}" for name in names} - documented(site)
    assert not missing - {"lirs_wct.WctError"}
    assert "lirs_wct.errors.WctError" in documented(site)


@pytest.mark.slow
def test_every_command_and_option_is_in_the_reference(site: Path) -> None:
    import typer

    from lirs_validation.cli.app import app

    page = re.sub(r"<[^>]+>", "", (site / "reference" / "command_line.html").read_text())
    commands = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    for name, command in commands.items():
        assert f"lirs-wct {name}" in page
        for parameter in command.params:
            assert parameter.param_type_name == "argument" or parameter.opts[0] in page


@pytest.mark.slow
def test_files_of_the_repository_that_pages_link_to_are_on_the_site(site: Path) -> None:
    page = (site / "howto" / "policy.html").read_text()
    (copy,) = re.findall(r'href="\.\./(_downloads/[^"]+train_navigation\.py)"', page)
    assert (site / copy).read_bytes() == (ROOT / "examples" / "train_navigation.py").read_bytes()


@pytest.fixture
def site_link(monkeypatch: pytest.MonkeyPatch) -> Callable[..., str]:
    monkeypatch.syspath_prepend(str(DOCS / "_ext"))
    link: Callable[..., str] = importlib.import_module("repository_links").site_link
    return link


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
def test_links(site_link: Callable[..., str], target: str, page: str, home: str, link: str) -> None:
    assert site_link(target, ROOT / page, ROOT / home, None) == link


def test_files_are_shown_at_the_repository_where_it_has_an_address(site_link: Callable[..., str]) -> None:
    page = DOCS / "results.md"
    for target, kind in (("../Makefile", "blob"), ("../benchmarks", "tree")):
        shown = site_link(target, page, DOCS, "https://host/lirs/wct")
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
