"""The command line, called in this process."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from lirs_validation import cli
from lirs_validation.cli import console

Said = tuple[int, str, str]


@pytest.fixture
def wct(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Any:
    """Run the command line in an empty folder; return exit code, stdout and stderr."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(console.out, "_width", 200)
    monkeypatch.setattr(console.out, "_height", 50)  # else a dumb terminal has 80 columns whatever the width

    def call(*arguments: str) -> Said:
        monkeypatch.setattr("sys.argv", ["lirs-wct", *arguments])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        said = capsys.readouterr()
        return int(ended.value.code or 0), said.out, said.err

    return call
