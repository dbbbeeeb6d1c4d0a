"""Help of commands: panels of options, at first the common ones."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import MISSING
from io import StringIO
from typing import Any, Protocol

import click
from rich.console import Console, RenderableType
from rich.panel import Panel
from rich.table import Table

from lirs_validation.cli.progress import out
from lirs_wct.option import Option

Row = tuple[str, str, str]
"""Flags, placeholder of the value, and description."""


class Described(Protocol):
    """Command whose help is written; see `Command`."""

    help: str | None
    epilog: str | None
    params: list[click.Parameter]
    own: Mapping[str, Option]
    rare: Mapping[str, Option]
    common: Sequence[str]

    def collect_usage_pieces(self, ctx: click.Context) -> list[str]:
        """Return the words of the usage line."""
        ...


ARGUMENTS, OPTIONS, RARE = "Arguments", "Options", "Rare options: --option NAME=VALUE"


def help_text(command: Described, ctx: click.Context, *, everything: bool) -> str:
    """Return the help of a command as the terminal shows it."""
    usage = f"\n Usage: {ctx.command_path} {' '.join(command.collect_usage_pieces(ctx))}\n"
    examples = f"Examples:\n\n{command.epilog}\n" if command.epilog else ""
    return render([usage, *paragraphs(command.help), *panels(command, everything=everything), examples])


def panels(command: Described, *, everything: bool) -> list[tuple[str, list[Row]]]:
    """Return headings and rows of a command's arguments and options."""
    found: dict[str, list[Row]] = {}
    own = {name: _row(option) for name, option in command.own.items()}
    for name, option in command.own.items():
        if option.positional:
            found.setdefault(ARGUMENTS, []).append(own[name])
        elif everything:
            found.setdefault(option.panel or OPTIONS, []).append(own[name])
    usual = found.setdefault(OPTIONS, [])
    if not everything:
        usual += [own[name] for name in command.common]
    usual += [_flag_row(param) for param in command.params if param.name in ("option", "help_all")]
    usual.append(("--help", "", "Show this message and exit."))
    if everything and command.rare:
        rare = command.rare.values()
        found[RARE] = [(option.name.replace("_", "-"), option.form, _row(option)[2]) for option in rare]
    return [(title, rows) for title, rows in found.items() if rows]


def _row(option: Option) -> Row:
    """Return flags, placeholder and description of an option."""
    flags = option.form if option.positional else option.flag
    if option.name == "output":
        flags = f"{flags}, -o"
    form = "" if option.positional or option.type is bool else option.form
    usual = "" if option.default in (None, False, (), "", MISSING) else _text(option.default)
    return flags, form, f"{option.help} [default: {usual}]" if usual else option.help


def _flag_row(param: Any) -> Row:
    return param.opts[0], "" if param.is_flag else param.metavar, param.help


def _text(default: Any) -> str:
    if isinstance(default, tuple):
        return ",".join(map(_text, default))
    return f"{default:g}" if isinstance(default, float) else str(default)


def paragraphs(text: str | None) -> list[str]:
    """Return the paragraphs of a docstring, each in one line."""
    return [" " + " ".join(part.split()) + "\n" for part in (text or "").split("\n\n")]


def render(parts: Iterable[str | tuple[str, list[Row]]]) -> str:
    """Return texts and panels of rows as the terminal shows them."""
    page = StringIO()
    terminal = {"force_terminal": True} if out.is_terminal else {"no_color": True}
    console = Console(file=page, width=out.width, highlight=False, **terminal)  # type: ignore[arg-type]
    for part in parts:
        content: RenderableType = part if isinstance(part, str) else _panel(*part)
        if content:
            console.print(content, markup=False, soft_wrap=isinstance(part, str) and "lirs-wct" in part)
    return page.getvalue()


def _panel(title: str, rows: list[Row]) -> Panel:
    table = Table.grid(padding=(0, 2))
    table.add_column(style="bold cyan", no_wrap=True)
    table.add_column(style="yellow", max_width=24)
    table.add_column()
    for row in rows:
        table.add_row(*row)
    return Panel(table, title=title, title_align="left", border_style="dim", expand=True)
