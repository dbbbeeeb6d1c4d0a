"""What the pages name exists: files, commands, options of environments."""

import importlib
import inspect
import re
from collections.abc import Iterator
from dataclasses import fields
from fnmatch import fnmatch
from pathlib import Path
from pkgutil import resolve_name

import pytest

from lirs_envs.episodes.config import RANDOMIZED, EnvConfig
from lirs_envs.episodes.observations import GROUPS
from lirs_wct.geometry import LaserScan, OccupancyGrid
from tests.command_line import check_command

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
COMMAND = re.compile(r"^ *(?:\$ )?(lirs-wct [a-z].*)$|`(lirs-wct [a-z][^`]* [^`]*)`", re.MULTILINE)
PACKAGES = "lirs_wct|lirs_envs|slam_baselines|lirs_validation|lirs_extensions"
FOLDERS = f"{PACKAGES}|envs|benchmarks|tests|examples|docs/pictures"
ENVIRONMENTS = (DOCS / "reference" / "environments.md").read_text()


def commands() -> Iterator[tuple[str, str]]:
    """Yield page and command of each line that shows one; `\\` at the end goes on in the next."""
    for page in PAGES:
        for in_block, in_text in COMMAND.findall(page.read_text().replace("\\\n", " ")):
            if "--help" not in in_text:
                yield page.name, in_block or in_text


def test_links_lead_to_files_as_github_reads_them() -> None:
    for page in (*PAGES, ROOT / "CONTRIBUTING.md"):
        for target in re.findall(r"\]\((?!\w+:|#)([^)#\s]+)", page.read_text()):
            assert (page.parent / target).exists(), (page, target)


def test_modules_and_files_that_the_pages_name_exist() -> None:
    for page in (*PAGES, ROOT / "README.md", ROOT / "CONTRIBUTING.md"):
        text = page.read_text()
        for name in re.findall(rf"`((?:{PACKAGES})(?:\.\w+)+)`", text):
            assert resolve_name(name) is not None, page
        for path in re.findall(rf"(?:`|python )((?:{FOLDERS})/[\w./]+)", text):
            assert "NAME" in path or (ROOT / path).exists(), (page, path)


def test_the_rows_of_a_table_have_the_cells_of_its_head() -> None:
    for page in (*PAGES, ROOT / "README.md"):
        text = re.sub(r"^```.*?^```|`[^`\n]*`|\\\|", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
        for table in re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE):
            rows = table.splitlines()
            assert [row for row in rows if row.count("|") != rows[0].count("|")] == [], page


def test_every_page_is_in_the_index() -> None:
    toctrees = re.findall(
        r"^```{toctree}\n(.*?)^```", (DOCS / "index.md").read_text(), re.MULTILINE | re.DOTALL
    )
    listed = re.findall(r"^(?:.*<)?([a-z_/]+\*?)>?$", "".join(toctrees), re.MULTILINE)
    pages = {page.relative_to(DOCS).with_suffix("").as_posix() for page in PAGES} - {"index"}
    assert {page for page in pages if not any(fnmatch(page, name) for name in listed)} == set()


@pytest.mark.parametrize("package", ["lirs_wct", "lirs_validation"])
def test_every_public_name_is_in_the_reference(package: str) -> None:
    page = (DOCS / "reference" / f"{package}.md").read_text()
    module = importlib.import_module(package)
    known = ("lirs_wct.errors", "numpy")  # errors have a page of their own; array types need none
    names = {name for name in module.__all__ if getattr(module, name).__module__ not in known}
    assert names - set(re.findall(r"^\.\. auto\w+:: (\w+)$", page, re.MULTILINE)) == set()


def test_the_parser_takes_the_commands() -> None:
    found = list(commands())
    assert len(found) > 50
    for page, line in found:
        try:
            check_command(line.replace("...", "X"))
        except Exception as error:
            raise AssertionError(f"{page}: {line}") from error


def test_every_option_and_group_of_the_environments_is_explained() -> None:
    explained = re.findall(r"^    (\w+): ", inspect.getdoc(EnvConfig) or "", re.MULTILINE)
    assert {field.name for field in fields(EnvConfig) if field.init} <= set(explained)
    assert [name for name in (*GROUPS, *RANDOMIZED) if f"`{name}`" not in ENVIRONMENTS] == []


@pytest.mark.parametrize("kind", [LaserScan, OccupancyGrid])
def test_the_guide_for_mappers_lists_the_fields_of_their_values(kind: type) -> None:
    section = (DOCS / "bring_your_own_mapper.md").read_text().split(f"\n## {kind.__name__}\n")[1]
    rows = re.findall(r"^\| (`[^|]*) \| ([^|]*) \|", section.partition("\n#")[0], re.MULTILINE)
    listed = {name: form for names, form in rows for name in re.findall(r"`(\w+)`", names)}
    assert list(listed) == [field.name for field in fields(kind)]
    types = {"Float32Array": "float32", "float": r"^(m|rad|s)$", "Pose2": "`Pose2`", "Pose3": "`Pose3`"}
    for field in fields(kind):
        assert re.search(types[str(field.type)], listed[field.name]), field.name


def test_pictures_of_the_gallery_are_small() -> None:
    for picture in ("worlds.png", "robots.png", "run.jpg"):
        assert (DOCS / "pictures" / picture).stat().st_size <= 150_000, picture


def test_pictures_of_the_first_page_are_small() -> None:
    sizes = [picture.stat().st_size for picture in (DOCS / "pictures" / "verdicts").iterdir()]
    assert len(sizes) == 21
    assert sum(sizes) <= 400_000
