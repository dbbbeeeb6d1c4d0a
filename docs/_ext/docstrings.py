"""Docstrings and signatures as they are meant."""

from __future__ import annotations

from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.domains.python import PyObject
from sphinx.util.inspect import TypeAliasForwardRef

AFTER_NAPOLEON = 600
TYPE = ":type: "


def setup(app: Sphinx) -> dict[str, Any]:
    """Register with Sphinx."""
    app.connect("autodoc-process-docstring", _keep_first_sentence, priority=AFTER_NAPOLEON)
    app.connect("autodoc-process-signature", _show_factories)
    app.connect("doctree-read", _write_dashes)
    for field in PyObject.doc_field_types:
        if field.name == "variable":
            field.label = "Attributes"
    # In a union an alias shows its repr.
    TypeAliasForwardRef.__repr__ = lambda self: self.name
    return {"parallel_read_safe": True, "env_version": 1}


def _keep_first_sentence(_: Sphinx, what: str, __: str, ___: Any, ____: Any, lines: list[str]) -> None:
    """Join what Napoleon split at a colon: it takes the words before for a type, as in `int: how many`.

    Types stand in the signatures here; such a colon belongs to the sentence.
    """
    if what in ("property", "attribute", "data") and lines:
        found = next((line for line in lines if line.startswith(TYPE)), None)
        if found is not None:
            lines.remove(found)
            lines[0] = f"{found.removeprefix(TYPE)}: {lines[0]}"


def _show_factories(
    _: Sphinx, __: str, ___: str, ____: Any, _____: Any, signature: str | None, returned: str | None
) -> tuple[str | None, str | None]:
    """Write `...` for a default that a factory makes: its repr is no Python, which Sphinx would not parse."""
    return signature and signature.replace("<factory>", "..."), returned


def _write_dashes(_: Sphinx, page: nodes.document) -> None:
    """Write a dash between a name and what it means; smart quotes, which would, spoil `--option`."""
    for text in list(page.findall(nodes.Text)):
        if text == " -- ":
            text.parent.replace(text, nodes.Text(" – "))
