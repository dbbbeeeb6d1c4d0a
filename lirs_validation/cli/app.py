"""The command line, `lirs-wct`: every command is a function that `COMMANDS` names."""

from __future__ import annotations

import errno
import gc
import os
import sys
import warnings
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from pathlib import Path
from pkgutil import resolve_name
from typing import Annotated, Any

import typer
from typer.exceptions import TyperException

from lirs_validation.cli.help import Command, epilog
from lirs_validation.cli.progress import BAD_INPUT, INTERRUPTED, RUN_FAILED, err, out
from lirs_validation.cli.typer_options import with_options
from lirs_validation.experiment.own_code import importable
from lirs_validation.interrupts import is_interrupt, raise_interrupts
from lirs_wct.errors import ConfigError, MapperError, WctError

NO_ROOM = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
"""Error numbers of a full disk."""
PHRASES = {
    "Value error, ": "",
    "Input should be a valid integer, unable to parse string as an integer": "must be an integer",
    "Input should be a valid number, unable to parse string as a number": "must be a number",
}
"""Phrases of pydantic, and ours."""
LONGEST = 900
"""Characters of an error message, at most; of longer ones the middle is omitted."""
COMMANDS: Mapping[str, str] = {
    "verdict": "lirs_validation.cli.commands.verdict:verdict",
    "validate": "lirs_validation.cli.commands.validate:validate",
    "map": "lirs_validation.cli.commands.map:map_log",
    "falsify": "lirs_extensions.search.commands:falsify",
    "tune": "lirs_extensions.search.commands:tune",
    "twin": "lirs_extensions.search.commands:twin",
    "build": "lirs_validation.cli.commands.worlds:build",
    "report": "lirs_validation.cli.commands.reports:report",
    "compare": "lirs_validation.cli.commands.reports:compare",
    "score": "lirs_validation.cli.commands.reports:score",
    "info": "lirs_validation.cli.commands.worlds:info",
    "gui": "lirs_validation.cli.commands.gui:gui",
    "mappers": "lirs_validation.cli.commands.mappers:mappers",
    "robot": "lirs_validation.cli.commands.robot_card:robot",
    "export": "lirs_validation.cli.commands.reports:export",
    "record": "lirs_validation.cli.commands.validate:record",
    "live": "lirs_extensions.live.command:live",
    "bench": "lirs_extensions.bench.command:bench",
    "collide": "lirs_validation.cli.commands.collide:collide",
    "convert": "lirs_validation.cli.commands.worlds:convert",
    "doctor": "lirs_validation.cli.commands.doctor:doctor",
}
"""Module and function of each command, in order of use."""
MOVED: Mapping[str, str] = {"view": "info SOURCE -o PICTURE.png"}
"""New ways of old commands."""
COMPLETION = "_LIRS_WCT_COMPLETE"
"""Environment variable with which a shell asks for completions."""


def make_app(names: Collection[str] = tuple(COMMANDS), *, listed_only: bool = False) -> typer.Typer:
    """Return the program with some of its commands; modules of others are not loaded.

    Args:
        names: Commands.
        listed_only: Whether to leave out the commands' options, which the program's help does not show.
    """
    app = typer.Typer(
        name="lirs-wct",
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        help="Turn a picture, a laser map or a mesh into a world, drive it with SLAM running, evaluate.",
    )
    for name in names:
        command = resolve_name(COMMANDS[name])
        taken = _without_options(command) if listed_only else with_options(command)
        app.command(name, cls=Command, epilog=epilog(name))(taken)
    app.callback()(options)
    return app


def _app_for(arguments: list[str]) -> typer.Typer:
    """Return the program with the command of a command line, or with all of them."""
    if COMPLETION in os.environ:
        return make_app()
    for old in arguments[:1]:
        if old in MOVED:
            raise ConfigError(f"{old}: is now lirs-wct {MOVED[old]}")
    called = [argument for argument in arguments[:1] if argument in COMMANDS]
    return make_app(called) if called else make_app(listed_only=True)


def _without_options(command: Callable[..., Any]) -> Callable[[], None]:
    def listed() -> None: ...

    listed.__doc__ = command.__doc__
    return listed


def _show_version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version

        out.print(f"lirs-wct {version('lirs-wct')}", highlight=False)
        raise typer.Exit


def options(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit."),
    ] = False,
) -> None:
    """Take the options of the program itself."""


def main() -> None:
    """Run the command line; bad input is one line on stderr and exit code 2."""
    warnings.showwarning = _one_line
    # Of NumPy, about numbers in damaged files; a message of ours about the file follows.
    warnings.filterwarnings("ignore", category=RuntimeWarning)
    raise_interrupts()
    gc.set_threshold(100_000, 50, 50)  # imports and compiler make many objects, and little garbage
    try:
        with importable(Path.cwd()):
            code = _app_for(sys.argv[1:])(standalone_mode=False)
        if code == INTERRUPTED:
            # Typer turns Ctrl-C into its exit code, and says nothing.
            raise KeyboardInterrupt
    except MapperError as error:  # the input was good, its mapping failed
        _fail(str(error), RUN_FAILED)
    except WctError as error:
        _fail(str(error))
    except TyperException as error:
        if not error.format_message():  # a bare `lirs-wct`: its help was shown
            sys.exit(BAD_INPUT)
        _fail(_plain(error.format_message()))
    except (typer.Abort, KeyboardInterrupt):
        _fail("interrupted; nothing half-written was left", INTERRUPTED)
    except OSError as error:
        if error.errno not in NO_ROOM:
            raise
        # Output that is still buffered would fail again at exit.
        with suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        _fail(f"{error.filename or 'output'}: cannot be written: {error.strerror}")
    except SystemError as error:
        if not is_interrupt(error):
            raise
        _fail("interrupted; nothing half-written was left", INTERRUPTED)
    gc.freeze()  # nothing is left to collect; the end of the interpreter would look through all of it
    sys.exit(code if isinstance(code, int) else 0)


def _plain(message: str) -> str:
    """Return a message of typer without pydantic's phrases."""
    for theirs, ours in PHRASES.items():
        message = message.replace(theirs, ours)
    return message


def _fail(message: str, code: int = BAD_INPUT) -> None:
    if len(message) > LONGEST:
        message = f"{message[: LONGEST - 200]} ... {message[-200:]}"
    err.print(f"lirs-wct: {message}", markup=False, highlight=False, soft_wrap=True, style="red")
    sys.exit(code)


def _one_line(message: Warning | str, *_: Any, **__: Any) -> None:
    err.print(f"lirs-wct: {message}", markup=False, highlight=False, soft_wrap=True, style="yellow")
