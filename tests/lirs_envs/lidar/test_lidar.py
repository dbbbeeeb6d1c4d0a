import math

import numpy as np
import pytest

from lirs_envs.lidar.lidar import Lidar
from lirs_envs.lidar.presets import LidarPreset
from lirs_wct.errors import ConfigError
from lirs_wct.geometry.pose import Pose3
from tests.lirs_envs.lidar.room import room


def exact(**changes: float) -> LidarPreset:
    figures = {"beams": 361, "fov": math.pi, "rate": 10.0, "range_min": 0.1, "range_max": 30.0}
    return LidarPreset(name="exact", **{**figures, **changes})  # type: ignore[arg-type]


def scanner(preset: LidarPreset, mount: Pose3 | None = None, seed: int = 0) -> Lidar:
    return Lidar(preset, room(), mount or Pose3(), np.random.default_rng(seed))


@pytest.mark.parametrize(
    "changes",
    [
        {"beams": 1},
        {"fov": 7.0},
        {"rate": 0.0},
        {"range_min": 31.0},
        {"range_max": math.inf},
        {"sigma": -1.0},
    ],
)
def test_presets_refuse_what_no_device_has(changes: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match="of lidar 'exact'"):
        exact(**changes)


def test_ranges_in_a_room() -> None:
    scan = scanner(exact()).scan(Pose3(0.0, 0.0, 0.5), 1.25)
    assert scan.ranges.dtype == np.float32
    assert scan.stamp == 1.25
    assert scan.ranges[180] == pytest.approx(4.0, abs=1e-5)
    assert scan.ranges[0] == pytest.approx(3.0, abs=1e-5)
    ends = scan.ranges[:, None] * np.stack((np.cos(scan.angles), np.sin(scan.angles)), axis=1)
    assert np.minimum(abs(abs(ends[:, 0]) - 4.0), abs(abs(ends[:, 1]) - 3.0)).max() < 1e-5


def test_the_mount_and_the_pose_move_the_rays() -> None:
    mount = Pose3.from_rpy(0.5, 0.0, 0.3, 0.0, 0.0, math.pi / 2)
    scan = scanner(exact(), mount).scan(Pose3.from_rpy(1.0, 0.0, 0.2, 0.0, 0.0, math.pi), 0.0)
    # The base looks west from x = 1, the laser sits half a meter west of it and looks south.
    assert scan.ranges[180] == pytest.approx(3.0, abs=1e-5)
    assert scan.ranges[0] == pytest.approx(4.5, abs=1e-5)
    assert scan.T_base_laser == mount


def test_rep_117() -> None:
    lidar = scanner(exact(range_min=3.5, range_max=4.5))
    ranges = lidar.scan(Pose3(0.0, 0.0, 0.5), 0.0).ranges
    assert ranges[0] == -np.inf, "3 m are too near"
    assert ranges[180] == pytest.approx(4.0, abs=1e-5)
    assert ranges[180 + int(math.degrees(math.atan2(3, 4)) * 2)] == np.inf, "the corner is 5 m away"
    assert np.isposinf(lidar.scan(Pose3(0.0, 0.0, 5.0), 0.0).ranges).all(), "above the walls there is nothing"


def test_rays_must_be_numbers() -> None:
    caster = room()
    with pytest.raises(ConfigError, match="finite"):
        caster.cast((0.0, 0.0, math.inf), [[0.0, 0.0, 1.0]])
    with pytest.raises(ConfigError, match=r"\(n, 3\)"):
        caster.cast((0.0, 0.0, 0.0), [0.0, 0.0, 1.0])
    with pytest.raises(ConfigError, match="max_range"):
        caster.cast((0.0, 0.0, 0.0), [[0.0, 0.0, 1.0]], math.nan)
