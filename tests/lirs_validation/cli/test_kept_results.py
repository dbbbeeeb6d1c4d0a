"""Results of an earlier command stay complete when new ones cannot be written; one line says so."""

import errno
import gzip
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from lirs_extensions.live import run as live_run
from tests.command_line import run_command
from tests.lirs_extensions.live.fake_network import FakeNetwork
from tests.lirs_extensions.search.falsify.test_falsify_command import MAPPER
from tests.lirs_validation.cli.test_full_disk import DATA, SMALL, largest_file

DRIVEN = ("--seconds", "2", "--drives", "3", "--cases", "1")
COMMANDS = {
    "falsify": ("falsify", "--mapper", "half_way:HalfWay", "--seconds", "16", *DRIVEN[2:]),
    "falsify without a run": ("falsify", "--mapper", "half_way:Raises", *DRIVEN),
    "tune": ("tune", "simple", *SMALL, "--robot", "jackal", "--seconds", "9", "--drives", "2"),
    "twin": ("twin", "short.clf", "--mapper", "hector", "--replay", "none", "--draws", "3"),
    "live": ("live", "simple", "--lockstep", "--option", "limit=0.001", "--seconds", "0.4"),
}


@contextmanager
def no_permission(folder: Path) -> Iterator[None]:
    """Let nobody make a folder below a folder, as in one of another user."""
    make: Callable[..., None] = os.mkdir

    def mkdir(path: Any, *arguments: Any, **named: Any) -> None:
        if folder in Path(path).absolute().parents:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
        make(path, *arguments, **named)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "mkdir", mkdir)
        yield


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:no answer within")
@pytest.mark.parametrize("words", COMMANDS.values(), ids=COMMANDS)
def test_results_stay_when_new_ones_cannot_be_written(
    words: tuple[str, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(live_run, "open_middleware", lambda *_: FakeNetwork())
    Path("half_way.py").write_text(MAPPER)
    Path("file").write_text("mine")
    log = gzip.decompress((DATA / "office.clf.gz").read_bytes())
    Path("short.clf").write_bytes(b"".join(log.splitlines(keepends=True)[:150]))  # 11 m
    out = tmp_path / "out"
    assert run_command(*words, "-o", "out") == 0
    former = contents(tmp_path)
    refusals = [
        (largest_file(100), "out", "cannot be written: File too large"),
        (largest_file(10**9), "file", ""),
    ]
    if words[0] == "live":  # all write alike, and this takes a second
        refusals.append((no_permission(out), "out", "cannot be written: Permission denied"))
    for refusal, place, reason in refusals:
        capsys.readouterr()
        with refusal:
            assert run_command(*words, "-o", place) == 2
        said = [line for line in capsys.readouterr().err.splitlines() if line.startswith("lirs-wct: ")]
        assert len(said) == 1
        assert said[0].startswith(f"lirs-wct: {place}")
        assert reason in said[0]
        assert "/." not in said[0]
        assert contents(tmp_path) == former
        assert not [path for path in tmp_path.rglob(".*") if path.is_dir()]
