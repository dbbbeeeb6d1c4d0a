"""Every program under examples/ runs on the inputs that ship, as a newcomer would run it."""

from __future__ import annotations

import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

from lirs_validation import read_record

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples"
RUN_BELOW = {
    "build_a_world",
    "drive_with_gymnasium",
    "map_a_log",
    "train_navigation",
    "validate_slam",
    "your_own_mapper",
}
RUN_ELSEWHERE = {"live_driver"}
"""Drives a robot in tests/lirs_validation/live/test_network.py."""


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
    shown = run("validate_slam", "--seconds", "6", "-o", tmp_path, cwd=tmp_path)
    assert [line.split()[0] for line in shown.splitlines()] == ["hector", "gmapping", "cartographer"]
    assert len([read_record(folder) for folder in tmp_path.iterdir()]) == 3


@pytest.mark.slow
def test_map_a_log(tmp_path: Path) -> None:
    shown = run("map_a_log", "--seconds", "6", "-o", tmp_path, cwd=tmp_path)
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
        EXAMPLES / "data" / "office.yaml", robot="turtlebot2", seconds=6,
        mapper="examples.your_own_mapper:DeadReckoning", out=tmp_path,
    )  # fmt: skip
    assert run.record.status == "ok"
    assert run.record.trajectory["ate_rmse"] == pytest.approx(run.record.trajectory["odometry_ate_rmse"])


@pytest.mark.slow
def test_train_navigation(tmp_path: Path) -> None:
    """One update of the policy, whose weights then drive."""
    pytest.importorskip("stable_baselines3", reason="Stable-Baselines3 is not installed (extra [rl])")
    from lirs_envs.env import RobotEnv
    from lirs_envs.policies import PolicyContext

    shown = run("train_navigation", "--steps", "1", "-o", tmp_path, cwd=tmp_path)
    assert re.search(r"\d{4} steps in", shown)
    header, *episodes = (tmp_path / "curve.csv").read_text().splitlines()
    assert header == "steps,world,robot,return,seconds,success,collision"
    assert len(episodes) >= 3
    example = runpy.run_path(str(EXAMPLES / "train_navigation.py"))
    office = str(EXAMPLES / "data" / "office.yaml")
    env = RobotEnv("navigation", world=office, observe=example["OBSERVE"], time_limit=0.6)
    policy = example["LearnedPolicy"](PolicyContext.of(env.episodes.config), tmp_path / "policy.zip")
    observation, info = env.reset(seed=0)
    policy.reset(info)
    actions = []
    for _ in range(4):
        actions.append(policy.act(observation))
        assert env.action_space.contains(actions[-1])
        observation, *_ = env.step(actions[-1])
    assert actions[0].tolist() == actions[1].tolist() != actions[2].tolist() == actions[3].tolist()


def test_train_navigation_without_stable_baselines(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    monkeypatch.setattr(sys, "argv", ["train_navigation.py", "-o", str(tmp_path / "out")])
    with pytest.raises(SystemExit) as stopped:
        runpy.run_path(str(EXAMPLES / "train_navigation.py"), run_name="__main__")
    assert stopped.value.code == 2
    assert "needs Stable-Baselines3: pip install '.[rl]'" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
