"""Commands of functions whose parameters are classes of options: their parser, their help, their sources."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import MISSING, dataclass, replace
from io import StringIO
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

import click
from rich.console import Console, RenderableType
from rich.panel import Panel
from rich.table import Table

from lirs_validation.cli.progress import note, out, progress_bar
from lirs_wct.errors import ConfigError, did_you_mean, require_known
from lirs_wct.formats import Storage
from lirs_wct.option import Option, Options, argument, declared, option

if TYPE_CHECKING:
    from lirs_wct.sources.source import BuildOptions

COMMANDS: Mapping[str, str] = {
    "verdict": "lirs_extensions.decide.command:verdict",
    "validate": "lirs_validation.cli.commands.validate:validate",
    "map": "lirs_validation.cli.commands.worlds:map_log",
    "falsify": "lirs_extensions.search.commands:falsify",
    "tune": "lirs_extensions.search.commands:tune",
    "twin": "lirs_extensions.search.commands:twin",
    "build": "lirs_validation.cli.commands.worlds:build",
    "report": "lirs_validation.cli.commands.reports:report",
    "compare": "lirs_validation.cli.commands.reports:compare",
    "score": "lirs_validation.cli.commands.reports:score",
    "info": "lirs_validation.cli.commands.worlds:info",
    "gui": "lirs_validation.cli.commands.worlds:gui",
    "list": "lirs_validation.cli.commands.installation:list_names",
    "export": "lirs_validation.cli.commands.reports:export",
    "record": "lirs_validation.cli.commands.validate:record",
    "live": "lirs_extensions.live.command:live",
    "bench": "lirs_extensions.bench.command:bench",
    "collide": "lirs_validation.cli.commands.validate:collide",
    "convert": "lirs_validation.cli.commands.worlds:convert",
    "examples": "lirs_validation.cli.commands.installation:examples",
    "doctor": "lirs_validation.cli.commands.installation:doctor",
}
"""Module and function of each command, in order of use."""
MOVED: Mapping[str, str] = {
    "view": "info SOURCE -o PICTURE.png",
    "mappers": "list mappers",
    "robot": "list robots NAME, or lirs-wct export NAME --to urdf",
}
"""New ways of old commands."""
Row = tuple[str, str, str]
"""Flags, placeholder of the value, and description."""
ARGUMENTS, OPTIONS, RARE = "Arguments", "Options", "Rare options: --option NAME=VALUE"
SHORT = {"output": "-o"}
"""Short flags, by name of the option."""


def common(*names: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Name the options that the help of a command shows, in order of use."""

    def mark(function: Callable[..., None]) -> Callable[..., None]:
        function.__dict__["common"] = names
        return function

    return mark


class Program(click.Group):
    """The program; the module of a command is loaded when the command is."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of the commands, in order of use."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command:
        """Return a command of `COMMANDS`."""
        if name in MOVED:
            raise ConfigError(f"{name}: is now lirs-wct {MOVED[name]}")
        if name not in COMMANDS:
            raise ConfigError(f"no command {name!r}{did_you_mean(name, COMMANDS)}; lirs-wct --help lists all")
        return Command(name, resolve_name(COMMANDS[name]))

    def format_help(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands, each with the first line of its help."""
        helps = {name: inspect.getdoc(resolve_name(function)) or "" for name, function in COMMANDS.items()}
        rows = [(name, "", text.partition("\n")[0]) for name, text in helps.items()]
        usage = f"\n Usage: {ctx.command_path} COMMAND [ARGS]...\n"
        flags = [(f"--{what}", "", f"Show the {what} and exit.") for what in ("version", "help")]
        formatter.write(render([usage, *paragraphs(self.help), ("Options", flags), ("Commands", rows)]))


PROGRAM = click.version_option(package_name="lirs-wct", message="lirs-wct %(version)s")(
    Program(
        "lirs-wct",
        no_args_is_help=True,
        help="Turn a picture, a laser map or a mesh into a world, drive it with SLAM running, evaluate.",
    )
)


class Command(click.Command):
    """Command of a function; its docstring is the help, with examples at the end.

    A parameter `C` of the function stands for an instance of a class of options, `Annotated[C, names]` for
    one with few flags, and `Annotated[dict, C]` for the given values alone.

    Attributes:
        kinds: Class of options of each parameter of the function, and whether it takes the given values.
        own: Options with a flag, and arguments, by name.
        rare: Options that `--option NAME=VALUE` takes, by name.
        common: Names of the options in the help; empty = all.
    """

    def __init__(self, name: str, function: Callable[..., None]) -> None:
        text, _, examples = inspect.cleandoc(function.__doc__ or "").partition("\n\nExamples:\n")
        self.kinds: dict[str, tuple[type[Options], bool]] = {}
        self.own: dict[str, Option] = {}
        self.rare: dict[str, Option] = {}
        self.common: Sequence[str] = getattr(function, "common", ())
        for parameter, hint in inspect.get_annotations(function, eval_str=True).items():
            if hint is None:  # of the return value
                continue
            kind: Any = getattr(hint, "__origin__", hint)
            mark: Any = getattr(hint, "__metadata__", (None,))[0]
            as_dict = not issubclass(kind, Options)
            self.kinds[parameter] = (mark if as_dict else kind), as_dict
            for known in declared(self.kinds[parameter][0]).values():
                has_flag = known.name in mark if isinstance(mark, tuple) else not known.rare
                (self.own if has_flag else self.rare)[known.name] = known
        parameters = [_parameter(known) for known in self.own.values()]
        parameters += [_rare_option(self.rare)] if self.rare else []
        parameters += [_help_all()] if self.common else []
        super().__init__(
            name,
            params=parameters,
            callback=lambda **given: function(**self.arguments(**given)),
            help=text,
            epilog=inspect.cleandoc(examples),
        )

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse a command line; for an unknown option, ConfigError says what replaced it."""
        try:
            return super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            raise ConfigError(self.unknown(error.option_name)) from error

    def format_help(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the help: common options, or all of them after `--help-all`."""
        everything = not self.common or "--help-all" in ctx.meta
        usage = f"\n Usage: {ctx.command_path} {' '.join(self.collect_usage_pieces(ctx))}\n"
        examples = f"Examples:\n\n{self.epilog}\n" if self.epilog else ""
        texts = [usage, *paragraphs(self.help)]
        formatter.write(render([*texts, *panels(self, everything=everything), examples]))

    def unknown(self, flag: str) -> str:
        """Return the message about a flag that the command does not have."""
        name = flag.removeprefix("--").replace("-", "_")
        if name in self.rare:
            return f"{flag}: give --option {flag[2:]}={self.rare[name].form}"
        flags = [row.flag for row in (*self.own.values(), *self.rare.values()) if not row.positional]
        return f"{self.name} has no option {flag}{did_you_mean(flag, flags)}"

    def arguments(self, option: tuple[str, ...] = (), **given: Any) -> dict[str, Any]:
        """Return the arguments of the function for the texts of a command line."""
        values = {
            name: self.own[name].read(value, self.own[name].flag) if isinstance(value, str) else value
            for name, value in given.items()
            if value not in (None, False, ())
        }
        for text in option:
            name, equals, value = text.partition("=")
            name, options = name.strip().replace("-", "_"), {**self.rare, **self.own}
            if not equals:
                raise ConfigError(f"--option must be NAME=VALUE, got {text!r}")
            require_known("--option", name, options)
            if name in values:
                raise ConfigError(f"--option {text}: {name} is given already")
            values[name] = options[name].read(value, f"--option {name}")
        arguments = {}
        for parameter, (kind, as_dict) in self.kinds.items():
            own = {name: values[name] for name in declared(kind) if name in values}
            arguments[parameter] = own if as_dict else kind(**own)
        return arguments


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


def panels(command: Command, *, everything: bool) -> list[tuple[str, list[Row]]]:
    """Return headings and rows of a command's arguments and options."""
    shown: dict[str, list[Row]] = {}
    own = {name: _row(known) for name, known in command.own.items()}
    for name, known in command.own.items():
        if known.positional:
            shown.setdefault(ARGUMENTS, []).append(own[name])
        elif everything:
            shown.setdefault(known.panel or OPTIONS, []).append(own[name])
    usual = shown.setdefault(OPTIONS, [])
    if not everything:
        usual += [own[name] for name in command.common]
    for param in command.params:
        if isinstance(param, click.Option) and param.name in ("option", "help_all"):
            usual.append((param.opts[0], param.metavar or "", param.help or ""))
    usual.append(("--help", "", "Show this message and exit."))
    if everything and command.rare:
        rare = command.rare.values()
        shown[RARE] = [(known.name.replace("_", "-"), known.form, _row(known)[2]) for known in rare]
    return [(title, rows) for title, rows in shown.items() if rows]


def _row(option: Option) -> Row:
    """Return flags, placeholder and description of an option."""
    flags = option.form if option.positional else option.flag
    if option.name == "output":
        flags = f"{flags}, -o"
    form = "" if option.positional or option.type is bool else option.form
    usual = "" if option.default in (None, False, (), "", MISSING) else _text(option.default)
    return flags, form, f"{option.help} [default: {usual}{option.unit}]" if usual else option.help


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


SOURCE_HELP = "simple, medium, advanced, a picture, a map YAML, a laser log, a mesh or a built folder."


def complete_source(incomplete: str) -> list[str]:
    """Return bundled worlds and paths that begin with a text, for the shell."""
    # Slow to import; only the shell's completion needs it.
    from lirs_wct.sources.bundled import RECIPES

    worlds = [name for name in RECIPES if name.startswith(incomplete)]
    folder, separator, name = incomplete.rpartition("/")
    found = [path.name for path in Path(folder + separator).glob("*") if path.name.startswith(name)]
    return worlds + sorted(folder + separator + name for name in found)


def sources_argument(**given: Any) -> Any:
    """Return a field of several sources."""
    return argument(SOURCE_HELP, "SOURCES...", complete=complete_source, **given)


@dataclass(frozen=True, kw_only=True)
class OneSource(Options):
    """Source of a command."""

    source: str = argument(SOURCE_HELP, "SOURCE", complete=complete_source)


@dataclass(frozen=True, kw_only=True)
class BagOptions(Options):
    """ROS 2 bag that a command writes."""

    storage: Storage = option("mcap", "Storage of the bag's messages.")
    sensors_only: bool = option(
        False, "Neither map -> odom nor /map, and clouds without NaN: for a SLAM system."
    )


@dataclass(frozen=True, kw_only=True)
class LimitsOption(Options):
    """Limits of the verdicts."""

    limits: Path | None = option(None, "YAML file with limits of the verdicts.", metavar="FILE.yaml")


def map_logs(
    sources: Sequence[str], options: BuildOptions, output: Path | None
) -> tuple[tuple[str, ...], BuildOptions]:
    """Replace the logs among sources by their maps; return the options that are left.

    The maps are written into the command's output folder, or beside its output file; None = here. The
    resolution of logs is that of their maps.
    """
    from lirs_wct.sources.source import is_log  # readers of pictures load slowly

    logs = [source for source in sources if is_log(Path(source))]
    folder = Path() if output is None else output.parent if output.suffix else output
    maps = {}
    for log in logs:
        from lirs_validation.logs.map_log import resolve_source

        with progress_bar(log) as progress:
            maps[log] = str(resolve_source(log, options, folder, progress))
        note(f"{log}: its map is {maps[log]}")
    if logs and len(logs) == len(sources):
        options = replace(options, resolution=None)
    return tuple(maps.get(source, source) for source in sources), options
