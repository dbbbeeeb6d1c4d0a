"""`lirs-wct robot`: data, picture, URDF."""

from pathlib import Path
from xml.etree import ElementTree

import cv2
import mujoco
import pytest
from rich.console import Console

from lirs_envs.robots.robot import ROBOTS
from lirs_envs.robots.urdf import robot_urdf
from lirs_validation.cli.commands import robot_card
from tests.command_line import run_command


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


def test_the_card_and_the_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / "husky.png"
    assert run_command("robot", "husky", "-o", str(target)) == 0
    shown = capsys.readouterr().out
    assert "56.58 kg" in shown
    assert "lms111" in shown
    picture = cv2.imread(str(target))
    assert picture.shape[0] >= 400
    assert picture.std() > 10, "there is something on it"


def test_without_opengl_there_is_an_outline(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def none(*_: object) -> None:
        raise RuntimeError("no OpenGL")

    monkeypatch.setattr(robot_card, "_render", none)
    for name in ("husky", "quadrotor"):
        target = tmp_path / f"{name}.png"
        robot_card.draw(ROBOTS[name], target)
        assert cv2.imread(str(target)).std() > 10


def test_every_card_can_be_drawn() -> None:
    for robot in ROBOTS.values():
        console = Console(record=True, width=100, file=open("/dev/null", "w"))  # noqa: PTH123, SIM115
        console.print(robot_card.card(robot))
        assert robot.name in console.export_text()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("huksy",), "unknown robot 'huksy'; legal: husky, jackal, quadrotor"),
        (("husky", "--to", "sdf"), "unknown format for a robot 'sdf'; legal: urdf"),
    ],
)
def test_names_that_are_none(
    arguments: tuple[str, ...], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command("robot", *arguments) == 2
    assert words in capsys.readouterr().err.replace("\n", " ")
