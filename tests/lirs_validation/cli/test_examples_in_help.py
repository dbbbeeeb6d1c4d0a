"""The help of every command ends with examples that its own parser takes."""

import shlex
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from lirs_validation.cli.app import make_app
from lirs_validation.cli.help import EXAMPLES

ROOT = Path(__file__).resolve().parents[3]
PROGRAM = typer.main.get_command(make_app())
COMMANDS = PROGRAM.commands  # type: ignore[attr-defined]


def test_every_command_has_examples_and_no_other_has() -> None:
    assert set(EXAMPLES) == set(COMMANDS)


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_each_example_stands_on_a_line_of_the_help_and_its_parser_takes_it(name: str) -> None:
    shown = CliRunner().invoke(make_app(), [name, "--help"], env={"COLUMNS": "200", "TERM": "dumb"}).output
    lines = [line.strip() for line in shown.splitlines()]
    assert "Examples:" in lines
    for example in EXAMPLES[name]:
        assert example in lines
        program, name, *arguments = shlex.split(example)
        assert program == "lirs-wct"
        with COMMANDS[name].make_context(name, arguments) as context:
            assert not context.args


def test_an_option_that_is_none_would_be_noticed() -> None:
    with pytest.raises(typer.exceptions.TyperException), COMMANDS["info"].make_context("info", ["a", "--b"]):
        pass


def test_inputs_that_examples_name_ship() -> None:
    words = shlex.split(" ".join(line for lines in EXAMPLES.values() for line in lines))
    assert [word for word in words if word.startswith("examples/") and not (ROOT / word).is_file()] == []
