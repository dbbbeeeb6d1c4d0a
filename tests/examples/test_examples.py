"""Every program under examples/ runs on the inputs that ship, as a newcomer would run it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from lirs_validation import read_record

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples"
RUN_BELOW = {"build_a_world", "validate_slam", "map_a_log", "drive_with_gymnasium", "your_own_mapper"}


def run(name: str, *arguments: str | Path, cwd: Path) -> str:
    path = os.pathsep.join((str(ROOT), str(ROOT / "envs"), os.environ.get("PYTHONPATH", "")))
    done = subprocess.run(
        [sys.executable, EXAMPLES / f"{name}.py", *arguments],
        cwd=cwd, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_none_is_forgotten() -> None:
    assert {path.stem for path in EXAMPLES.glob("*.py")} == RUN_BELOW | {"make_inputs"}


def test_build_a_world(tmp_path: Path) -> None:
    shown = run("build_a_world", "-o", tmp_path, cwd=tmp_path)
    assert "30 x 30 m, 2.50 m high" in shown
    assert "closed: True" in shown
    for name in ("dunes.xml", "model.sdf", "meshes/dunes.dae", "world.json"):
        assert (tmp_path / "dunes" / name).is_file()


def test_validate_slam(tmp_path: Path) -> None:
    shown = run("validate_slam", "--seconds", "6", "-o", tmp_path, cwd=tmp_path)
    assert [line.split()[0] for line in shown.splitlines()] == ["hector", "gmapping", "cartographer"]
    assert len([read_record(folder) for folder in tmp_path.iterdir()]) == 3


def test_map_a_log(tmp_path: Path) -> None:
    shown = run("map_a_log", "--seconds", "6", "-o", tmp_path, cwd=tmp_path)
    assert "331 scans" in shown
    assert "in the world of that map: ok" in shown


def test_drive_with_gymnasium(tmp_path: Path) -> None:
    assert "20 steps" in run("drive_with_gymnasium", "--steps", "20", cwd=tmp_path)
    assert (tmp_path / "scan.png").stat().st_size > 2000


def test_your_own_mapper(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from lirs_validation import validate

    monkeypatch.chdir(ROOT)
    run = validate(
        EXAMPLES / "data" / "office.yaml", robot="turtlebot2", seconds=6,
        mapper="examples.your_own_mapper:DeadReckoning", out=tmp_path,
    )  # fmt: skip
    assert run.record.status == "ok"
    assert run.record.trajectory["ate_rmse"] == pytest.approx(run.record.trajectory["odometry_ate_rmse"])
