"""Bags as logs: the same trajectory as from the log of the same run, and every refusal one line."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from lirs_validation import map_log, validate
from lirs_validation.analysis.export import export_run
from lirs_validation.analysis.results import read_run
from lirs_validation.config import MapConfig, RunConfig
from lirs_validation.experiment.run import run as run_config
from lirs_validation.logs.map_log import folder_name, read_log, run_mapping
from lirs_wct.errors import ConfigError, SourceError
from lirs_wct.formats.drive_files import read_tum
from lirs_wct.geometry.pose import Pose3, Trajectory
from lirs_wct.geometry.scan import Imu, ImuReadings, PointCloud
from slam_baselines.mapper import MapperStats
from tests.kit import SMALL

pytestmark = pytest.mark.usefixtures("plain_pictures")


@pytest.fixture(scope="module")
def run(finished_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = shutil.copytree(finished_run, tmp_path_factory.mktemp("out") / finished_run.name)
    export_run(read_run(folder), folder / "export", ("bag",))
    return folder


@pytest.mark.parametrize(
    "mapper", ["hector", *(pytest.param(m, marks=pytest.mark.slow) for m in ("gmapping", "cartographer"))]
)
def test_a_bag_gives_the_trajectory_of_its_log(run: Path, mapper: str) -> None:
    log = map_log(run / "scans.clf.gz", mapper=mapper, imu=run / "imu.csv.gz", second="none")
    config = MapConfig(log=str(run / "export" / "bag"), mapper=mapper, imu_topic="/imu", second="none")
    bag = run_mapping(config)
    assert bag.record.log["inertial_readings"] == len(log.log.scans)
    np.testing.assert_allclose(bag.trajectory.stamps, log.trajectory.stamps, atol=1e-9)
    np.testing.assert_allclose(bag.trajectory.xy, log.trajectory.xy, atol=1e-6)
    np.testing.assert_allclose(bag.trajectory.yaw, log.trajectory.yaw, atol=1e-6)


def test_options_of_the_other_kind_of_log_are_refused(run: Path) -> None:
    with pytest.raises(ConfigError, match="bag: the messages of a bag say their field of view"):
        read_log(MapConfig(log=str(run / "export" / "bag"), fov=180.0))
    with pytest.raises(ConfigError, match=r"scans\.clf\.gz: topics and --time can be given for a ROS bag"):
        read_log(MapConfig(log=str(run / "scans.clf.gz"), scan_topic="/scan"))


def test_the_reference_may_be_a_bag_and_topics_are_arguments(run: Path) -> None:
    bag = run / "export" / "bag"
    mapped = map_log(
        bag,
        mapper="hector",
        second="none",
        scan_topic="/scan",
        imu_topic="/imu",
        reference=f"{bag}:/ground_truth",
    )
    log = {"imu": run / "imu.csv.gz", "reference": run / "truth.tum"}
    own = map_log(run / "scans.clf.gz", mapper="hector", second="none", **log).record.accuracy["reference"]
    assert mapped.record.accuracy["reference"]["ate_rmse"] == pytest.approx(own["ate_rmse"], abs=1e-5)
    with pytest.raises(ConfigError, match=r"truth\.tum: a topic can be given for a ROS bag only"):
        map_log(bag, reference=f"{run}/truth.tum:/ground_truth")


def test_the_name_of_a_map_depends_on_the_bag_alone(run: Path, tmp_path: Path) -> None:
    copy = tmp_path / "bag"
    shutil.copytree(run / "export" / "bag", copy)
    before = folder_name(MapConfig(log=str(copy)))
    (copy / "notes.txt").write_text("mine")
    assert folder_name(MapConfig(log=str(copy))) == before
    (copy / "metadata.yaml").write_text("")
    assert folder_name(MapConfig(log=str(copy))) != before


@pytest.mark.slow
def test_a_recorded_cloud_mapper_gives_the_same_poses_again(tmp_path: Path) -> None:
    pytest.importorskip("kiss_icp", reason="the extra [slam] is not installed")
    cloud = {"lidar": "vlp16", "bag": "mcap", "seconds": 1.0, "options": SMALL}
    made = validate("simple", mapper="kiss-icp", out=tmp_path / "out", **cloud)
    bag = next(made.folder.glob("*.mcap"))
    mapped = map_log(bag, mapper="kiss-icp", out=tmp_path)
    online = read_tum(made.folder / "estimate.tum")
    start = Pose3.from_arrays(online.positions[0], online.quaternions[0]).inverse()
    np.testing.assert_allclose(mapped.trajectory.xy, online.moved(start).xy, atol=1e-6)
    np.testing.assert_allclose(mapped.trajectory.stamps, online.stamps, atol=1e-9)
    assert mapped.grid.occupied.sum() > 100
    with pytest.raises(ConfigError, match="mapper kiss-icp reads point clouds, a CARMEN log holds planar"):
        map_log(made.folder / "scans.clf.gz", mapper="kiss-icp")


class Gyro:
    """Turn by all readings of the inertial unit."""

    reads_clouds, reads_inertial, lost, stats = True, True, False, MapperStats()

    def __init__(self) -> None:
        self._stamps: list[float] = []
        self._poses = [Pose3()]

    def update(self, cloud: PointCloud, imu: Imu | None, readings: ImuReadings) -> Pose3:
        if self._stamps:
            turn = np.diff(readings.stamps, prepend=self._stamps[-1]) @ readings.angular_velocity[:, 2]
            step = Pose3.from_rpy(0.01 * len(readings), readings.acceleration_sigma, 0, 0, 0, turn)
            self._poses.append(self._poses[-1] @ step)
        self._stamps.append(cloud.stamp)
        return self._poses[-1]

    def trajectory(self) -> Trajectory:
        return Trajectory.from_poses(self._stamps, self._poses)


@pytest.mark.slow
def test_recorded_inertial_readings_give_the_same_poses_again(tmp_path: Path) -> None:
    name = f"{__name__}:Gyro"
    run = RunConfig(
        source="simple", mapper=name, lidar="vlp16", seconds=1.0, stand=0.5, bag="mcap", build=SMALL
    )
    made = run_config(run, out=tmp_path / "out")
    assert made.record.scans["imu_rate"] == 200
    online = read_tum(made.folder / "estimate.tum")
    start = Pose3.from_arrays(online.positions[0], online.quaternions[0]).inverse()
    mapped = map_log(made.folder, mapper=name, imu_topic="/imu/data_raw")
    np.testing.assert_allclose(mapped.trajectory.xy, online.moved(start).xy, atol=1e-6)
    np.testing.assert_allclose(mapped.trajectory.yaw, online.moved(start).yaw, atol=1e-6)
    assert abs(mapped.trajectory.xy[-1, 0]) > 1
    with pytest.raises(SourceError, match=r"Gyro needs inertial readings: name their topic by --imu-topic"):
        map_log(made.folder, mapper=name)


def test_a_bag_without_clouds_names_the_mappers_that_fit(run: Path) -> None:
    pytest.importorskip("kiss_icp", reason="the extra [slam] is not installed")
    with pytest.raises(
        SourceError, match=r"bag: holds no topic of point clouds; --mapper hector, .*/scan \("
    ):
        map_log(run / "export" / "bag", mapper="kiss-icp")
