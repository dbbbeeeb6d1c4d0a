"""Help: few options in order of use, all with `--help-all`; the shell completes names."""

import re
from pathlib import Path

import pytest
import typer
from typer.exceptions import TyperException
from typer.testing import CliRunner

from lirs_validation.cli.app import COMMANDS, make_app
from lirs_validation.cli.help import COMMON, MOST

PROGRAM = typer.main.get_command(make_app()).commands  # type: ignore[attr-defined]
WIDE = {"COLUMNS": "300", "TERM": "dumb"}


def flags(name: str, flag: str = "--help") -> list[str]:
    """First flag of each option that the help of a command lists."""
    shown = CliRunner().invoke(make_app(), [name, flag], env=WIDE)
    assert shown.exit_code == 0
    return re.findall(r"^│ (?:\*|) *(-[\w-]+)", shown.output, re.MULTILINE)


def listed(name: str) -> dict[str, str]:
    """First long flag of each option that is not hidden, by each flag."""
    found = [p.opts for p in PROGRAM[name].params if p.param_type_name == "option" and not p.hidden]
    return {flag: next(long for long in opts if long.startswith("--")) for opts in found for flag in opts}


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_the_help_lists_at_most_fifteen_options(name: str) -> None:
    assert len(flags(name)) <= MOST


@pytest.mark.parametrize("name", sorted(COMMON))
def test_the_common_options_come_in_order_of_use_and_all_with_help_all(name: str) -> None:
    long = listed(name)
    assert flags(name) == [*(long[flag] for flag in COMMON[name]), "--help-all", "--help"]
    assert set(flags(name, "--help-all")) == {*long.values(), "--help"}
    assert len(set(long.values())) > MOST
    told = re.search(
        r"Show all (\d+) options", CliRunner().invoke(make_app(), [name, "--help"], env=WIDE).output
    )
    assert told is not None
    assert int(told[1]) == len(set(long.values())) - 1


def test_a_help_changes_no_later_one() -> None:
    assert flags("build") == flags("build")
    flags("build", "--help-all")
    assert len(flags("build")) <= MOST
    assert "--drape" in flags("build", "--help-all")


def test_commands_are_listed_in_order_of_use() -> None:
    shown = CliRunner().invoke(make_app(), ["--help"], env=WIDE).output
    listed = re.findall(r"^│ ([a-z]+)  ", shown, re.MULTILINE)
    assert listed == list(COMMANDS)
    assert listed[:3] == ["verdict", "validate", "map"]


@pytest.mark.parametrize(
    ("words", "found"),
    [
        ("validate medium --robot hus", ["husky"]),
        ("validate medium --mapper hector,gm", ["hector,gmapping", "hector,gmapping_original"]),
        ("validate medium --attitude n", ["none"]),
        ("validate me", ["medium"]),
        ("build adv", ["advanced"]),
        ("info worlds/ha", ["worlds/hall"]),
        ("map log.clf --second no", ["none"]),
        ("val", ["validate"]),
    ],
)
def test_the_shell_completes(
    words: str, found: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "worlds" / "hall").mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    line = f"lirs-wct {words}"
    env = {"_LIRS_WCT_COMPLETE": "complete_bash", "COMP_WORDS": line, "COMP_CWORD": str(len(words.split()))}
    shown = CliRunner().invoke(make_app(), [], env=env, prog_name="lirs-wct")
    assert shown.output.split() == found


@pytest.mark.parametrize(
    ("words", "similar"),
    [
        ("validat medium", "validate"),
        ("validate medum", "medium"),
        ("validate medium --robot huskie", "husky"),
        ("validate medium --mapper hectro", "hector"),
        ("validate medium --mapperr hector", "--mapper"),
    ],
)
def test_a_misspelled_name_suggests_the_right_one(words: str, similar: str) -> None:
    error = CliRunner().invoke(make_app(), words.split(), standalone_mode=False).exception
    told = error.format_message() if isinstance(error, TyperException) else str(error)
    assert re.search(rf"[Dd]id you mean '?{similar}'?\?|Possible options: .*{similar}\b", told)
