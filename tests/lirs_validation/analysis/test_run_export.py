"""Finished runs in other programs' formats."""

from pathlib import Path

import numpy as np
import pytest

from lirs_validation.analysis.export import export_run, recorded_drive
from lirs_validation.analysis.results import RunFolder, read_results
from lirs_wct.errors import ConfigError
from lirs_wct.formats.drive_files import read_tum


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


def test_the_log_is_the_recorded_one(run: RunFolder, tmp_path: Path) -> None:
    (path,) = export_run(run, tmp_path, ("carmen",))
    assert path.read_bytes() == (run.folder / "scans.clf.gz").read_bytes()


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
