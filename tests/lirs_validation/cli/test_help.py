"""Help: few options in order of use, all with `--help-all`, examples that run; the shell completes names."""

import re
import shlex
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from lirs_validation.cli.command import COMMANDS, MOVED, PROGRAM, RARE, Command, panels
from tests.command_line import run_command

ROOT = Path(__file__).resolve().parents[3]
MAX_OPTIONS = 15
"""Options that a help shows, besides those that show more help."""


def command(name: str) -> Command:
    found = PROGRAM.get_command(click.Context(PROGRAM), name)
    assert isinstance(found, Command)
    return found


def shown(*words: str) -> str:
    result = CliRunner().invoke(PROGRAM, words)
    assert result.exit_code == 0
    return result.output


def flags(text: str) -> list[str]:
    """Return the first flag of each option that a help lists."""
    return re.findall(r"^│ (--[\w-]+)", text, re.MULTILINE)


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_the_help_shows_at_most_fifteen_options_and_help_all_shows_every_one(name: str) -> None:
    found, short = command(name), flags(shown(name, "--help"))
    more = {"--help", "--help-all", "--option"}
    assert len(set(short) - more) <= MAX_OPTIONS
    own = [option.flag for option in found.own.values() if not option.positional]
    if not found.common:
        assert set(short) - more == set(own)
        return
    assert short[:-3] == [found.own[option].flag for option in found.common]
    assert len(own) > MAX_OPTIONS
    everything, _, rare = shown(name, "--help-all").partition(RARE)
    assert set(flags(everything)) == {*own, *more}
    listed = re.findall(r"^│ ([a-z][a-z-]*) ", rare, re.MULTILINE)
    assert listed == [option.replace("_", "-") for option in found.rare]


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_a_default_stands_as_a_user_types_it_and_a_flag_takes_no_value(name: str) -> None:
    found = command(name)
    rows = {row[0].split(",")[0]: row for _, panel in panels(found, everything=True) for row in panel}
    for option in (*found.own.values(), *found.rare.values()):
        flag = option.form if option.positional else option.flag
        _, form, text = rows[option.name.replace("_", "-") if option.name in found.rare else flag]
        if option.type is bool:
            assert form == ("true|false" if option.name in found.rare else "")
        usual = re.search(r"\[default: (.*)\]$", text)
        if usual is not None:
            assert option.read(usual[1], option.flag) in (option.default, (option.default,))
    for arguments in ("--help", "--help-all" if found.common else "--help"):
        assert not re.search(r"default: [(\['\"]|<\w+>|\bbool\b", shown(name, arguments), re.IGNORECASE)


def test_a_help_changes_no_later_one() -> None:
    before = shown("build", "--help")
    assert "crop " in shown("build", "--help-all")
    assert shown("build", "--help") == before


def test_commands_are_listed_in_order_of_use() -> None:
    listed = re.findall(r"^│ ([a-z]+)  ", shown("--help"), re.MULTILINE)
    assert listed == list(COMMANDS)
    assert listed[:3] == ["verdict", "validate", "map"]


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_each_example_stands_on_a_line_of_the_help_and_its_parser_takes_it(name: str) -> None:
    lines = shown(name, "--help").splitlines()
    examples = (command(name).epilog or "").splitlines()
    assert examples
    for example in examples:
        assert example in lines
        program, called, *arguments = shlex.split(example)
        assert program == "lirs-wct"
        with command(called).make_context(called, arguments) as context:
            assert not context.args
        inputs = [word for word in arguments if word.startswith("examples/")]
        assert [word for word in inputs if not (ROOT / word).is_file()] == []


@pytest.mark.parametrize(
    ("words", "found"),
    [
        ("validate medium --robot hus", ["husky"]),
        ("validate medium --mapper hector,gm", ["hector,gmapping", "hector,gmapping_original"]),
        ("validate medium --attitude n", ["none"]),
        ("validate medium --option sca", ["scan_time=", "scale="]),
        ("validate me", ["medium"]),
        ("build adv", ["advanced"]),
        ("info worlds/ha", ["worlds/hall"]),
        ("map log.clf --second no", ["none"]),
        ("list ro", ["robots"]),
        ("val", ["validate"]),
    ],
)
def test_the_shell_completes(
    words: str, found: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "worlds" / "hall").mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    line = f"lirs-wct {words}"
    env = {"_LIRS_WCT_COMPLETE": "bash_complete", "COMP_WORDS": line, "COMP_CWORD": str(len(words.split()))}
    result = CliRunner().invoke(PROGRAM, [], env=env, prog_name="lirs-wct")
    assert [entry.partition(",")[2] for entry in result.output.split()] == found


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("validat medium", "no command 'validat'; did you mean validate?; lirs-wct --help lists all"),
        ("validate medum", "did you mean medium?"),
        ("validate medium --robot huskie", "did you mean husky?"),
        ("validate medium --mapper hectro", "did you mean hector?"),
        ("validate medium --mapperr hector", "validate has no option --mapperr; did you mean --mapper?"),
        ("build simple --croop 1", "build has no option --croop; did you mean --crop?"),
        ("build simple --option croop=1", "unknown --option 'croop'; legal: "),
        ("build simple --option crop", "--option must be NAME=VALUE, got 'crop'"),
        ("build simple --option deterrace=perhaps", "--option deterrace must be true or false"),
        ("build simple --crop 1,2,3,4", "--crop: give --option crop=X,Y,W,H"),
        ("verdict simple --seeds 1-5", "verdict has no option --seeds; did you mean --seed?"),
        ("info simple --scale 2 --option scale=3", "--option scale=3: scale is given already"),
        ("validate simple --option scale=2 --option scale=3", "--option scale=3: scale is given already"),
        ("validate simple --source x", "validate has no option --source"),
        ("view simple", "view: is now lirs-wct info SOURCE -o PICTURE.png"),
    ],
)
def test_a_wrong_or_old_word_gets_the_right_one_in_one_line(
    words: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command(*words.split()) == 2
    told = capsys.readouterr().err
    assert message in told.replace("\n", " ")
    assert told.count("lirs-wct: ") == 1


def test_no_command_has_an_old_name() -> None:
    assert set(MOVED) & set(COMMANDS) == set()
