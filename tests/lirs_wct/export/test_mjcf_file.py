"""Written MJCF holds nothing that an old MuJoCo refuses; `.ci/run` loads it with the oldest."""

import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest

from lirs_wct import BuildOptions, build_world
from lirs_wct.export.mjcf_file import OLDEST_MUJOCO, readable_by_old, write_mjcf
from lirs_wct.geometry.pose import Pose2

ROOT = Path(__file__).parents[3]
LATER = {"colorspace", "sleep", "inertia"}


@pytest.mark.parametrize("source", ["simple", str(ROOT / "examples/data/office.yaml")])
def test_no_attribute_of_a_later_version_is_written(source: str, tmp_path: Path) -> None:
    path = write_mjcf(build_world(source), tmp_path)
    root = ElementTree.parse(path).getroot()
    assert not LATER & {name for element in root.iter() for name in element.attrib}
    assert all("type" not in light.attrib for light in root.iter("light"))
    assert root.find("option") is None
    model = mujoco.MjModel.from_xml_path(str(path))
    assert model.light_type[0] == mujoco.mjtLightType.mjLIGHT_DIRECTIONAL


def test_tiles_of_a_large_mesh_keep_their_inertia() -> None:
    root = ElementTree.fromstring(
        "<mujoco><option timestep='.1'><flag sleep='enable' gravity='disable'/></option>"
        "<asset><mesh inertia='shell'/><mesh inertia='shell'/><mesh/></asset></mujoco>"
    )
    readable_by_old(root)
    assert [mesh.get("inertia") for mesh in root.iter("mesh")] == ["shell", "shell", None]
    option, flag = root.find("option"), root.find("option/flag")
    assert option is not None
    assert flag is not None
    assert (option.attrib, flag.attrib) == ({"timestep": ".1"}, {"gravity": "disable"})


def test_starts_are_sites_on_the_ground_to_which_a_robot_is_attached(tmp_path: Path) -> None:
    start = Pose2(3.0, -4.0, 0.5)
    world = build_world("medium", BuildOptions(start=start))
    model = mujoco.MjModel.from_xml_path(str(write_mjcf(world, tmp_path)))
    assert model.nsite == len(world.spawn_poses) == 8
    site = model.site("start")
    np.testing.assert_allclose(site.pos, (3.0, -4.0, world.surface.height_at(3.0, -4.0)), atol=1e-9)
    np.testing.assert_allclose(site.quat, (np.cos(0.25), 0, 0, np.sin(0.25)), atol=1e-9)


def test_balls_on_the_starts_lie_on_the_ground(tmp_path: Path) -> None:
    path = write_mjcf(build_world(ROOT / "examples/data/office.yaml"), tmp_path)
    command = [sys.executable, str(ROOT / "tests/load_mjcf.py"), str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "8 balls lie on the ground" in done.stdout
    assert f"mujoco=={OLDEST_MUJOCO}" in (ROOT / ".ci/run").read_text(encoding="utf-8")
