"""Pieces of HTML with a script: viser shows HTML, and runs only what stands in an attribute."""

from __future__ import annotations


def with_script(html: str, script: str) -> str:
    """Return HTML whose script, a function, is called with the element around the mark `SCRIPT`."""
    quoted = script.replace('"', "&quot;").replace("\n", " ")
    mark = f'<img src="data:," style="display:none" onerror="({quoted})(this.parentElement)">'
    return html.replace("SCRIPT", mark)
