"""The command line as a user meets it: one line and exit code 2 for bad input, nothing left behind."""

import importlib.metadata
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest


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


def test_a_process_ends_with_code_2_and_without_a_traceback(files: Path) -> None:
    done = started(*BAD["truncated"][0], cwd=files)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr


def test_build_writes_the_package(files: Path) -> None:
    done = started("build", "good.png", "-o", "worlds", "--size", "20", "--height", "2", cwd=files)
    assert done.returncode == 0, done.stderr
    folder = files / "worlds" / "good"
    expected = {
        "model.config", "model.sdf", "good.world", "good.xml", "world.json",
        "meshes/good.dae", "meshes/good.stl", "materials/textures/good.png",
    }  # fmt: skip
    assert expected <= {p.relative_to(folder).as_posix() for p in folder.rglob("*")}
    assert [p.name for p in (files / "worlds").iterdir()] == ["good"]


def test_build_spares_a_folder_that_is_not_its_own(files: Path) -> None:
    other = files / "worlds" / "good"
    other.mkdir(parents=True)
    (other / "thesis.tex").write_text("years of work")
    done = started("build", "good.png", "-o", "worlds", cwd=files)
    assert done.returncode == 2
    assert (other / "thesis.tex").read_text() == "years of work"


@pytest.mark.slow
def test_view_draws_any_source_beside_it(files: Path) -> None:
    before = (files / "good.png").read_bytes()
    done = started("view", "good.png", cwd=files)
    assert done.returncode == 0, done.stderr
    assert cv2.imread(str(files / "good-view.png")) is not None
    assert (files / "good.png").read_bytes() == before


def test_no_command_shows_the_help_and_nothing_else(tmp_path: Path) -> None:
    done = started(cwd=tmp_path)
    assert done.returncode == 2
    assert "Usage" in done.stdout + done.stderr
    assert "lirs-wct:" not in done.stderr


def test_the_version_is_shown(tmp_path: Path) -> None:
    said = started("--version", cwd=tmp_path)
    assert (said.returncode, said.stderr) == (0, "")
    assert said.stdout == f"lirs-wct {importlib.metadata.version('lirs-wct')}\n"
