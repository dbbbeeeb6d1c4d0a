"""`lirs-wct list`, `doctor` and `export ROBOT`: names and their data, the installation, URDF."""

import importlib.metadata
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import pytest

from lirs_envs.lidar.presets import LIDARS
from lirs_envs.robots.robot import ROBOTS
from lirs_envs.robots.urdf import robot_urdf
from lirs_validation.cli.commands import installation as doctor
from lirs_wct.sources.bundled import RECIPES
from slam_baselines.mapper import ALL_CLOUD_MAPPERS, MAPPERS
from tests.command_line import run_command

NAMES = {"mappers": {*MAPPERS, *ALL_CLOUD_MAPPERS}, "robots": ROBOTS, "lidars": LIDARS, "worlds": RECIPES}


@pytest.mark.parametrize("kind", sorted(NAMES))
def test_every_name_is_listed_and_has_data(
    kind: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("lirs_validation.cli.commands.installation.out._width", 200)
    assert run_command("list", kind) == 0
    words = {line.split()[0] for line in capsys.readouterr().out.splitlines() if line.strip()}
    assert set(NAMES[kind]) <= words
    for name in NAMES[kind]:
        assert run_command("list", kind, name) == 0
        assert name in capsys.readouterr().out
    assert run_command("list", kind, "nothing") == 2
    assert f"unknown {kind[:-1]} 'nothing'; legal: " in capsys.readouterr().err


def test_a_robot_is_exported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run_command("export", "husky", "--to", "urdf", "-o", "robots") == 0
    assert (tmp_path / "robots" / "husky.urdf").read_text() == robot_urdf(ROBOTS["husky"])
    assert run_command("export", "husky") == 2
    assert "husky: a robot is exported --to urdf, got bag" in capsys.readouterr().err


@pytest.mark.parametrize("name", list(ROBOTS))
def test_the_urdf_is_the_same_robot(name: str, tmp_path: Path) -> None:
    """MuJoCo reads URDF: an oracle for masses, places and joints."""
    robot = ROBOTS[name]
    path = tmp_path / "robot.urdf"
    text = robot_urdf(robot)
    # A free base, all links kept, a mass for those without one.
    extra = '<mujoco><compiler fusestatic="false" discardvisual="false" balanceinertia="true"/></mujoco>'
    path.write_text(text.replace(f'<robot name="{name}">', f'<robot name="{name}">{extra}'))
    ours, theirs = mujoco.MjModel.from_xml_path(str(robot.mjcf)), mujoco.MjModel.from_xml_path(str(path))
    assert theirs.body_mass.sum() == pytest.approx(ours.body_mass.sum(), rel=1e-5)
    assert theirs.njnt == len(robot.left_wheels) + len(robot.right_wheels)
    data, base = mujoco.MjData(theirs), theirs.body("base_link").id
    mujoco.mj_forward(theirs, data)
    assert data.xpos[base][2] == pytest.approx(robot.base_height)
    laser = data.body("laser").xpos - data.xpos[base]
    assert laser == pytest.approx(robot.T_base_laser.position, abs=1e-5)
    for wheel in (*robot.left_wheels, *robot.right_wheels):
        place = data.body(wheel).xpos - data.xpos[base]
        assert place == pytest.approx(ours.body(wheel).pos, abs=1e-5)


def test_frames_are_those_of_ros() -> None:
    root = ElementTree.fromstring(robot_urdf(ROBOTS["husky"]))
    links = {link.get("name") for link in root.iter("link")}
    assert {"base_footprint", "base_link", "laser", "front_left_wheel"} <= links


def test_examples_are_copied_once_and_never_over_changed_files(
    wct: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for _ in range(2):
        code, out, _ = wct("examples")
        assert code == 0
    assert "lirs-wct validate examples/data/office.yaml" in out
    source = Path(__file__).resolve().parents[3] / "examples"
    assert (tmp_path / "examples/data/dunes.png").read_bytes() == (source / "data/dunes.png").read_bytes()
    assert (tmp_path / "examples/your_own_mapper.py").is_file()
    (tmp_path / "examples/data/office.yaml").write_text("mine")
    (tmp_path / "examples/data/dunes.png").unlink()
    code, _, err = wct("examples")
    assert code == 2
    assert err.startswith("lirs-wct: examples/data/office.yaml: differs from the example")
    assert not (tmp_path / "examples/data/dunes.png").exists()


def test_a_place_for_examples_that_cannot_be_written(wct: Any, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    code, _, err = wct("examples", str(tmp_path / "file"))
    assert code == 2
    assert err.count("\n") == 1
    assert str(tmp_path / "file") in err


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """No pictures are drawn: each takes a process."""
    monkeypatch.setattr(doctor, "_draws", lambda backend: backend == "osmesa")


@pytest.mark.usefixtures("quick")
def test_a_whole_installation_is_well(wct: Any) -> None:
    code, out, _ = wct("doctor")
    assert code == 0
    assert f"mujoco │ {importlib.metadata.version('mujoco')}" in " ".join(out.replace("│", " │ ").split())
    assert "missing" not in out
    assert "apt-get install libegl1" in out
    assert "libosmesa6" not in out
    assert "[gui]" in out


@pytest.mark.usefixtures("quick")
def test_what_is_needed_and_missing_fails(wct: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    real = importlib.metadata.version

    def version(package: str) -> str:
        if package in ("numba", "viser"):
            raise importlib.metadata.PackageNotFoundError
        return real(package)

    monkeypatch.setattr(importlib.metadata, "version", version)
    code, out, _ = wct("doctor")
    assert code == 3
    assert "missing" in out
    assert "pip install lirs-wct " in out
    assert "pip install 'lirs-wct[gui]'" in out


@pytest.mark.usefixtures("quick")
def test_caches_that_cannot_be_written_are_said(
    wct: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(blocked / "numba"))
    monkeypatch.setenv("LIRS_WCT_CACHE", str(blocked / "worlds"))
    code, out, _ = wct("doctor")
    assert code == 0
    assert "set NUMBA_CACHE_DIR" in out
    assert "set LIRS_WCT_CACHE" in out
    monkeypatch.setenv("LIRS_WCT_CACHE", "")
    assert "switched off" in wct("doctor")[1]


def test_a_machine_of_a_ray_cluster_needs_mode_and_token(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(doctor, "_version", lambda package: "2.60")
    monkeypatch.setenv("RAY_AUTH_TOKEN_PATH", str(tmp_path / "token"))
    for name in ("RAY_AUTH_MODE", "RAY_AUTH_TOKEN"):
        monkeypatch.delenv(name, raising=False)
    (check,) = doctor._ray_token()
    assert "RAY_AUTH_MODE=(not set), no token" in check.found
    assert "export RAY_AUTH_MODE=token" in check.mend
    assert "ray get-auth-token" in check.mend
    monkeypatch.setenv("RAY_AUTH_MODE", "token")
    (tmp_path / "token").write_text("secret")
    (check,) = doctor._ray_token()
    assert (check.found, check.mend) == ("RAY_AUTH_MODE=token, a token", "")
    monkeypatch.setattr(doctor, "_version", lambda package: None)
    assert not list(doctor._ray_token())


@pytest.mark.render
def test_a_backend_that_draws_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    assert doctor._draws("egl")
    assert not doctor._draws("nothing")
