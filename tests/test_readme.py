"""The README's commands and programs run as they stand, shortened; what needs a screen or hours is parsed."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import typer

from lirs_validation.cli.app import app

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
COMMANDS = [line.split("  #")[0].strip() for line in README.splitlines() if line.startswith("    lirs-wct ")]
PROGRAMS = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
FEWER = {"0,5,20": "5", "gmapping,hector,cartographer": "hector", "husky,jackal": "husky"}
"""Values in place of lists of them."""
SHORT = {"validate": "--seconds 1 --seeds 1", "record": "--seconds 1", "collide": "--seconds 1"}
"""Options that shorten a command: the last of its kind counts."""
PARSED = ("gui", "--suite paper", "bench")
"""Parts of commands that need a browser, or hours."""


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the examples in it, as the repository's root has them."""
    folder = tmp_path_factory.mktemp("readme")
    (folder / "examples").symlink_to(ROOT / "examples")
    return folder


def shortened(command: str) -> str:
    """Return a command that takes seconds."""
    name = command.split()[1]
    command = re.sub(r"--seed(s?) \S+", "", command) if name in SHORT else command
    for values, one in FEWER.items():
        command = command.replace(values, one)
    return f"{command} {SHORT.get(name, '')}"


@pytest.mark.slow
def test_commands_run_in_their_order(root: Path) -> None:
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = os.environ | {"PATH": path, "PYTHONPATH": os.pathsep.join(sys.path)}
    for command in COMMANDS:
        if any(part in command for part in PARSED):
            continue
        ran = subprocess.run(
            ["bash", "-c", shortened(command)], cwd=root, env=environment, capture_output=True, text=True,
            timeout=600, check=False,
        )  # fmt: skip
        assert ran.returncode == 0, f"{command}\n{ran.stdout}\n{ran.stderr}"


@pytest.mark.parametrize("command", COMMANDS)
def test_the_parser_takes_a_command(command: str) -> None:
    _, name, *arguments = shlex.split(command)
    commands = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    with commands[name].make_context(name, arguments) as context:
        assert not context.args


@pytest.mark.slow
@pytest.mark.parametrize("number", range(len(PROGRAMS)))
def test_a_program_runs(number: int, root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Programs go on from one another, as in the README; the one that trains needs an extra."""
    if "stable_baselines3" in PROGRAMS[number]:
        pytest.importorskip("stable_baselines3", reason="Stable-Baselines3 is not installed (extra [rl])")
    monkeypatch.chdir(root)
    before = [text for text in PROGRAMS[:number] if "stable_baselines3" not in text]
    program = re.sub(r"seconds=\d+", "seconds=1", "\n".join((*before, PROGRAMS[number])))
    exec(compile(program.replace("120_000", "1"), "README.md", "exec"), {"__name__": "readme"})


@pytest.mark.parametrize("path", sorted(set(re.findall(r"examples/data/[\w.]+", README))))
def test_inputs_that_it_names_ship(path: str) -> None:
    assert (ROOT / path).is_file()
