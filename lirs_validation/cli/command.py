"""Click commands of functions whose parameters are classes of options, and their help."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass
from io import StringIO
from typing import Any

import click
from rich.console import Console, RenderableType
from rich.panel import Panel
from rich.table import Table

from lirs_validation.cli.progress import out
from lirs_wct.errors import ConfigError, did_you_mean, unknown_name
from lirs_wct.option import Option, Options, declared

Row = tuple[str, str, str]
"""Flags, placeholder of the value, and description."""
ARGUMENTS, OPTIONS, RARE = "Arguments", "Options", "Rare options: --option NAME=VALUE"
SHORT = {"output": "-o"}
"""Short flags, by name of the option."""
OLD: Mapping[str, str] = {
    "--against": "differences are from the first policy that the command names",
    "--as": "is now --kind picture|map",
    "--bag": "is now lirs-wct record",
    "--cell-memory": "is gone: the limits of your system, such as `ulimit -v`, do it",
    "--csv": "is now --tables FOLDER for `report`, -o FILE.csv for `compare`",
    "--denoise-method": "is now --option denoise=median|bilateral",
    "--engine": "is now --jobs N, or --address of a Ray cluster",
    "--factor": "is gone: it is always 3",
    "--help-all": "is gone here: --help shows all options of this command",
    "--json": "is now -o FILE.json",
    "--log-mapper": "is now lirs-wct map LOG --mapper NAME; the map's YAML is a source",
    "--mapper": "is gone here: lirs-wct map LOG --mapper NAME maps a log; the map's YAML is a source",
    "--map-height": "is gone: the map's height is that of the robots' lidars, 0.3 m",
    "--markdown": "is now --tables FILE.md",
    "--only-a": "is now A:FIELD=VALUE,... in place of the folder A",
    "--only-b": "is now B:FIELD=VALUE,... in place of the folder B",
    "--origin": "is gone: a map YAML beside the picture holds it",
    "--particles": "is now --parameters particles=N",
    "--pixel-size": "is now --resolution METERS",
    "--policy-arg": "is now --parameters NAME=VALUE,...",
    "--reference-topic": "is now --reference BAG:/TOPIC",
    "--search": "is gone: CMA-ES searches (pip install '.[search]')",
    "--seeds": "is now --seed N-M",
    "--sensors-only": "is gone here: `record` and `export` have it",
    "--storage": "is gone here: `record` and `export` have it",
    "--task": "is gone here: policies are searched on navigation",
    "--topic": "is now --trajectory BAG:/TOPIC",
    "--within": "is now --limits FILE.yaml",
}
"""Messages about options of version 1.0.0 that a command has no longer."""


@dataclass(frozen=True)
class Few:
    """Mark of a class of options of which only some have flags of their own.

    Attributes:
        names: Options with a flag; `--option` takes the others.
    """

    names: tuple[str, ...]


def common(*names: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Name the options that the help of a command shows, in order of use."""

    def mark(function: Callable[..., None]) -> Callable[..., None]:
        function.__dict__["common"] = names
        return function

    return mark


@dataclass(frozen=True)
class OptionGroup:
    """Class of options as a parameter of a command's function.

    Attributes:
        parameter: Name of the parameter.
        kind: Class of options.
        as_dict: Whether the function takes the given values as a dict, without an instance.
        flags: Options with a flag; None = all that are not rare.
    """

    parameter: str
    kind: type[Options]
    as_dict: bool
    flags: tuple[str, ...] | None

    def has_flag(self, option: Option) -> bool:
        """Whether an option has a flag of its own."""
        return not option.rare if self.flags is None else option.name in self.flags

    def value(self, given: Mapping[str, Any]) -> Any:
        """Return the options, or the given ones of them as a dict.

        Raises:
            ConfigError: a value is not legal, or two options contradict.
        """
        values = {name: given[name] for name in declared(self.kind) if name in given}
        return values if self.as_dict else self.kind(**values)


def groups_of(function: Callable[..., Any]) -> Iterator[OptionGroup]:
    """Yield the classes of options that a function takes.

    `C` stands for an instance, `Annotated[C, Few(...)]` for one with few flags, and `Annotated[dict, C]` for
    the given values.
    """
    for name, parameter in inspect.signature(function, eval_str=True).parameters.items():
        kind = getattr(parameter.annotation, "__origin__", parameter.annotation)
        (mark,) = getattr(parameter.annotation, "__metadata__", (None,))
        as_dict = not issubclass(kind, Options)
        options: Any = mark if as_dict else kind
        yield OptionGroup(name, options, as_dict, mark.names if isinstance(mark, Few) else None)


class Command(click.Command):
    """Command of a function; its docstring is the help, with examples at the end.

    Attributes:
        groups: Classes of options that the function takes.
        own: Options with a flag, and arguments, by name.
        rare: Options that `--option NAME=VALUE` takes, by name.
        common: Names of the options in the help; empty = all.
    """

    def __init__(self, name: str, function: Callable[..., None]) -> None:
        text, _, examples = inspect.cleandoc(function.__doc__ or "").partition("\n\nExamples:\n")
        self.groups, self._function = tuple(groups_of(function)), function
        own: dict[str, Option] = {}
        rare: dict[str, Option] = {}
        for group in self.groups:
            for option in declared(group.kind).values():
                (own if group.has_flag(option) else rare)[option.name] = option
        self.own: Mapping[str, Option] = own
        self.rare: Mapping[str, Option] = rare
        self.common: Sequence[str] = getattr(function, "common", ())
        parameters = [_parameter(option) for option in self.own.values()]
        if self.rare:
            parameters.append(_rare_option(self.rare))
        if self.common:
            parameters.append(_help_all())
        super().__init__(
            name, params=parameters, callback=self._call, help=text, epilog=inspect.cleandoc(examples)
        )

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the arguments of a command line.

        Raises:
            ConfigError: the command has no such option; the message says what replaced it.
        """
        try:
            return super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            raise ConfigError(self.unknown(error.option_name)) from error

    def format_help(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the help: common options, or all of them after `--help-all`."""
        formatter.write(help_text(self, ctx, everything=not self.common or "--help-all" in ctx.meta))

    def unknown(self, flag: str) -> str:
        """Return the message about a flag that the command does not have."""
        name = flag.removeprefix("--").replace("-", "_")
        if name in self.rare:
            return f"{flag}: is now --option {flag[2:]}={self.rare[name].form}"
        if flag in OLD:
            return f"{flag}: {OLD[flag]}"
        flags = [row.flag for row in (*self.own.values(), *self.rare.values()) if not row.positional]
        return f"{self.name} has no option {flag}{did_you_mean(flag, flags)}"

    def arguments(self, option: tuple[str, ...] = (), **given: Any) -> dict[str, Any]:
        """Return the arguments of the function for the texts of a command line.

        Raises:
            ConfigError: a value is not legal, or two options contradict.
        """
        values = {
            name: self.own[name].read(value, self.own[name].flag) if isinstance(value, str) else value
            for name, value in given.items()
            if value not in (None, False, ())
        }
        values |= dict(self._pair(text) for text in option)
        return {group.parameter: group.value(values) for group in self.groups}

    def _call(self, **given: Any) -> None:
        self._function(**self.arguments(**given))

    def _pair(self, text: str) -> tuple[str, Any]:
        """Return name and value of `--option NAME=VALUE`."""
        name, equals, value = text.partition("=")
        name = name.strip().replace("-", "_")
        if not equals:
            raise ConfigError(f"--option must be NAME=VALUE, got {text!r}")
        options = {**self.rare, **self.own}
        if name not in options:
            raise unknown_name("--option", name, options)
        return name, options[name].read(value, f"--option {name}")


def _parameter(option: Option) -> click.Parameter:
    """Return a declared option as a parameter of click, which hands over its text."""
    if option.positional:
        return click.Argument(
            [option.name],
            metavar=option.form,
            nargs=-1 if option.is_list else 1,
            required=option.default is MISSING,
            shell_complete=_completer(option),
        )
    flags = [option.name, option.flag, *([SHORT[option.name]] if option.name in SHORT else [])]
    return click.Option(
        flags,
        is_flag=option.type is bool,
        default=None,
        metavar=option.form,
        help=option.help,
        shell_complete=_completer(option),
    )


def _rare_option(rare: Mapping[str, Option]) -> click.Option:
    def complete(_: Any, __: Any, incomplete: str) -> list[str]:
        return [f"{name}=" for name in rare if name.startswith(incomplete)]

    text = "Set a rare option, which `--help-all` describes; repeatable."
    return click.Option(["--option"], multiple=True, metavar="NAME=VALUE", help=text, shell_complete=complete)


def _help_all() -> click.Option:
    """Return the option that shows the help of all options."""

    def show(ctx: click.Context, _: Any, asked: bool) -> None:
        if asked and not ctx.resilient_parsing:
            ctx.meta["--help-all"] = True
            click.echo(ctx.get_help(), color=ctx.color)
            ctx.exit()

    text = "Show all options and exit."
    return click.Option(
        ["--help-all"], is_flag=True, is_eager=True, expose_value=False, callback=show, help=text
    )


def _completer(option: Option) -> Callable[[Any, Any, str], list[str]]:
    """Return the shell's completion of an option's values, also in a list."""

    def complete(_: Any, __: Any, incomplete: str) -> list[str]:
        if option.complete is not None:
            return list(option.complete(incomplete))
        names = option.choices or [word for word in option.metavar.split("|") if word.islower()]
        before, comma, last = incomplete.rpartition(",")
        return [f"{before}{comma}{name}" for name in names if str(name).startswith(last)]

    return complete


def help_text(command: Command, ctx: click.Context, *, everything: bool) -> str:
    """Return the help of a command as the terminal shows it."""
    usage = f"\n Usage: {ctx.command_path} {' '.join(command.collect_usage_pieces(ctx))}\n"
    examples = f"Examples:\n\n{command.epilog}\n" if command.epilog else ""
    return render([usage, *paragraphs(command.help), *panels(command, everything=everything), examples])


def panels(command: Command, *, everything: bool) -> list[tuple[str, list[Row]]]:
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
