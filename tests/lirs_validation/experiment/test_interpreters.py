"""A mapper's process with another interpreter."""

import json
import os
import sys
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from lirs_validation import RunConfig
from lirs_validation.experiment import loading
from lirs_validation.experiment.loading import interpreter_of
from lirs_validation.experiment.mapper_under_test import MapperProcess, SensorReadings, package_versions
from lirs_validation.record.run_record import code
from lirs_wct.errors import ConfigError, MapperError
from lirs_wct.geometry import ImuReadings, LaserScan, PointCloud, Pose2, Pose3

FAKE = """
import json, os, signal, sys
import numpy as np
class LIO:
    def __init__(self, config): self.given, self.time = [], 0
    def add_imu_measurement(self, acceleration, angular_velocity, time):
        self.given.append((time, *acceleration, *angular_velocity))
    def register_scan(self, scan, timestamps, extrinsic):
        self.time = int(timestamps.max())
        with open({told!r}, "a") as file:
            row = len(self.given), scan.shape, int(timestamps.min()), self.time, extrinsic.tolist()
            print(json.dumps(row), file=file)
        if {dies!r} and self.time > 1.3e9:
            print("what():  map is empty", file=sys.stderr, flush=True)
            os.kill(os.getpid(), signal.SIGSEGV)
    def pose(self):
        pose = np.eye(4)
        pose[0, 3] = self.time * 1e-9
        print("noise", flush=True)
        return pose
"""


def fake_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, dies: bool = False) -> Path:
    """Write an interpreter `python` with a fake RKO-LIO; return the file with its scans."""
    monkeypatch.setattr("slam_baselines.mapper.find_spec", lambda package: None)
    package, told = tmp_path / "packages" / "rko_lio", tmp_path / "told"
    package.mkdir(parents=True)
    (package / "__init__.py").touch()
    (package / "lio.py").write_text(FAKE.format(told=str(told), dies=dies))
    (package / "config.py").write_text("class LIOConfig:\n    def __init__(self, **fields): pass\n")
    metadata = package.with_name("rko_lio-0.4.7.dist-info")
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: rko_lio\nVersion: 0.4.7\n")
    python = tmp_path / "python"
    path = os.pathsep.join([str(package.parent), *filter(None, sys.path)])
    python.write_text(f'#!/bin/sh\nPYTHONPATH={path} exec {sys.executable} "$@"\n')
    python.chmod(0o755)
    return told


def sweep(stamp: float) -> SensorReadings:
    xyz, times = np.ones((2, 3), np.float32), np.array([0.0, 0.0999], np.float32)
    mount = Pose3(0.1, 0.0, 0.3)
    cloud = PointCloud(xyz, np.zeros(2, np.uint16), times, stamp, mount)
    stamps = stamp + 0.005 * np.arange(-19, 1) if stamp else np.empty(0)
    inertial = ImuReadings(stamps, np.zeros((len(stamps), 3)), np.ones((len(stamps), 3)))
    return SensorReadings(cloud=cloud, inertial=inertial)


def answers(mapper: MapperProcess, sweeps: int) -> list[Pose2 | Pose3]:
    return [mapper.observe(sweep(round(0.1 * k, 9))).pose for k in range(sweeps)]


def test_a_system_runs_in_a_given_interpreter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told = fake_environment(tmp_path, monkeypatch)
    python = str(tmp_path / "python")
    assert package_versions("rko-lio", python) == {"rko-lio": "0.4.7"}
    config = RunConfig(source="medium", mapper="rko-lio", lidar="vlp16", mapper_python=python)
    with closing(MapperProcess(config)) as mapper:
        assert (mapper.reads_clouds, mapper.reads_inertial) == (True, True)
        poses = answers(mapper, 12)
        trajectory = mapper.trajectory()
    assert [row[:4] for row in map(json.loads, told.read_text().splitlines())][:2] == [
        [20, [2, 3], 1_000_000_000, 1_099_900_000],
        [40, [2, 3], 1_100_000_000, 1_199_900_000],
    ]
    extrinsic = np.array(json.loads(told.read_text().splitlines()[0])[4])
    np.testing.assert_array_equal(extrinsic[:3, 3], (0.1, 0.0, 0.3))
    # The fake moves at 1 m/s, and the first pose after the initial one is the map frame, at .2 s.
    np.testing.assert_allclose(trajectory.positions[3:, 0], 0.1 * np.arange(3, 12) - 0.1999, atol=1e-6)
    assert poses[11].x == pytest.approx(0.9001, abs=1e-6)


def test_a_system_that_crashes_is_told_with_its_last_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    fake_environment(tmp_path, monkeypatch, dies=True)
    python = str(tmp_path / "python")
    config = RunConfig(source="medium", mapper="rko-lio", lidar="vlp16", mapper_python=python)
    with closing(MapperProcess(config)) as mapper, pytest.raises(MapperError) as raised:
        answers(mapper, 12)
    message = "mapper 'rko-lio': its process ended (signal SIGSEGV): what():  map is empty"
    assert str(raised.value) == message
    assert "noise" not in capfd.readouterr().out


def test_your_own_mapper_runs_in_a_given_interpreter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    python = tmp_path / "python"
    path = os.pathsep.join(filter(None, sys.path))
    python.write_text(f'#!/bin/sh\nOTHER=yes PYTHONPATH={path} exec {sys.executable} "$@"\n')
    python.chmod(0o755)
    (tmp_path / "own_elsewhere.py").write_text(
        "import os\nfrom slam_baselines.hector import HectorMapper\n"
        "class Own(HectorMapper):\n    def process(self, *reading):\n"
        "        pose = super().process(*reading)\n"
        "        self.lost = os.environ.get('OTHER') == 'yes'\n        return pose\n"
    )
    monkeypatch.chdir(tmp_path)
    config = RunConfig(source="medium", mapper="own_elsewhere:Own", mapper_python=str(python))
    with closing(MapperProcess(config)) as mapper:
        scan = LaserScan(np.ones(9, np.float32), -0.4, 0.1, 0.1, 9.0, 0.0)
        assert mapper.observe(SensorReadings(scan, Pose2())).lost


@pytest.mark.parametrize(
    ("program", "message"),
    [
        (None, "no such program; --mapper-python takes a Python interpreter"),
        ("exit 3", "cannot import lirs_validation: install lirs-wct there"),
        (f'exec {sys.executable} -I -S "$@"', "cannot import lirs_validation: install lirs-wct there"),
    ],
)
def test_an_interpreter_that_cannot_be_used_is_refused_in_a_line(
    program: str | None, message: str, tmp_path: Path
) -> None:
    python = tmp_path / "python"
    if program is not None:
        python.write_text(f"#!/bin/sh\n{program}\n")
        python.chmod(0o755)
    with pytest.raises(ConfigError) as raised:
        interpreter_of("own_slam:Own", str(python))
    assert str(raised.value) == f"{python}: {message}"


def test_a_given_interpreter_must_hold_the_systems_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loading, "versions_there", lambda python, package: (code(), ""))
    with pytest.raises(ConfigError, match=f"^{sys.executable}: has no package rko-lio, which rko-lio needs$"):
        interpreter_of("rko-lio", sys.executable)
    assert interpreter_of("own_slam:Own", sys.executable) == sys.executable


def test_an_interpreter_with_other_code_of_ours_is_refused(tmp_path: Path) -> None:
    """A mapper ran with it, and the record held this one's code."""
    python = tmp_path / "python"
    changed = "import lirs_validation.record.run_record as r; r.OWN_PACKAGES = r.OWN_PACKAGES[1:]"
    path = os.pathsep.join([str(tmp_path), *filter(None, sys.path)])
    (tmp_path / "sitecustomize.py").write_text(changed)
    python.write_text(f'#!/bin/sh\nPYTHONPATH={path} exec {sys.executable} "$@"\n')
    python.chmod(0o755)
    wanted = f"^{python}: lirs-wct must have code {code()}, got [0-9a-f]{{8}}; install this one there$"
    with pytest.raises(ConfigError, match=wanted):
        interpreter_of("own_slam:Own", str(python))
