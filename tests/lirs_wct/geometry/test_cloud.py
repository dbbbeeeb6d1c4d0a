"""Clouds: types and shapes are what every reader may rely on."""

from __future__ import annotations

from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest

from lirs_wct.errors import ConfigError
from lirs_wct.geometry.cloud import PointCloud
from lirs_wct.geometry.pose import Pose3


def cloud(n: int = 3) -> PointCloud:
    return PointCloud(np.ones((n, 3), np.float32), np.zeros(n, np.uint16), np.zeros(n, np.float32), 1.5)


def test_a_cloud_is_a_value() -> None:
    assert (len(cloud()), cloud().stamp, cloud().T_base_laser) == (3, 1.5, Pose3())
    assert len(cloud(0)) == 0
    with pytest.raises(FrozenInstanceError):
        cloud().stamp = 2.0  # type: ignore[misc]


def test_it_rolls_where_points_have_times_of_their_own() -> None:
    assert not cloud().rolling
    assert replace(cloud(), time=np.float32([0, 0, 0.1])).rolling


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("xyz", np.ones((3, 3))),
        ("xyz", np.ones((3, 2), np.float32)),
        ("ring", np.zeros(3, np.int64)),
        ("ring", np.zeros(2, np.uint16)),
        ("time", np.zeros((3, 1), np.float32)),
    ],
)
def test_other_types_and_shapes_are_refused(name: str, value: np.ndarray) -> None:
    with pytest.raises(ConfigError, match=r"a cloud needs float32 \(n, 3\), uint16 \(n,\), float32 \(n,\)"):
        replace(cloud(), **{name: value})
