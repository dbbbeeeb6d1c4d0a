"""The command line, `lirs-wct`: every command is a function that `COMMANDS` names."""

from __future__ import annotations

import errno
import gc
import inspect
import os
import sys
import warnings
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import click

from lirs_validation.cli.command import Command, paragraphs, render
from lirs_validation.cli.exit_codes import ExitCode
from lirs_validation.cli.progress import note
from lirs_validation.processes import importable, is_interrupt, raise_interrupts
from lirs_wct.errors import ConfigError, MapperError, WctError, did_you_mean

DISK_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
"""Error numbers of a full disk."""
MAX_MESSAGE_LENGTH = 900
"""Characters of an error message, at most; of longer ones the middle is omitted."""
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
    "gui": "lirs_validation.cli.commands.gui:gui",
    "list": "lirs_validation.cli.commands.installation:list_names",
    "export": "lirs_validation.cli.commands.reports:export",
    "record": "lirs_validation.cli.commands.validate:record",
    "live": "lirs_extensions.live.command:live",
    "bench": "lirs_extensions.bench.command:bench",
    "collide": "lirs_validation.cli.commands.validate:collide",
    "convert": "lirs_validation.cli.commands.worlds:convert",
    "doctor": "lirs_validation.cli.commands.installation:doctor",
}
"""Module and function of each command, in order of use."""
MOVED: Mapping[str, str] = {
    "view": "info SOURCE -o PICTURE.png",
    "mappers": "list mappers",
    "robot": "list robots NAME, or lirs-wct export NAME --to urdf",
}
"""New ways of old commands."""


class Program(click.Group):
    """The program; the module of a command is loaded when the command is."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of the commands, in order of use."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command:
        """Return a command.

        Raises:
            ConfigError: there is none of that name.
        """
        if name in MOVED:
            raise ConfigError(f"{name}: is now lirs-wct {MOVED[name]}")
        if name not in COMMANDS:
            raise ConfigError(f"no command {name!r}{did_you_mean(name, COMMANDS)}; lirs-wct --help lists all")
        return Command(name, resolve_name(COMMANDS[name]))

    def format_help(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands, each with the first line of its help."""
        rows = [(name, "", _first_line(function)) for name, function in COMMANDS.items()]
        usage = f"\n Usage: {ctx.command_path} COMMAND [ARGS]...\n"
        flags = [(f"--{what}", "", f"Show the {what} and exit.") for what in ("version", "help")]
        formatter.write(render([usage, *paragraphs(self.help), ("Options", flags), ("Commands", rows)]))


def _first_line(function: str) -> str:
    return (inspect.getdoc(resolve_name(function)) or "").partition("\n")[0]


PROGRAM = click.version_option(package_name="lirs-wct", message="lirs-wct %(version)s")(
    Program(
        "lirs-wct",
        no_args_is_help=True,
        help="Turn a picture, a laser map or a mesh into a world, drive it with SLAM running, evaluate.",
    )
)


def main() -> None:
    """Run the command line; bad input is one line on stderr and exit code 2."""
    warnings.showwarning = _one_line
    # Of NumPy, about numbers in damaged files; a message of ours about the file follows.
    warnings.filterwarnings("ignore", category=RuntimeWarning)
    raise_interrupts()
    gc.set_threshold(100_000, 50, 50)  # imports and compiler make many objects, and little garbage
    try:
        with importable(Path.cwd()):
            code = PROGRAM.main(prog_name="lirs-wct", standalone_mode=False)
    except MapperError as error:  # the input was good, its mapping failed
        _fail(str(error), ExitCode.RUN_FAILED)
    except WctError as error:
        _fail(str(error))
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        sys.exit(ExitCode.BAD_INPUT)
    except click.ClickException as error:
        _fail(error.format_message())
    except (click.Abort, KeyboardInterrupt):
        _fail("interrupted; nothing half-written was left", ExitCode.INTERRUPTED)
    except OSError as error:
        if error.errno not in DISK_FULL:
            raise
        # Output that is still buffered would fail again at exit.
        with suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        _fail(f"{error.filename or 'output'}: cannot be written: {error.strerror}")
    except SystemError as error:
        if not is_interrupt(error):
            raise
        _fail("interrupted; nothing half-written was left", ExitCode.INTERRUPTED)
    gc.freeze()  # nothing is left to collect; the end of the interpreter would look through all of it
    sys.exit(code if isinstance(code, int) else 0)


def _fail(message: str, code: int = ExitCode.BAD_INPUT) -> None:
    if len(message) > MAX_MESSAGE_LENGTH:
        message = f"{message[: MAX_MESSAGE_LENGTH - 200]} ... {message[-200:]}"
    note(f"lirs-wct: {message}", style="red")
    sys.exit(code)


def _one_line(message: Warning | str, *_: Any, **__: Any) -> None:
    note(f"lirs-wct: {message}", style="yellow")
