"""Write the reference of the command line from the program itself, when the site is built.

A page asks for it by the line `% COMMAND LINE`, in whose place the commands stand then.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import click
from sphinx.application import Sphinx

PLACE = "% COMMAND LINE"


def setup(app: Sphinx) -> dict[str, Any]:
    """Register with Sphinx."""
    app.connect("source-read", _fill)
    return {"parallel_read_safe": True, "env_version": 1}


def _fill(_: Sphinx, __: str, source: list[str]) -> None:
    if PLACE in source[0]:
        source[0] = source[0].replace(PLACE, command_line_reference())


def command_line_reference() -> str:
    """Return all commands of `lirs-wct` as Markdown, in the order of its help."""
    from lirs_validation.cli.command import COMMANDS, PROGRAM

    context = click.Context(PROGRAM, info_name="lirs-wct")
    return "\n".join(line for name in COMMANDS for line in _command(PROGRAM.get_command(context, name)))


def _command(command: Any) -> Iterator[str]:
    from lirs_validation.cli.command import panels

    usage = " ".join(command.collect_usage_pieces(click.Context(command)))
    examples = "\n".join(f"$ {line}" for line in command.epilog.splitlines())
    yield f"## lirs-wct {command.name}\n\n{command.help}\n"
    yield f"```console\n$ lirs-wct {command.name} {usage}\n```\n"
    yield f"Examples:\n\n```console\n{examples}\n```\n"
    for title, rows in panels(command, everything=True):
        cells = (f"| {_cell(f'{flags} {form}', code=True)} | {_cell(text)} |" for flags, form, text in rows)
        yield f"**{title}**\n\n| | |\n|---|---|\n" + "\n".join(cells) + "\n"


def _cell(text: str, *, code: bool = False) -> str:
    """Return a text as it may stand in a cell of a table."""
    text = " ".join(text.split()).replace("|", "\\|")
    return f"`{text}`" if code else text.replace("*", "\\*").replace("<", "&lt;").replace("[", "\\[")
