from dataclasses import replace
from pathlib import Path

import pytest

from lirs_envs.lidar.noise import LidarNoise
from lirs_envs.robots.robot import make_robot
from lirs_envs.sensing.imu import ImuConfig
from lirs_envs.sensing.sensors import SensorNoise, read_noise, resolve_noise, write_noise
from lirs_envs.sensing.wheel_odometry import OdometryConfig
from lirs_validation.config import RunConfig
from lirs_validation.experiment.scenario import build_scenario
from lirs_wct import ConfigError, SourceError

OWN = SensorNoise(
    lidar=LidarNoise(sigma=0.02, dropout=0.01),
    odometry=OdometryConfig(scale_sigma=0.05),
    imu=ImuConfig(rate_sigma=0.01),
)


def test_a_written_file_is_read_again(tmp_path: Path) -> None:
    write_noise(tmp_path / "own.yaml", OWN, "of a test")
    assert read_noise(tmp_path / "own.yaml") == OWN
    assert (tmp_path / "own.yaml").read_text().startswith("# of a test\n")
    with pytest.raises(ConfigError, match="got level 'simulated'"):
        write_noise(tmp_path / "level.yaml", SensorNoise(), "")


def test_omitted_sections_and_fields_keep_their_defaults(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("lidar: {sigma: 0.02}\n")
    assert read_noise(tmp_path / "a.yaml") == SensorNoise(lidar=LidarNoise(sigma=0.02))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "must hold sections, got none; legal: lidar, odometry, imu"),
        ("lidra: {}", "unknown section 'lidra'"),
        ("lidar: 3", "section lidar must hold fields, got 3; legal: sigma,"),
        ("lidar: {sigmo: 1}", "unknown field of lidar 'sigmo'"),
        ("lidar: {sigma: thick}", "sigma of the lidar noise must be a finite number at least 0, got 'thick'"),
        ("lidar: {sigma: -1}", "sigma of the lidar noise must be"),
        ("lidar: {sigma: 1", "line 1"),
    ],
)
def test_a_bad_file_is_named_with_the_fault(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    with pytest.raises(SourceError, match=message) as caught:
        read_noise(path)
    assert str(caught.value).startswith(f"{path}: ")


def test_a_run_takes_its_noise_from_a_level_or_a_file(tmp_path: Path) -> None:
    path = tmp_path / "own.yaml"
    write_noise(path, OWN, "of a test")
    config = RunConfig(source="simple", noise=str(path), odometry_noise=2.0)
    noise = build_scenario(config).simulation(make_robot("husky")).config.noise
    assert noise == OWN.with_odometry_noise(2.0)
    assert resolve_noise("datasheet") == SensorNoise(lidar="datasheet")
    before = config.digest
    write_noise(path, replace(OWN, lidar=LidarNoise()), "of a test")
    assert config.digest != before, "other content, other experiment"
    with pytest.raises(ConfigError, match=r"unknown noise 'loud'; legal: FILE.yaml, datasheet, none"):
        RunConfig(source="simple", noise="loud")
    with pytest.raises(SourceError, match=r"absent\.yaml: cannot be read"):
        resolve_noise(str(tmp_path / "absent.yaml"))
