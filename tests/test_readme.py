"""Commands and programs of README and guides run, shortened; those that need a screen or hours are parsed.

The README's own size and sentences stay within `style_limits.toml`.
"""

import re
import shlex
import tomllib
from pathlib import Path
from typing import Any
from unittest.mock import patch

import gymnasium as gym
import pytest

from lirs_envs.tasks.task import TASKS
from tests.command_line import check_command, run_command

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
EXAMPLES = (ROOT / "docs/reference/command_line.md").read_text(encoding="utf-8")
GUIDES = sorted((ROOT / "docs/howto").glob("coming_from_*.md"))
LIMITS = tomllib.loads(Path(__file__).with_name("style_limits.toml").read_text(encoding="utf-8"))
COMMANDS = [
    line.split("   #")[0].split("  #")[0].strip()
    for line in (README + EXAMPLES).splitlines()
    if re.match(r"( {4})?lirs-wct ", line)
]
QUOTED = [
    command
    for page in (ROOT / "README.md", *GUIDES)
    for command in re.findall(r"`(lirs-wct [a-z][^`]*)`", page.read_text(encoding="utf-8"))
]
"""Commands within sentences and tables."""
PROGRAMS = [
    program
    for page in ("README.md", "docs/howto/python.md", "docs/howto/policy.md")
    for program in re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(encoding="utf-8"), re.DOTALL)
]
FEWER = {"0,5,20": "5", "gmapping,hector,cartographer": "hector", "husky,jackal": "husky"}
"""Values in place of lists of them."""
SHORT = {
    "validate": "--seconds 1 --seed 1",
    "verdict": "--seconds 20 --budget 1s",
    "record": "--seconds 1",
    "collide": "--seconds 1",
}
"""Options that shorten a command: the last of its kind counts."""
PARSED = ("gui", "--suite paper", "bench", "falsify")
"""Parts of commands that need a browser, or minutes."""


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the examples in it, as the repository's root has them."""
    folder = tmp_path_factory.mktemp("readme")
    (folder / "examples").symlink_to(ROOT / "examples")
    return folder


def shortened(command: str) -> str:
    """Return a command that takes seconds."""
    name = command.split()[1]
    command = re.sub(r"--seed \S+", "", command) if name in SHORT else command
    for values, one in FEWER.items():
        command = command.replace(values, one)
    return f"{command} {SHORT.get(name, '')}"


@pytest.mark.slow
def test_commands_run_in_their_order(
    root: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(root)
    monkeypatch.syspath_prepend(str(root))
    for command in COMMANDS:
        if not any(part in command for part in PARSED):
            code = run_command(*shlex.split(shortened(command))[1:])
            assert code == 0, (command, capsys.readouterr())


def test_no_command_has_a_pattern_that_a_second_run_matches_too() -> None:
    assert [command for command in (*COMMANDS, *QUOTED) if "*" in command] == []


@pytest.mark.parametrize("command", dict.fromkeys((*COMMANDS, *QUOTED)))
def test_the_parser_takes_a_command(command: str) -> None:
    check_command(command)


@pytest.mark.slow
def test_programs_run_in_their_order(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Programs continue from one another."""
    monkeypatch.chdir(root)
    names: dict[str, Any] = {"__name__": "readme"}
    with patch.dict(TASKS), patch.dict(gym.registry):
        for number, text in enumerate(PROGRAMS):
            program = re.sub(r"seconds=\d+", "seconds=1", text)
            exec(compile(program, f"program {number}", "exec"), names)


@pytest.mark.parametrize("path", sorted(set(re.findall(r"examples/data/\w[\w.]*\w", README + EXAMPLES))))
def test_inputs_that_it_names_ship(path: str) -> None:
    assert (ROOT / path).is_file()


def sentences() -> list[str]:
    """Return the README's sentences: text outside code, tables, pictures and link targets."""
    text = re.sub(r"```.*?```|<[^>]+>|!\[[^]]*\]\([^)]*\)", "", README, flags=re.DOTALL)
    text = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", text)
    blocks = re.split(r"\n\s*\n", re.sub(r"^(\||#|    ).*$", "", text, flags=re.MULTILINE))
    blocks = [re.sub(r"`[^`]*`", "CODE", block) for block in blocks if "·" not in block]
    found = [sentence for block in blocks for sentence in re.split(r"(?<=[.?!:])\s+", block)]
    return [sentence for sentence in found if len(sentence.split()) > 2]


def test_readme_is_short() -> None:
    words = re.sub(r"```.*?```|<[^>]+>", " ", README, flags=re.DOTALL).split()
    assert README.count("\n") <= LIMITS["readme_lines"]
    assert len(words) <= LIMITS["readme_words"]


def test_readme_sentences_are_short() -> None:
    lengths = [len(sentence.split()) for sentence in sentences()]
    assert [text for text in sentences() if len(text.split()) > LIMITS["readme_longest_sentence"]] == []
    assert sum(lengths) / len(lengths) <= LIMITS["readme_mean_sentence"]
