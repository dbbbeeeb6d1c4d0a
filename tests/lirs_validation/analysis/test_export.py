"""Finished runs in other programs' formats; a data set of evalio, with a fake of its classes."""

import importlib.util
import sys
from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lirs_envs.robots.robot import make_robot
from lirs_validation import Run, validate
from lirs_validation.analysis.export import export_run, recorded_drive
from lirs_validation.analysis.results import RunFolder, read_results, read_run
from lirs_wct.errors import ConfigError
from lirs_wct.formats.drive_files import read_tum
from lirs_wct.geometry import Pose3
from tests.command_line import run_command
from tests.kit import SMALL


@pytest.fixture
def run(sweep_folder: Path) -> RunFolder:
    return read_results(sweep_folder).runs[0]


def test_tables_hold_what_was_recorded(run: RunFolder, tmp_path: Path) -> None:
    assert export_run(run, tmp_path, ("csv", "npz")) == [tmp_path / "csv", tmp_path / "run.npz"]
    truth = read_tum(run.folder / "truth.tum")
    with np.load(tmp_path / "run.npz") as held:
        tables = {name: held[name] for name in held}
    np.testing.assert_array_equal(tables["truth"][:, 1:4], truth.positions)
    assert tables["scans"].shape == (len(truth), 1 + len(tables["beams"]))
    for name, table in tables.items():
        lines = (tmp_path / "csv" / f"{name}.csv").read_text().splitlines()
        assert len(lines[0].split(",")) == np.atleast_2d(table.T).shape[0]
        written = np.loadtxt(lines[1:], delimiter=",")
        np.testing.assert_allclose(written, table, rtol=1e-8, atol=1e-9)


def test_a_bag_begins_at_the_origin_and_knows_the_sensor(run: RunFolder, tmp_path: Path) -> None:
    reader = pytest.importorskip("mcap_ros2.reader", reason="mcap-ros2-support is not installed")
    (folder,) = export_run(run, tmp_path, ("bag",))
    drive = recorded_drive(run)
    found = [m.ros_msg for m in reader.read_ros2_messages(str(folder / "bag.mcap"), topics=["/ground_truth"])]
    assert len(found) == len(drive.ticks)
    assert found[0].pose.position.x == pytest.approx(0, abs=1e-9)
    scan = drive.ticks[0].scan
    assert (len(scan.ranges), scan.range_min, scan.range_max) == (682, 0.02, 5.6)
    assert scan.T_base_laser.z > 0.1


def test_sensors_only_leaves_the_mapper_out(run: RunFolder, tmp_path: Path) -> None:
    reader = pytest.importorskip("mcap_ros2.reader", reason="mcap-ros2-support is not installed")
    (folder,) = export_run(run, tmp_path, ("bag",), slam=False)
    found = list(reader.read_ros2_messages(str(folder / "bag.mcap")))
    assert "/map" not in {m.channel.topic for m in found}
    assert {t.header.frame_id for m in found if m.channel.topic == "/tf" for t in m.ros_msg.transforms} == {
        "odom"
    }


def test_what_cannot_be_exported_is_said(run: RunFolder, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="unknown format 'ply'; legal: bag, carmen, csv, evalio, npz"):
        export_run(run, tmp_path, ("ply",))
    assert not list(tmp_path.iterdir())


OPTIONS = {
    "robot": "jackal",
    "lidar": "vlp16",
    "scan_time": "rolling",
    "seconds": 0.5,
    "bag": "mcap",
    "options": SMALL,
}


@pytest.fixture(scope="module")
def recorded(plain_pictures: None, tmp_path_factory: pytest.TempPathFactory) -> Run:
    return validate("simple", mapper="hector", out=tmp_path_factory.mktemp("runs"), **OPTIONS)


class Made(SimpleNamespace):
    """Keep what a class of evalio is made with."""

    def __init__(self, *given: Any, **named: Any) -> None:
        super().__init__(given=given, **named)

    identity = classmethod(lambda cls: cls("identity"))


class FakeDataset(StrEnum):
    """A data set's members are its sequences."""


@pytest.fixture
def _evalio(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    names = {
        "evalio": {},
        "evalio.datasets": {},
        "evalio.datasets.base": {"Dataset": FakeDataset},
        "evalio.datasets.loaders": {
            "LidarDensity": SimpleNamespace(AllPoints="all"),
            "LidarFormatParams": Made,
            "LidarMajor": SimpleNamespace(Row="row"),
            "LidarPointStamp": SimpleNamespace(Start="start"),
            "LidarStamp": SimpleNamespace(Start="start"),
            "RosbagIter": Made,
        },
        "evalio.types": dict.fromkeys(
            ("SE3", "SO3", "ImuParams", "LidarParams", "Stamp", "Trajectory"), Made
        ),
    }
    for name, content in names.items():
        module = ModuleType(name)
        module.__dict__.update(content)
        monkeypatch.setitem(sys.modules, name, module)
    return


def loaded(path: Path) -> Any:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.usefixtures("_evalio")
def test_the_module_describes_the_run(recorded: Run, tmp_path: Path) -> None:
    assert run_command("export", str(recorded.folder), "--to", "evalio", "-o", str(tmp_path)) == 0
    module = loaded(tmp_path / "evalio" / "lirs_wct_run.py")
    (sequence,) = module.LirsWctRun
    assert sequence.value == recorded.folder.name.lower().replace("-", "_")
    assert sequence.folder == recorded.folder.resolve()
    assert all(path.exists() for path in sequence.files())
    bag, points, inertial, lidar = sequence.data_iter().given
    assert (bag, points, inertial) == (recorded.folder.resolve(), "/points", "/imu/data_raw")
    assert (lidar.num_rows, lidar.num_columns, lidar.rate) == (16, 1800, pytest.approx(10.0))
    rotation, position = sequence.imu_T_lidar().given
    mount = make_robot("jackal").T_base_laser
    np.testing.assert_array_equal(position, mount.position)
    assert (rotation.qw, rotation.qx, rotation.qy, rotation.qz) == tuple(mount.quaternion)
    imu = sequence.imu_params()
    assert imu.rate == 250
    assert imu.gyro == pytest.approx(2.44e-4, rel=0.01)
    assert sequence.imu_T_gt().given == ("identity",)
    assert sequence.quick_len() == 6


@pytest.mark.usefixtures("_evalio")
def test_the_truth_is_that_of_the_bag(recorded: Run, tmp_path: Path) -> None:
    assert run_command("export", str(recorded.folder), "--to", "evalio", "-o", str(tmp_path)) == 0
    (sequence,) = loaded(tmp_path / "evalio" / "lirs_wct_run.py").LirsWctRun
    told = sequence.ground_truth_raw()
    poses = [
        Pose3(*p.given[1], *(getattr(p.given[0], k) for k in ("qw", "qx", "qy", "qz"))) for p in told.poses
    ]
    truth = read_tum(recorded.folder / "truth.tum")
    true = [Pose3.from_arrays(*row) for row in zip(truth.positions, truth.quaternions, strict=True)]
    assert len(poses) == len(true) == 6
    for pose, other in zip(poses, true, strict=True):
        moved, expected = poses[0].inverse() @ pose, true[0].inverse() @ other
        np.testing.assert_allclose(moved.position, expected.position, atol=1e-6)
        np.testing.assert_allclose(moved.rotation, expected.rotation, atol=1e-6)
    stamps = np.array([stamp.sec + 1e-9 * stamp.nsec for stamp in told.stamps])
    np.testing.assert_allclose(np.diff(stamps), np.diff(truth.stamps), atol=1e-6)


def test_a_run_without_clouds_is_refused_in_a_line(
    finished_run: Path, finished_run_copy: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (bag,) = export_run(read_run(finished_run_copy), finished_run_copy / "export", ("bag",))
    for file in bag.iterdir():
        file.rename(finished_run_copy / file.name)
    for folder, message in (
        (finished_run, "holds no bag that can be read; lirs-wct record makes one"),
        (finished_run_copy, "its bag has no /points and no /imu/data_raw: record with a lidar with rings"),
    ):
        assert run_command("export", str(folder), "--to", "evalio") == 2
        assert capfd.readouterr().err.split("lirs-wct: ")[-1] == f"{folder}: {message}\n"
