"""The program reads each command of the README; its size stays within `style_limits.toml`."""

import re
import tomllib
from pathlib import Path

import pytest

from tests.command_line import check_command
from tests.pages import PAGES, ROOT, steps

README = (ROOT / "README.md").read_text(encoding="utf-8")
LIMITS = tomllib.loads(Path(__file__).with_name("style_limits.toml").read_text(encoding="utf-8"))
COMMANDS = [step.text for step in steps(ROOT / "README.md") if not step.program]


def test_commands_and_programs_are_found() -> None:
    """The test of the wheel runs what is found, and nothing else."""
    assert sum(len(steps(page)) for page in PAGES) > 140


def test_no_command_has_a_pattern_that_a_second_run_matches_too() -> None:
    assert [command for command in COMMANDS if "*" in command] == []


@pytest.mark.parametrize("command", COMMANDS)
def test_the_parser_takes_a_command(command: str) -> None:
    check_command(command)


@pytest.mark.parametrize("path", sorted(set(re.findall(r"examples/data/\w[\w.]*\w", README))))
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
