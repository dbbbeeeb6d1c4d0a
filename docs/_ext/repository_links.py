"""Links that are right in the repository are right on the site.

Pages link to each other and to files of the repository, as GitHub shows them. A file outside `docs/` is shown
at the repository's address where `pyproject.toml` names one (`[project.urls]`, `Repository`); without an
address the site carries a copy of the file. README and the other pages at the root stand on the site as well.
A link to what does not exist is a warning, and so is a link to a folder that the site cannot show.
"""

from __future__ import annotations

import os
import re
import tomllib
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx
from sphinx.util import logging

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = {f"{name}.md": f"project/{name.lower()}.md" for name in ("README", "CONTRIBUTING", "CHANGELOG")} | {
    "examples": "reference/examples.md",
    "examples/data": "reference/examples.md",
    "notebooks": "tutorial/notebooks.md",
}
"""What the site shows on a page of its own."""
FENCE = re.compile(r"^( *)(`{3,}|~{3,}).*?^\1\2 *$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"(?<=\]\()(?!\w+:|#)([^)#\s]+)(#[^)\s]*)?(?=\))")
log = logging.getLogger(__name__)


def setup(app: Sphinx) -> dict[str, Any]:
    """Register with Sphinx."""
    app.connect("source-read", _rewrite)
    app.connect("include-read", _rewrite_included)
    return {"parallel_read_safe": True, "env_version": 1}


def _rewrite(app: Sphinx, page: str, source: list[str]) -> None:
    path = Path(app.env.doc2path(page))
    source[0] = with_site_links(source[0], path, path.parent)


def _rewrite_included(app: Sphinx, path: Path, _: str, source: list[str]) -> None:
    # MyST gives the last part of the including page's name only.
    file, home = Path(os.path.normpath(app.srcdir / path)), Path(app.env.doc2path(app.env.docname)).parent
    source[0] = with_site_links(source[0], file, home)


def with_site_links(text: str, page: Path, home: Path) -> str:
    """Return a page's text with the links of the site; code keeps its brackets.

    Args:
        text: of the page.
        page: file that the text stands in.
        home: folder of the site's page that shows it.
    """
    address = repository()

    def linked(part: str) -> str:
        return LINK.sub(lambda found: site_link(found[1], page, home, address) + (found[2] or ""), part)

    at, parts = 0, []
    for fence in FENCE.finditer(text):
        parts += [linked(text[at : fence.start()]), fence.group()]
        at = fence.end()
    return "".join([*parts, linked(text[at:])])


def repository() -> str | None:
    """Return the repository's address by pyproject.toml, if it has one."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    address: str | None = project.get("urls", {}).get("Repository")
    return address


def site_link(target: str, page: Path, home: Path, address: str | None) -> str:
    """Return what a link is on the site.

    Args:
        target: path from the page's folder, as GitHub reads it.
        page: file that the link stands in.
        home: folder of the site's page that shows it.
        address: of the repository; None = it has none.
    """
    file = Path(os.path.normpath(page.parent / target))
    if not file.exists():
        log.warning("%s links to %s, which does not exist", page.name, target, type="myst", subtype="link")
        return target
    if not file.is_relative_to(ROOT):
        return target
    inside = file.relative_to(ROOT).as_posix()
    if inside in PAGES:
        return os.path.relpath(DOCS / PAGES[inside], home)
    if file.is_relative_to(DOCS) or (address is None and file.is_file()):
        return os.path.relpath(file, home)
    if address is not None:
        return f"{address}/{'tree' if file.is_dir() else 'blob'}/main/{inside}"
    log.warning("%s links to the folder %s, which the site does not show", page.name, target)
    return target
