"""A run without attitude: no mapper learns how the robot is tilted, a user's own included."""

from pathlib import Path

import numpy as np
import pytest

from lirs_validation import validate
from lirs_validation.config import ATTITUDES, Attitude, RunConfig
from lirs_wct.errors import ConfigError
from lirs_wct.formats.drive_csv import read_imu

NOTING = r"""
from lirs_wct.geometry.pose import Trajectory
from slam_baselines.mapper import MapperStats
from slam_baselines.mapping.known_pose import KnownPoseMapper


class Noting:
    lost = False

    def __init__(self):
        self._builder, self._stamps, self._poses = KnownPoseMapper(0.05), [], []

    def update(self, scan, odometry, imu):
        with open("given.txt", "a") as file:
            file.write(f"{imu is None}\n")
        self._builder.update(scan, odometry, imu)
        self._stamps.append(scan.stamp)
        self._poses.append(odometry)
        return odometry

    def map(self):
        return self._builder.map()

    def trajectory(self):
        return Trajectory.from_poses(self._stamps, self._poses)

    @property
    def stats(self):
        return MapperStats(received=len(self._poses))
"""


@pytest.mark.parametrize("attitude", ATTITUDES)
def test_a_users_mapper_is_given_the_readings_or_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, attitude: Attitude
) -> None:
    (tmp_path / "noting_slam.py").write_text(NOTING)
    monkeypatch.chdir(tmp_path)
    run = validate("advanced", mapper="noting_slam:Noting", seconds=1, attitude=attitude, out=tmp_path)
    without_reading = (tmp_path / "given.txt").read_text().split()
    assert len(without_reading) >= len(run.log.observations) > 20
    assert set(without_reading) == {str(attitude == "none")}
    assert run.record.config.attitude == attitude
    # What was recorded, and the map at the true poses, have the attitude in either case.
    assert run.folder is not None
    assert any(abs(imu.pitch) > 0.01 for imu in read_imu(run.folder / "imu.csv.gz"))


def test_only_the_mapper_loses_the_attitude() -> None:
    runs = [validate("advanced", seconds=4, attitude=attitude) for attitude in ATTITUDES]
    truths, estimates = ([run.log.trajectories()[k].positions for run in runs] for k in (0, 1))
    np.testing.assert_array_equal(*truths)
    np.testing.assert_array_equal(*(run.maps.true_pose.log_odds for run in runs))
    assert not np.array_equal(*estimates)


def test_an_attitude_that_is_none_is_refused() -> None:
    with pytest.raises(ConfigError, match="unknown attitude 'true'; legal: imu, none"):
        RunConfig(source="simple", attitude="true")  # type: ignore[arg-type]
