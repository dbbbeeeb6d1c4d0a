"""Readings of sensors: planar scans, point clouds."""

from __future__ import annotations

import math
from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest

from lirs_wct.errors import ConfigError
from lirs_wct.geometry.pose import Pose3
from lirs_wct.geometry.scan import LaserScan, PointCloud


def scan(ranges: list[float]) -> LaserScan:
    return LaserScan(np.float32(ranges), -1.5, 0.25, 0.5, 8.0, 12.5)


def test_angles_go_counter_clockwise_from_the_first_beam() -> None:
    assert scan([1.0] * 4).angles.tolist() == [-1.5, -1.25, -1.0, -0.75]
    assert scan([]).angles.shape == (0,)
    assert (scan([1.0]).T_base_laser, scan([1.0]).time_increment) == (Pose3(), 0.0)


def test_hits_lie_within_the_sensors_range_its_ends_included() -> None:
    readings = [0.49, 0.5, 4.0, 8.0, 8.01, math.inf, -math.inf, math.nan]
    assert scan(readings).hits.tolist() == [False, True, True, True, False, False, False, False]


@pytest.mark.parametrize("ranges", [np.zeros(3), np.zeros((3, 1), np.float32), np.float32(1.0)])
def test_ranges_are_a_vector_of_float32(ranges: np.ndarray) -> None:
    with pytest.raises(ConfigError, match="ranges must be a vector of float32"):
        LaserScan(ranges, 0.0, 0.1, 0.1, 9.0, 0.0)


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
        ("intensity", np.zeros(3)),
        ("column", np.zeros(2, np.uint16)),
    ],
)
def test_other_types_and_shapes_are_refused(name: str, value: np.ndarray) -> None:
    with pytest.raises(
        ConfigError, match=r"a cloud of 3 points needs float32 \(3, 3\), uint16 \(3,\), float32 \(3,\)"
    ):
        replace(cloud(), **{name: value})


def test_columns_must_fit_the_shape() -> None:
    with pytest.raises(ConfigError, match=r"\(1, 1\) rings and columns does not fit the shape \(0, 0\)"):
        replace(cloud(), column=np.zeros(3, np.uint16))


def test_an_organized_cloud_keeps_beams_without_return() -> None:
    rng = np.random.default_rng(0)
    column = np.array((0, 3, 2), np.uint16)
    some = PointCloud(
        rng.normal(size=(3, 3)).astype(np.float32),
        np.array((0, 0, 1), np.uint16),
        column * np.float32(0.01),
        1.0,
        intensity=np.array((1, 2, 3), np.float32),
        column=column,
        shape=(2, 5),
    )
    beams = some.organized()
    assert beams.shape == (2, 5)
    assert np.isfinite(beams["x"]).sum() == 3
    np.testing.assert_array_equal(beams["ring"], np.repeat([[0], [1]], 5, axis=1))
    np.testing.assert_allclose(beams["time"], np.tile(0.01 * np.arange(5), (2, 1)), rtol=1e-6)
    np.testing.assert_array_equal(beams[some.ring, some.column], some.records())
    half = some.select(np.array((True, False, True)))
    np.testing.assert_array_equal(half.records(), some.records()[[0, 2]])
    np.testing.assert_array_equal(some.by_time().records(), some.records()[[0, 2, 1]])
    for other in (cloud(), some.by_time()):
        with pytest.raises(ConfigError, match="not organized"):
            other.organized()
