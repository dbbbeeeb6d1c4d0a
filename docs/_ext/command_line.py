"""Write the reference of the command line from the program itself, when the site is built.

A page asks for it by the line `% COMMAND LINE`, in whose place the commands stand then.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import typer
from sphinx.application import Sphinx

PLACE = "% COMMAND LINE"
HIDDEN = "Rarely used, not in --help"
PANEL = "Options"
"""Heading of options without a panel of their own, as Typer has it."""


def setup(app: Sphinx) -> dict[str, Any]:
    """Register with Sphinx."""
    app.connect("source-read", _fill)
    return {"parallel_read_safe": True, "env_version": 1}


def _fill(_: Sphinx, __: str, source: list[str]) -> None:
    if PLACE in source[0]:
        source[0] = source[0].replace(PLACE, command_line_reference())


def command_line_reference() -> str:
    """Return all commands of `lirs-wct` as Markdown, in the order of its help."""
    from lirs_validation.cli.app import make_app

    program: Any = typer.main.get_command(make_app())
    with program.make_context("lirs-wct", [], resilient_parsing=True) as context:
        names = program.list_commands(context)
        return "\n".join(line for name in names for line in _command(program, context, name))


def _command(program: Any, parent: Any, name: str) -> Iterator[str]:
    command = program.get_command(parent, name)
    with command.make_context(name, [], parent=parent, resilient_parsing=True) as context:
        yield f"## lirs-wct {name}\n\n{command.help}\n"
        usage = " ".join(command.collect_usage_pieces(context))
        yield f"```console\n$ lirs-wct {name} {usage}\n```\n"
        yield from _examples(command.epilog)
        yield from _panels(command, context)


def _examples(epilog: str | None) -> Iterator[str]:
    """Yield the examples of a command's help, one a line below the word `Examples:`."""
    if epilog:
        _, *lines = epilog.split("\n\n")
        prompt = "\n".join(f"$ {line}" for line in lines)
        yield f"Examples:\n\n```console\n{prompt}\n```\n"


def _panels(command: Any, context: Any) -> Iterator[str]:
    """Yield a table of the arguments, and one of each panel of options."""
    panels: dict[str, list[str]] = {}
    for parameter in command.get_params(context):
        hidden = getattr(parameter, "hidden", False)
        parameter.hidden = False  # else it has no record
        record = parameter.get_help_record(context)
        parameter.hidden = hidden
        if record is None or "--help" in parameter.opts:
            continue
        kind = "Arguments" if parameter.param_type_name == "argument" else PANEL
        title = HIDDEN if hidden else getattr(parameter, "rich_help_panel", None) or kind
        panels.setdefault(title, []).append(f"| {_cell(record[0], code=True)} | {_cell(record[1])} |")
    for title, rows in panels.items():
        yield f"**{title}**\n\n| | |\n|---|---|\n" + "\n".join(rows) + "\n"


def _cell(text: str, *, code: bool = False) -> str:
    """Return a text as it may stand in a cell of a table."""
    text = " ".join(text.split()).replace("|", "\\|")
    return f"`{text}`" if code else text.replace("*", "\\*").replace("<", "&lt;").replace("[", "\\[")
