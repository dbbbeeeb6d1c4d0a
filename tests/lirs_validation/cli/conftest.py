"""The command line, called in this process."""

from pathlib import Path
from typing import Any

import pytest

from lirs_validation.cli import progress
from tests.command_line import run_command

Said = tuple[int, str, str]


@pytest.fixture
def wct(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Any:
    """Run the command line in an empty folder; return exit code, stdout and stderr."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(progress.out, "_width", 200)
    monkeypatch.setattr(progress.out, "_height", 50)  # else a dumb terminal has 80 columns whatever the width

    def call(*arguments: str) -> Said:
        code, said = run_command(*arguments), capsys.readouterr()
        return code, said.out, said.err

    return call
