"""Every program under examples/ runs on the inputs that ship, as a newcomer would run it."""

import os
import runpy
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from lirs_validation import read_record

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples"
RUN_BELOW = {
    "build_a_world",
    "drive_with_gymnasium",
    "map_a_log",
    "train_pretrained",
    "validate_slam",
    "wrong_roll",
    "your_own_mapper",
}
RUN_ELSEWHERE = {"live_driver", "flat_robots"}
"""In tests/lirs_extensions/live/test_network.py, and by train_pretrained."""


def run(name: str, *arguments: str | Path, cwd: Path) -> str:
    path = os.pathsep.join((str(ROOT), str(ROOT / "envs"), os.environ.get("PYTHONPATH", "")))
    done = subprocess.run(
        [sys.executable, EXAMPLES / f"{name}.py", *arguments],
        cwd=cwd, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_none_is_forgotten() -> None:
    assert {path.stem for path in EXAMPLES.glob("*.py")} == RUN_BELOW | RUN_ELSEWHERE | {"make_inputs"}


@pytest.mark.slow
def test_build_a_world(tmp_path: Path) -> None:
    shown = run("build_a_world", "-o", tmp_path, cwd=tmp_path)
    assert "30 x 30 m, 2.50 m high" in shown
    assert "closed: True" in shown
    for name in ("dunes.xml", "model.sdf", "meshes/dunes.dae", "world.json"):
        assert (tmp_path / "dunes" / name).is_file()


@pytest.mark.slow
def test_validate_slam(tmp_path: Path) -> None:
    shown = run("validate_slam", "--seconds", "2", "-o", tmp_path, cwd=tmp_path)
    assert [line.split()[0] for line in shown.splitlines()] == ["hector", "gmapping", "cartographer"]
    assert len([read_record(folder) for folder in tmp_path.iterdir()]) == 3


@pytest.mark.slow
def test_map_a_log(tmp_path: Path) -> None:
    shown = run("map_a_log", "--seconds", "2", "-o", tmp_path, cwd=tmp_path)
    assert "331 scans" in shown
    assert "in the world of that map: ok" in shown


@pytest.mark.slow
def test_drive_with_gymnasium(tmp_path: Path) -> None:
    assert "20 steps" in run("drive_with_gymnasium", "--steps", "20", cwd=tmp_path)
    assert (tmp_path / "scan.png").stat().st_size > 2000


@pytest.mark.slow
def test_your_own_mapper(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from lirs_validation import validate

    monkeypatch.chdir(ROOT)
    run = validate(
        EXAMPLES / "data" / "office.yaml", robot="turtlebot2", seconds=2,
        mapper="examples.your_own_mapper:DeadReckoning", out=tmp_path,
    )  # fmt: skip
    assert run.record.status == "ok"
    assert run.record.trajectory["ate_rmse"] == pytest.approx(run.record.trajectory["odometry_ate_rmse"])


@pytest.mark.slow
def test_wrong_roll_works_on_a_floor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from lirs_validation import validate

    monkeypatch.chdir(ROOT)
    mapper, office = "examples.wrong_roll:WrongRoll", EXAMPLES / "data" / "office.yaml"
    run = validate(office, seconds=30, mapper=mapper, out=tmp_path)
    assert run.verdict.kind == "works"


def test_wrong_roll_is_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    from lirs_wct import Imu
    from slam_baselines.hector import HectorMapper

    monkeypatch.syspath_prepend(str(ROOT))
    from examples.wrong_roll import WrongRoll

    seen: list[Imu] = []
    monkeypatch.setattr(HectorMapper, "update", lambda self, scan, odometry, imu: seen.append(imu))
    WrongRoll().update(None, None, Imu(roll=0.1, pitch=0.2))
    assert (seen[0].roll, seen[0].pitch) == (-0.1, 0.2)


def test_only_ground_varies_hills_and_slope() -> None:
    from lirs_extensions.search.falsify.search import read_search_limits

    limits = read_search_limits(EXAMPLES / "only_ground.yaml")
    varied = {p.name for p in limits.parameters if p.low < p.high}
    assert varied == {"relief", "slope", "slope_direction"}


@pytest.mark.slow
def test_train_pretrained(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A resumed training gives the weights of one in one part, and they drive."""
    pytest.importorskip("torch", reason="torch is not installed (extra [rl])")
    from lirs_envs.pretrained import read_weights

    monkeypatch.syspath_prepend(EXAMPLES)
    example = runpy.run_path(str(EXAMPLES / "train_pretrained.py"))
    example["train"].__globals__.update(SECONDS={}, BATCHES=2, LAST_BATCHES=2, ROUND_SECONDS=2.0)
    for folder, parts in ((tmp_path / "once", (2,)), (tmp_path / "twice", (1, 2))):
        folder.mkdir()
        for rounds in parts:
            example["train"](minutes=5, rounds=rounds, seed=0, folder=folder)
    once, twice = (read_weights(tmp_path / name / "navigation.npz") for name in ("once", "twice"))
    assert all((once[name] == twice[name]).all() for name in once)
    header, *rounds = (tmp_path / "once" / "curve.csv").read_text().splitlines()
    assert header.startswith("round,robot,world,physics,choices")
    assert len(rounds) == 2


@pytest.mark.slow
@pytest.mark.skipif(find_spec("torch") is not None, reason="torch is installed")
def test_train_pretrained_without_torch(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, EXAMPLES / "train_pretrained.py"],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr == "needs torch: pip install 'lirs-wct[rl]'\n"
