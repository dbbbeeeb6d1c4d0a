"""Commands and programs of README, tutorial and guides work where nothing but the wheel is installed."""

import os
import re
import shlex
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

from lirs_wct.arrays import FloatArray
from tests.pages import PAGES, ROOT, Step, shortened, steps

EXTRAS = "clouds,dem,live,search,slam"
MOST_PACKAGES, MOST_MEGABYTES = 52, 1000
"""Of an installation without extras, pip and setuptools included."""
OTHERS = ("lirs-wct gui", "mujoco.viewer", "--suite paper", "examples/live_driver.py")
"""Parts of commands that need a browser, a screen or many minutes, or that run beside another."""
NEED_TORCH = ("rl_libraries.md",)
HALF_WAY = """
from examples.your_own_mapper import DeadReckoning as Old

class New(Old):
    def update(self, scan, odometry, imu):
        return super().update(scan, type(odometry)(odometry.x / 2, odometry.y / 2, odometry.yaw), imu)
"""

pytestmark = pytest.mark.slow


@dataclass(frozen=True)
class Installation:
    """Environment with the wheel.

    Attributes:
        home: Folder of the environment.
        packages: Number of packages without extras.
        megabytes: Size of the environment without extras.
    """

    home: Path
    packages: int
    megabytes: float

    def start(self, command: str, folder: Path) -> subprocess.Popen[str]:
        """Start a command in a folder, as a shell does in which the environment is activated."""
        shell = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
        shell["PATH"] = f"{self.home / 'bin'}{os.pathsep}{shell['PATH']}"
        program, *arguments = shlex.split(command)
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        return subprocess.Popen([self.home / "bin" / program, *arguments], cwd=folder, env=shell, **pipes)

    def run(self, command: str, folder: Path) -> str:
        """Return what a command prints; only a gate may fail it."""
        process = self.start(command, folder)
        printed, told = process.communicate(timeout=600)
        assert process.returncode in ((0, 4) if "--gate" in command else (0,)), (command, printed, told)
        assert "Traceback" not in told, (command, told)
        return printed


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of the sdist."""
    folder = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "build", "--outdir", folder, ROOT]
    subprocess.run(command, check=True, capture_output=True)
    (wheel,) = folder.glob("*.whl")
    return wheel


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Installation:
    """An environment with the wheel and the extras that the pages name."""
    home = tmp_path_factory.mktemp("installed") / "venv"
    subprocess.run([sys.executable, "-m", "venv", home], check=True)
    pip = [home / "bin" / "pip", "--disable-pip-version-check", "--quiet"]
    subprocess.run([*pip, "install", wheel], check=True)
    listed = subprocess.run([*pip, "list", "--format=freeze"], check=True, capture_output=True, text=True)
    size = sum(path.stat().st_size for path in home.rglob("*") if path.is_file() and not path.is_symlink())
    subprocess.run([*pip, "install", f"{wheel}[{EXTRAS}]"], check=True)
    return Installation(home, len(listed.stdout.splitlines()), size / 1e6)


@pytest.fixture(scope="module")
def inputs(installed: Installation, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with files of the names that the pages use."""
    folder = tmp_path_factory.mktemp("inputs")
    installed.run("lirs-wct examples", folder)
    write_files(folder)
    installed.run("lirs-wct validate simple --mapper hector --seconds 15 -o out", folder)
    (run,) = (path.parent for path in (folder / "out").glob("*/record.json"))
    shutil.copy(run / "estimate.tum", folder / "est.tum")
    for name in ("a", "b"):
        shutil.copytree(run, folder / "out" / name)
    run.rename(folder / "out" / "RUN")
    installed.run("lirs-wct record medium --seconds 4 -o robot_bag", folder)
    for name in ("run", "slam"):
        shutil.copytree(folder / "robot_bag", folder / name)
    installed.run("lirs-wct map robot.clf.gz -o mapped", folder)
    (path,) = (folder / "mapped").glob("*/estimate.tum")
    shutil.copy(path, folder / "truth.tum")
    first, *_, last = np.loadtxt(folder / "truth.tum")
    (folder / "robot.relations").write_text(f"{first[0]:.6f} {last[0]:.6f} 1 0 0 0 0 0\n")
    installed.run(
        "lirs-wct falsify --mapper my_mapper:New --seconds 16 --drives 20 --cases 1 -o failures", folder
    )
    installed.run("lirs-wct falsify --policy straight --drives 20 --cases 1 -o goals", folder)
    shutil.copy(folder / "goals" / "cases.json", folder / "failures")
    return folder


def write_files(folder: Path) -> None:
    """Write pictures, maps, clouds, a log, modules and options."""
    data = folder / "examples" / "data"
    for name in ("volcano.png", "orthophoto.jpg", "grass.png", "ramp.png"):
        cv2.imwrite(str(folder / name), cv2.imread(str(data / "dunes.png"), cv2.IMREAD_UNCHANGED))
    cv2.imwrite(str(folder / "floor.png"), cv2.imread(str(data / "office.pgm"), cv2.IMREAD_UNCHANGED))
    (folder / "maps").mkdir()
    for name in ("map.yaml", "office.yaml", "maps/office.yaml"):
        shutil.copy(data / "office.yaml", folder / name)
        shutil.copy(data / "office.pgm", (folder / name).parent)
    shutil.copy(data / "office.clf.gz", folder / "robot.clf.gz")
    (folder / "my_slam.py").write_text("from examples.your_own_mapper import DeadReckoning as MySlam\n")
    (folder / "my_mapper.py").write_text(HALF_WAY)
    (folder / "my_policy.py").write_text("from lirs_envs.policies import GoToGoal as MyPolicy\n")
    (folder / "slam_limits.yaml").write_text("accept: [path only]\n")
    (folder / "points.csv").write_text("1, 0\n2, 1\n")
    write_clouds(folder)


def write_clouds(folder: Path) -> None:
    """Write `survey.laz` and `slam_map.pcd`."""
    import laspy
    import pypcd4

    las = laspy.create(point_format=6, file_version="1.4")
    las.header.scales = (0.001, 0.001, 0.001)
    las.x, las.y, las.z = hills(60, 0.5).T
    las.write(folder / "survey.laz")
    pypcd4.PointCloud.from_xyz_points(hills(10, 0.1).astype(np.float32)).save(folder / "slam_map.pcd")


def hills(reach: float, spacing: float) -> FloatArray:
    """Return points (n, 3) over x and y from -reach to reach, meters."""
    x, y = (axis.ravel() for axis in np.mgrid[-reach:reach:spacing, -reach:reach:spacing])
    return np.column_stack((x, y, np.sin(x / 9) * np.cos(y / 7)))


def test_the_base_installation_is_small(installed: Installation, wheel: Path) -> None:
    assert installed.packages <= MOST_PACKAGES
    assert installed.megabytes <= MOST_MEGABYTES
    assert wheel.stat().st_size < 3e6


def steps_of(page: Path) -> list[Step]:
    """Return the steps of a page that can run; of the README those that no other page has."""
    others = PAGES if page.stem == "README" else []
    elsewhere = {step.text for other in others if other != page for step in steps(other)}
    return [
        step
        for step in steps(page)
        if step.text not in elsewhere and not any(part in step.text for part in OTHERS)
    ]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_commands_and_programs_of_a_page_run_in_their_order(
    page: Path, installed: Installation, inputs: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "home"
    shutil.copytree(inputs, folder)
    programs: list[str] = []
    for step in () if page.name in NEED_TORCH else steps_of(page):
        if step.program:
            programs.append(re.sub(r"seconds=\d+", "seconds=1", step.text))
            (folder / "program.py").write_text("\n".join(programs))
            installed.run("python program.py", folder)
        else:
            run_command(installed, step.text, folder)


def run_command(installed: Installation, command: str, folder: Path) -> None:
    """Run the short form of a command of a page; a driver answers `live --lockstep`."""
    if "NAME" in command:
        (twin,) = (folder / "out").glob("*-twin")
        command = command.replace("NAME-twin", twin.name)
    if command.startswith("lirs-wct record"):
        shutil.rmtree(folder / "run", ignore_errors=True)  # it holds another drive
    driver = installed.start("python examples/live_driver.py", folder) if "--lockstep" in command else None
    try:
        installed.run(shortened(command), folder)
    finally:
        if driver is not None:
            driver.kill()
            driver.wait()
