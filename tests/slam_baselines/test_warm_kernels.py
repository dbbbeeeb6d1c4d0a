"""After the warm-up no update compiles: every kernel has met the types that it will meet."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from slam_baselines.mapper import MAPPERS, make_mapper, room_pose, room_scan, warm_up

SLOW = ("cartographer_original", "gmapping", "gmapping_original", "hector_original")
KERNELS = """
import sys

def kernels():
    return {
        f"{module}.{name}": set(kernel.signatures)
        for module, held in list(sys.modules.items())
        if module.startswith(("lirs_", "slam_baselines"))
        for name, kernel in vars(held).items() if hasattr(kernel, "py_func")
    }

def show(before):
    after = kernels()
    print(sum(map(bool, after.values())))
    print(*(key for key in after if after[key] != before.get(key)))
"""
UPDATES = """
import numpy as np
from lirs_wct.geometry.pose import Pose2
from lirs_wct.geometry.scan import Imu
from slam_baselines.mapper import make_mapper, warm_up
from tests.slam_baselines.cartographer.corridor import corridor_scan, ring
from tests.slam_baselines.synthetic import loop, room_scan

name = sys.argv[1]
warm_up(name)
before, rng = kernels(), np.random.default_rng(0)
sparse, dense = (corridor_scan, ring(0.5, 0.8), 0.0), (corridor_scan, ring(1.3), 0.0)
for see, poses, tilt in (sparse, dense, (room_scan, loop(150), 0.05)):
    mapper = make_mapper(name)
    for i, pose in enumerate(poses):
        slipped = poses[0].inverse() @ pose @ Pose2(0.6 if i > 60 else 0.0, 0.3 if i > 60 else 0.0, 0.002 * i)
        imu = Imu(roll=tilt * np.sin(i / 9), pitch=tilt, stamp=0.2 * i) if tilt else None
        mapper.update(see(pose, 0.2 * i, rng), slipped, imu)
show(before)
"""
DRIVE = """
from lirs_validation.config import RunConfig
from lirs_validation.experiment.run import prepare

lidar = {"lidar": "vlp16"} if sys.argv[1] == "wheel_lio" else {}
ready = prepare(RunConfig(source="medium", mapper=sys.argv[1], seconds=4, **lidar))
before, log = kernels(), ready.log()
for _ in ready.drive(log):
    pass
show(before)
"""


def compiled(program: str, name: str) -> str:
    """Return the kernels that a program compiles after the warm-up of a mapper."""
    root = Path(__file__).parents[2]
    path = os.pathsep.join((str(root), str(root / "envs"), os.environ.get("PYTHONPATH", "")))
    done = subprocess.run(
        [sys.executable, "-c", KERNELS + program, name], cwd=root, capture_output=True, text=True,
        env=os.environ | {"PYTHONPATH": path}, timeout=600,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    count, names = done.stdout.splitlines()[:2]
    assert int(count) > 1
    return names


@pytest.mark.slow
@pytest.mark.parametrize("name", MAPPERS)
def test_no_update_compiles_after_the_warm_up(name: str) -> None:
    assert compiled(UPDATES, name) == ""


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hector", "wheel_lio"])
def test_no_drive_compiles_after_its_warm_up(name: str) -> None:
    """The time of its first seconds predicts when a drive ends."""
    assert compiled(DRIVE, name) == ""


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name in SLOW else name for name in MAPPERS]
)
def test_every_mapper_keeps_its_place_in_the_warm_up_room(name: str) -> None:
    mapper = make_mapper(name)
    start = room_pose(0.0)
    for k in range(40):
        pose = room_pose(0.055 * k)
        found = mapper.update(room_scan(pose, 0.2 * k), start.inverse() @ pose, None)
    # The original drops the first odometry and turns one scan late: a start at full speed displaces it.
    assert found.distance(start.inverse() @ pose) < (0.4 if name == "cartographer_original" else 0.1)
    warm_up(name)
