"""All methods as published: a drive through a room, and no use of the attitude."""

from typing import Any

import numpy as np
import pytest

from lirs_wct import Imu
from slam_baselines.mapper import make_mapper
from tests.slam_baselines.synthetic import drive_room, loop, room_scan

NAMES = ("hector_original", "gmapping_original", "cartographer_original", "slam_toolbox_original")


@pytest.mark.parametrize(
    ("name", "drive", "error"),
    [
        ("hector_original", {}, 0.06),
        ("hector_original", {"odometry": False}, 0.06),
        ("gmapping_original", {}, 0.15),
        ("cartographer_original", {}, 0.15),
        ("slam_toolbox_original", {}, 0.15),
        pytest.param("cartographer_original", {"odometry": False, "n": 480}, 0.2, marks=pytest.mark.slow),
    ],
)
def test_a_drive_through_a_room(name: str, drive: dict[str, Any], error: float) -> None:
    """Without odometry, the search makes up for Cartographer's start at full speed."""
    search = {"use_online_correlative_scan_matching": True} if "n" in drive else {}
    mapper = make_mapper(name, **search)
    errors = drive_room(mapper, **drive)
    assert np.hypot(errors[:, 0], errors[:, 1]).max() < error
    assert mapper.map().occupied.sum() > 300
    assert (mapper.stats.received, len(mapper.trajectory()), mapper.lost) == (len(errors), len(errors), False)


@pytest.mark.parametrize("name", NAMES)
def test_attitude_changes_nothing(name: str) -> None:
    rng, path = np.random.default_rng(0), loop(40)
    level, leaning = make_mapper(name), make_mapper(name)
    for k, pose in enumerate(path):
        scan = room_scan(pose, 0.1 * k, rng)
        assert level.update(scan, pose, None) == leaning.update(scan, pose, Imu(roll=0.2, pitch=-0.1))
