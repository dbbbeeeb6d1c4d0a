"""Clouds: types and shapes are what every reader may rely on."""

from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest

from lirs_wct.errors import ConfigError
from lirs_wct.geometry.pose import Pose3
from lirs_wct.geometry.scan import PointCloud


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
    with pytest.raises(ConfigError, match="not organized"):
        cloud().organized()
