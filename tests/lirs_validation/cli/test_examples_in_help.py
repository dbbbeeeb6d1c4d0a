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
def test_help_shows_each_example_on_a_line_of_its_own(name: str) -> None:
    shown = CliRunner().invoke(make_app(), [name, "--help"], env={"COLUMNS": "200", "TERM": "dumb"}).output
    lines = [line.strip() for line in shown.splitlines()]
    assert "Examples:" in lines
    for example in EXAMPLES[name]:
        assert example in lines


@pytest.mark.parametrize("example", [line for lines in EXAMPLES.values() for line in lines])
def test_the_parser_takes_the_example(example: str) -> None:
    program, name, *arguments = shlex.split(example)
    assert program == "lirs-wct"
    with COMMANDS[name].make_context(name, arguments) as context:
        assert not context.args


def test_an_option_that_is_none_would_be_noticed() -> None:
    with pytest.raises(typer.exceptions.TyperException), COMMANDS["view"].make_context("view", ["a", "--b"]):
        pass


@pytest.mark.parametrize("example", [line for lines in EXAMPLES.values() for line in lines])
def test_inputs_that_examples_name_ship(example: str) -> None:
    for word in shlex.split(example):
        if word.startswith("examples/"):
            assert (ROOT / word).is_file()
