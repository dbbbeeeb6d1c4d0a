"""Ctrl-C while files are written leaves nothing half-written, and what was there before stays."""

import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

MAIN = [sys.executable, "-c", "from lirs_validation.cli.app import main; main()"]


def listing(folder: Path) -> list[str]:
    return sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*"))


def interrupted(folder: Path, begun: Callable[[], bool], *arguments: str) -> tuple[int, str]:
    """Send SIGINT as soon as `begun`; return exit code and what was said."""
    process = subprocess.Popen(
        [*MAIN, *arguments],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # A shell's background job ignores SIGINT, and its children inherit that.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    deadline = time.monotonic() + 120
    while not begun():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.005)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=120)
    return process.returncode, said


def test_an_interrupted_build_leaves_the_older_world(tmp_path: Path) -> None:
    older = tmp_path / "worlds" / "advanced"
    older.mkdir(parents=True)
    (older / "world.json").write_text("{}")
    before = listing(tmp_path)
    code, said = interrupted(
        tmp_path, lambda: any(tmp_path.glob("worlds/.*/*meshes*")), "build", "advanced", "-o", "worlds"
    )
    assert code == 130, said
    assert said.strip().splitlines()[-1] == "lirs-wct: interrupted; nothing half-written was left"
    assert "Traceback" not in said
    assert listing(tmp_path) == before
    assert (older / "world.json").read_text() == "{}"


def test_an_interrupted_run_leaves_nothing(tmp_path: Path) -> None:
    begun = time.monotonic()
    code, said = interrupted(
        tmp_path, lambda: time.monotonic() - begun > 6, "validate", "simple", "--seconds", "600", "-o", "out"
    )
    assert code == 130, said
    assert "Traceback" not in said
    assert listing(tmp_path) == []
