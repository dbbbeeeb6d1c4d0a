"""The command line as a user meets it: one line and exit code 2 for bad input, nothing left behind."""

import importlib.metadata
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from lirs_validation.config import read_drivers
from lirs_wct.errors import ConfigError
from lirs_wct.option import read_numbers


def started(*arguments: str | Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", "from lirs_validation.cli.app import main; main()", *map(str, arguments)]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=300, check=False)


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """A folder of things that a user may get wrong."""
    good = np.tile(np.arange(65, dtype=np.uint8) * 3, (65, 1))
    cv2.imwrite(str(tmp_path / "good.png"), good)
    data = (tmp_path / "good.png").read_bytes()
    (tmp_path / "cut.png").write_bytes(data[: len(data) // 2])
    (tmp_path / "a_file").write_text("in the way")
    return tmp_path


BAD = {
    "missing": (("build", "nowhere.png"), "nowhere.png: no such file"),
    "truncated": (("build", "cut.png"), "cut.png: "),
    "no world": (("validate", "smple"), "simple, medium, advanced"),
    "words": (("validate", "simple", "--seconds", "ten"), "--seconds"),
    "no option": (("build", "good.png", "--sizes", "3"), "--sizes"),
    "no folder": (("build", "good.png", "-o", "a_file"), "a_file"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_line_and_code_2(case: str, files: Path, wct: Any) -> None:
    arguments, expected = BAD[case]
    before = sorted(files.rglob("*"))
    code, _, err = wct(*arguments)
    assert code == 2, err
    assert expected in err
    assert err.count("\n") == 1, "one line, and no empty one before it"
    assert sorted(files.rglob("*")) == before


@pytest.mark.slow
def test_a_process_ends_with_code_2_and_without_a_traceback(files: Path) -> None:
    done = started(*BAD["truncated"][0], cwd=files)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr


def test_an_old_command_names_the_new_way(wct: Any) -> None:
    code, _, err = wct("view", "good.png")
    assert (code, err.strip()) == (2, "lirs-wct: view: is now lirs-wct info SOURCE -o PICTURE.png")


def test_no_command_shows_the_help_and_nothing_else(wct: Any) -> None:
    code, out, err = wct()
    assert code == 2
    assert "Usage" in out + err
    assert "lirs-wct:" not in err


def test_the_version_is_shown(wct: Any) -> None:
    assert wct("--version") == (0, f"lirs-wct {importlib.metadata.version('lirs-wct')}\n", "")


@pytest.mark.parametrize(
    ("text", "drivers"),
    [
        ("tour", ("tour",)),
        ("tour, frontier,tour", ("tour", "frontier")),
        ("goal:1,-2.5,tour", ("goal:1,-2.5", "tour")),
        ("pretrained,pretrained:2,3,tour", ("pretrained", "pretrained:2,3", "tour")),
        ("waypoints:a,b.csv,frontier", ("waypoints:a,b.csv", "frontier")),
        (
            "replay:out/x,waypoints:a/tour,b.csv,replay:y",
            ("replay:out/x", "waypoints:a/tour,b.csv", "replay:y"),
        ),
    ],
)
def test_drivers_are_read_though_paths_hold_commas(text: str, drivers: tuple[str, ...]) -> None:
    assert read_drivers(text) == drivers


@pytest.mark.parametrize("text", ["", "tours", "tour,", "frontier:x", "waypoints", "replay:", "tour,walk"])
def test_what_is_no_driver_is_told_with_the_legal_ones(text: str) -> None:
    with pytest.raises(
        ConfigError, match=r"--driver: unknown driver .*legal: tour, frontier, waypoints:FILE"
    ):
        read_drivers(text)


@settings(max_examples=25)
@given(st.lists(st.tuples(st.integers(0, 999), st.integers(0, 20)), min_size=1, max_size=6))
def test_seeds_are_read_as_written(ranges: list[tuple[int, int]]) -> None:
    text = ",".join(f"{a}-{a + n}" if n else f"{a}" for a, n in ranges)
    expected = [seed for a, n in ranges for seed in range(a, a + n + 1)]
    assert read_numbers(text, "--seed") == tuple(dict.fromkeys(expected))


@pytest.mark.parametrize("text", ["", "a", "1-", "-3", "5-1", "1,,2", "1.5", "0-99999999999", "1-999999999"])
def test_what_is_no_list_of_seeds_is_told(text: str) -> None:
    with pytest.raises(ConfigError, match="--seed must be a list such as"):
        read_numbers(text, "--seed")


def test_it_needs_its_extra(wct: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lirs_validation.cli.commands.worlds.find_spec", lambda _: None)
    code, _, err = wct("gui")
    assert code == 2
    assert "pip install 'lirs-wct[gui]'" in err


def test_an_address_that_is_taken_is_one_line(wct: Any) -> None:
    pytest.importorskip("viser")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        code, _, err = wct("gui", "--port", str(port))
    assert code == 2
    assert f"127.0.0.1:{port}: cannot be listened at" in err


def test_an_address_of_another_machine_is_one_line(wct: Any) -> None:
    pytest.importorskip("viser")
    code, _, err = wct("gui", "--host", "192.0.2.1", "--port", "0")
    assert code == 2
    assert "192.0.2.1:0: cannot be listened at" in err
