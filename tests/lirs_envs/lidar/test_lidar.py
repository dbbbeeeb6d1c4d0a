import math
from types import SimpleNamespace

import numpy as np
import pytest

from lirs_envs.lidar.lidar import Lidar
from lirs_envs.lidar.presets import LIDARS, LidarPreset, make_lidar_preset
from lirs_envs.lidar.ray_casting import NearestCaster
from lirs_envs.lidar.terrain_rays import EDGE, LEAF, ROW, build_terrain_mipmap
from lirs_wct.errors import ConfigError, SimulationError
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.geometry.pose import Pose3
from tests.lirs_envs.lidar.room import room


def exact(**changes: float) -> LidarPreset:
    figures = {"beams": 361, "fov": math.pi, "rate": 10.0, "range_min": 0.1, "range_max": 30.0}
    return LidarPreset(name="exact", **{**figures, **changes})  # type: ignore[arg-type]


def scanner(preset: LidarPreset, mount: Pose3 | None = None, seed: int = 0) -> Lidar:
    return Lidar(preset, room(), mount or Pose3(), np.random.default_rng(seed))


def test_presets_are_the_devices() -> None:
    planar = {"lms1xx", "lms111", "lms200", "pls", "utm30lx", "urg04lx", "rplidar_a1", "lds01"}
    assert {name for name, lidar in LIDARS.items() if lidar.rings == 1} == planar
    lms = LIDARS["lms111"]
    assert (lms.beams, lms.rate, lms.range_min, lms.range_max, lms.sigma) == (541, 25.0, 0.5, 20.0, 0.012)
    assert math.degrees(lms.angle_increment) == pytest.approx(0.5)
    assert lms.period == pytest.approx(0.04)
    lds = LIDARS["lds01"]
    assert math.degrees(lds.angle_increment) == pytest.approx(1.0), "a full circle closes"
    with pytest.raises(ConfigError, match=r"'lms112'.*legal: lds01, lms111"):
        make_lidar_preset("lms112")


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


def test_a_tilted_lidar_sees_the_ground() -> None:
    scan = scanner(exact()).scan(Pose3.from_rpy(0.0, 0.0, 0.5, 0.0, 0.2, 0.0), 0.0)
    assert scan.ranges[180] == pytest.approx(0.5 / math.sin(0.2), abs=1e-5)


def test_rep_117() -> None:
    lidar = scanner(exact(range_min=3.5, range_max=4.5))
    ranges = lidar.scan(Pose3(0.0, 0.0, 0.5), 0.0).ranges
    assert ranges[0] == -np.inf, "3 m are too near"
    assert ranges[180] == pytest.approx(4.0, abs=1e-5)
    assert ranges[180 + int(math.degrees(math.atan2(3, 4)) * 2)] == np.inf, "the corner is 5 m away"
    assert np.isposinf(lidar.scan(Pose3(0.0, 0.0, 5.0), 0.0).ranges).all(), "above the walls there is nothing"


def test_others_hide_what_is_behind_them() -> None:
    def prop(origin: np.ndarray, directions: np.ndarray, max_range: float) -> np.ndarray:
        assert origin.tolist() == [0.0, 0.0, 0.5]
        assert max_range == 30.0
        return np.where(directions[:, 0] > 0.9, 2.0, np.inf)

    lidar = scanner(exact())
    lidar.caster = NearestCaster(lidar.caster, SimpleNamespace(ranges=prop))
    ranges = lidar.scan(Pose3(0.0, 0.0, 0.5), 0.0).ranges
    assert ranges[180] == 2.0
    assert ranges[0] == pytest.approx(3.0, abs=1e-5)


def test_a_pose_that_is_no_number_is_refused() -> None:
    with pytest.raises(SimulationError, match="finite"):
        scanner(exact()).scan(Pose3(math.nan, 0.0, 0.5), 0.0)


def test_rays_must_be_numbers() -> None:
    caster = room()
    with pytest.raises(ConfigError, match="finite"):
        caster.cast((0.0, 0.0, math.inf), [[0.0, 0.0, 1.0]])
    with pytest.raises(ConfigError, match=r"\(n, 3\)"):
        caster.cast((0.0, 0.0, 0.0), [0.0, 0.0, 1.0])
    with pytest.raises(ConfigError, match="max_range"):
        caster.cast((0.0, 0.0, 0.0), [[0.0, 0.0, 1.0]], math.nan)


@pytest.mark.parametrize("shape", [(2, 2), (9, 10), (5, 29), (18, 34), (7, 140)])
def test_the_mipmap_bounds_every_node(shape: tuple[int, int]) -> None:
    z = np.random.default_rng(0).normal(size=shape).astype(np.float32)
    surface = HeightField(z, (1.0, 1.0), (0.0, 0.0))
    terrain, south_up = build_terrain_mipmap(surface), surface.south_up
    for level in range(LEAF, len(terrain.width)):
        rows, cols = -(-(shape[0] - 1) // 2**level), terrain.width[level]
        for side, sign in enumerate((1, -1)):
            first = terrain.start[level] + side * len(terrain.bound) // 2
            for r in range(rows):
                for c in range(cols):
                    part = south_up[
                        r * 2**level : (r + 1) * 2**level + 1, c * 2**level : (c + 1) * 2**level + 1
                    ]
                    assert terrain.bound[first + r * cols + c] == (sign * part).max()
    assert rows == cols == 1, "the last level is one square"


def test_blocks_hold_every_node_of_their_own() -> None:
    surface = HeightField(np.arange(19 * 28, dtype=np.float32).reshape(19, 28), (1.0, 1.0), (0.0, 0.0))
    terrain = build_terrain_mipmap(surface)
    padded = np.pad(surface.south_up, ((0, 8), (0, 8)), "edge")
    assert len(terrain.block) == 3 * 4
    for number, block in enumerate(terrain.block):
        r, c = EDGE * (number // 4), EDGE * (number % 4)
        np.testing.assert_array_equal(block.reshape(ROW, ROW), padded[r : r + ROW, c : c + ROW])
