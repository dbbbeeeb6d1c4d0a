"""The command line, called in this process."""

import shlex

import click
import pytest

from lirs_validation.cli import app as cli, command
from lirs_validation.cli.command import PROGRAM, Command

COMMANDS: dict[str, Command] = {
    name: PROGRAM.get_command(click.Context(PROGRAM), name)  # type: ignore[misc]
    for name in command.COMMANDS
}


def run_command(*arguments: str) -> int:
    """Run `lirs-wct ARGUMENTS` and return its exit code."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.argv", ["lirs-wct", *arguments])
        with pytest.raises(SystemExit) as ended:
            cli.main()
    return int(ended.value.code or 0)


def check_command(line: str) -> None:
    """Read a line such as `lirs-wct build a.png` as the program does, without running it."""
    _, name, *arguments = shlex.split(line, comments=True)
    with COMMANDS[name].make_context(name, arguments) as context:
        assert not context.args
        COMMANDS[name].arguments(**context.params)
