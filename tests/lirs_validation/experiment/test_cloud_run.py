"""Runs of mappers that read point clouds, ours or anybody's, from the drive to the report."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lirs_validation import Run, validate
from lirs_validation.config import RunConfig
from lirs_validation.experiment.mapper_under_test import (
    LocalMapper,
    SensorReadings,
    mapper_named,
    package_versions,
)
from lirs_validation.metrics.elevation import MAX_CLOUDS, CloudSample, read_elevation
from lirs_validation.record.run_record import damaged_files, read_record, schema_error
from lirs_validation.sweep.tasks import RunTask
from lirs_wct.errors import ConfigError, MapperError
from lirs_wct.formats.drive_files import read_tum
from lirs_wct.geometry.pose import Pose2, Pose3, Trajectory
from lirs_wct.geometry.scan import Imu, PointCloud
from slam_baselines.mapper import CLOUD_MAPPERS, MapperStats

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Mappers of your own in this process, which is theirs sooner."""
    monkeypatch.syspath_prepend(Path(__file__).parent)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("lirs_validation.experiment.mapper_under_test.needs_process", lambda mapper: False)


@pytest.fixture(scope="module")
def still(hills: dict[str, Any], tmp_path_factory: pytest.TempPathFactory, plain_pictures: None) -> Run:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(Path(__file__).parent)
        patch.setattr("lirs_validation.experiment.mapper_under_test.needs_process", lambda mapper: False)
        out = tmp_path_factory.mktemp("out")
        return validate(**hills, mapper="own_mappers:Still", lidar="vlp16", seconds=3, out=out)


def test_the_figures_are_those_of_a_mapper_that_stands_still(still: Run) -> None:
    record, log = still.record, still.log
    assert (record.status, record.reason) == ("ok", "")
    truth = read_tum(still.folder / "truth.tum")  # type: ignore[operator]
    estimate = read_tum(still.folder / "estimate.tum")  # type: ignore[operator]
    start = log.truth[0]
    rises = (start @ Pose3(0, 0, 0.01 * (len(estimate) - 1))).position
    np.testing.assert_allclose(estimate.positions[-1], rises, atol=1e-5)
    gone = np.linalg.norm(truth.positions - estimate.positions, axis=1)
    unaligned = record.trajectory["ate_rmse_3d_unaligned"]
    assert unaligned == pytest.approx(math.sqrt((gone**2).mean()), rel=1e-3)
    assert record.trajectory["ate_rmse_3d"] < unaligned
    flat = truth.xy - start.position[:2]
    expected = estimate.xy - start.position[:2]
    raw = np.linalg.norm(flat - expected, axis=1)
    assert record.trajectory["ate_rmse_unaligned"] == pytest.approx(math.sqrt((raw**2).mean()), rel=1e-3)
    assert record.trajectory["length"] > 1.0


def test_a_mapper_gets_all_inertial_readings_on_request(hills: dict[str, Any]) -> None:
    log = validate(**hills, mapper="own_mappers:Gyro", lidar="vlp16", seconds=4, stand=0.0).log
    yaw = np.unwrap([pose.to_pose2().yaw for pose in log.truth])
    assert np.ptp(yaw) > 0.3
    turned = np.unwrap([pose.to_pose2().yaw for pose in log.estimates])
    np.testing.assert_allclose(turned, yaw - yaw[0], atol=0.03)
    mapper = LocalMapper(mapper_named("own_mappers:Gyro", 1), "own_mappers:Gyro")
    cloud = PointCloud(np.zeros((1, 3), np.float32), np.zeros(1, np.uint16), np.zeros(1, np.float32), 0.0)
    with pytest.raises(ConfigError, match="needs inertial readings near 200 Hz"):
        mapper.observe(SensorReadings(cloud=cloud))


def test_a_mapper_gets_the_odometry_on_request(room: str) -> None:
    run = validate(room, mapper="own_mappers:Wheels", lidar="vlp16", seconds=3)
    found = np.array([pose.to_pose2().as_array() for pose in run.log.estimates])
    given = [observation.odometry.as_array() for observation in run.log.observations]
    np.testing.assert_allclose(found, given, atol=1e-9)
    errors = run.record.trajectory
    assert errors["length"] > 1.0
    # Without attitude, the height of the odometry is that of the first pose.
    assert 0.0 < errors["odometry_ate_rmse_3d"] <= errors["ate_rmse_3d"] + 0.01


def test_elevation_stands_in_the_place_of_an_occupancy_map(still: Run) -> None:
    scores = still.record.map
    assert still.maps.built is None
    assert scores["f1"] is scores["false_occupied"] is scores["occupied_cells"] is None
    assert scores["reference_elevation_rmse"] < 0.1
    assert scores["elevation_rmse"] > scores["reference_elevation_rmse"] + 0.05
    assert 0.3 < scores["elevation_seen"] < 1.0
    assert len(still.log.clouds.clouds) == 4, "one a second"
    assert all(observation.cloud is None for observation in still.log.observations)


def test_the_folder_holds_what_there_is(still: Run) -> None:
    assert still.folder is not None
    names = {path.name for path in still.folder.iterdir()}
    assert "elevation.npz" in names
    assert not {"map.pgm", "map.yaml"} & names
    entry = read_record(still.folder)
    assert schema_error(entry) is None
    assert damaged_files(still.folder, "record.json") == []
    built, true_pose = read_elevation(still.folder / "elevation.npz")
    assert built.mean.shape == true_pose.mean.shape
    (still.folder / "elevation.npz").rename(still.folder / "kept")
    try:
        assert damaged_files(still.folder, "record.json") == ["elevation.npz"]
    finally:
        (still.folder / "kept").rename(still.folder / "elevation.npz")


def test_a_run_by_another_version_of_the_mapper_is_run_again(
    still: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert still.folder is not None
    experiment, out = RunTask(still.record.config), still.folder.parent
    assert experiment.find_outcome(out) is not None
    monkeypatch.setattr("lirs_validation.sweep.tasks.package_versions", lambda *_: {"kiss-icp": "0.0.1"})
    assert experiment.find_outcome(out) is None
    assert package_versions("hector") == package_versions("own_mappers:Still") == {}
    if CLOUD_MAPPERS["kiss-icp"].installed:
        assert list(package_versions("kiss-icp")) == ["kiss-icp"]


def test_a_planar_mapper_maps_the_ring_nearest_the_horizon(room: str) -> None:
    run = validate(room, mapper="hector", lidar="vlp16", seconds=2)
    assert run.log.clouds.clouds == []
    assert len(run.log.observations[0].scan.ranges) == 1800
    assert "ate_rmse_3d" not in run.record.trajectory
    assert run.record.trajectory["ate_rmse"] < 0.2


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {},
            r"mapper own_mappers:Still needs a lidar with rings, got lms111; legal: --lidar vlp16 or os1_32",
        ),
        ({"lidar": "utm30lx"}, r"needs a lidar with rings, got utm30lx"),
        (
            {"lidar": "vlp16", "driver": "frontier"},
            r"driver frontier plans on the mapper's occupancy map, and own_mappers:Still has none; legal: t",
        ),
        (
            {"lidar": "vlp16", "mapper": "own_mappers:Half"},
            r"lacks trajectory\(\), stats, lost; a mapper has update",
        ),
    ],
)
def test_what_cannot_work_is_refused_before_the_world_is_built(change: dict[str, Any], message: str) -> None:
    config = replace(RunConfig(source="medium", mapper="own_mappers:Still"), **change)
    with pytest.raises(ConfigError, match=message) as error:
        RunTask(config).check()
    assert "\n" not in str(error.value)


def test_without_attitude_there_is_no_inertial_reading() -> None:
    readings = []
    for attitude in ("imu", "none"):
        mapper = mapper_named("own_mappers:Still", 1)
        guarded = LocalMapper(mapper, "still", attitude)  # type: ignore[arg-type]
        guarded.observe(SensorReadings(imu=Imu(stamp=1.0), cloud=a_cloud()))
        readings += mapper.imus  # type: ignore[union-attr]
    assert readings == [Imu(stamp=1.0), None]


def a_cloud() -> PointCloud:
    return PointCloud(np.ones((4, 3), np.float32), np.zeros(4, np.uint16), np.zeros(4, np.float32), 1.24)


class Wrong:
    reads_clouds, lost, stats = True, False, MapperStats()

    def __init__(self, answer: Any) -> None:
        self.answer = answer

    def update(self, cloud: PointCloud, imu: Imu | None) -> Any:
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer

    def trajectory(self) -> Any:
        return Trajectory.from_poses([0.0], [Pose3(math.nan)])


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (Pose2(), r"must return a Pose3, got Pose2 for the scan at 1\.240 s"),
        (Pose3(z=math.inf), r"must return a finite pose, got Pose3.*inf.* for the scan at 1\.240 s"),
        (ValueError("no"), r"mapper 'wrong': update\(\) failed for the scan at 1\.240 s: ValueError: no"),
    ],
)
def test_a_wrong_answer_costs_the_run_and_names_the_scan(answer: Any, message: str) -> None:
    with pytest.raises(MapperError, match=message):
        LocalMapper(Wrong(answer), "wrong").observe(SensorReadings(imu=Imu(), cloud=a_cloud()))
    with pytest.raises(MapperError, match=r"trajectory\(\) is not finite"):
        LocalMapper(Wrong(None), "wrong").trajectory()


def cloud(stamp: float, n: int = 3) -> PointCloud:
    xyz = np.arange(3 * n, dtype=np.float32).reshape(n, 3)
    return PointCloud(xyz, np.arange(n, dtype=np.uint16), np.zeros(n, np.float32), stamp)


@pytest.mark.parametrize("seconds", [0.0, 5.0, 120.0, 1000.0, 3600.0])
def test_however_long_the_drive_the_sample_is_spread_over_it(seconds: float) -> None:
    sample = CloudSample()
    for k in range(round(10 * seconds) + 1):
        sample.offer(k, cloud(k / 10))
    stamps = np.array([c.stamp for c in sample.clouds])
    assert 1 <= len(stamps) <= MAX_CLOUDS
    assert stamps[0] == 0
    assert seconds - stamps[-1] <= sample.period
    np.testing.assert_allclose(np.diff(stamps), sample.period, atol=1e-6)
    np.testing.assert_allclose(np.array(sample.scans) / 10, stamps, atol=1e-6)
    assert len(stamps) > min(seconds, MAX_CLOUDS / 2 - 1)


def test_points_on_walkers_are_left_out() -> None:
    sample = CloudSample()
    sample.offer(0, cloud(0.0), np.array([False, True, False]))
    assert sample.clouds[0].ring.tolist() == [0, 2]
    assert sample.clouds[0].xyz.tolist() == [[0, 1, 2], [6, 7, 8]]
