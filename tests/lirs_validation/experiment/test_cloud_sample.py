"""The clouds that are kept: spread over the drive, and never more than fit."""

import numpy as np
import pytest

from lirs_validation.metrics.elevation import MOST, CloudSample
from lirs_wct.geometry.cloud import PointCloud


def cloud(stamp: float, n: int = 3) -> PointCloud:
    xyz = np.arange(3 * n, dtype=np.float32).reshape(n, 3)
    return PointCloud(xyz, np.arange(n, dtype=np.uint16), np.zeros(n, np.float32), stamp)


@pytest.mark.parametrize("seconds", [0.0, 5.0, 120.0, 1000.0, 3600.0])
def test_however_long_the_drive_the_sample_is_spread_over_it(seconds: float) -> None:
    sample = CloudSample()
    for k in range(round(10 * seconds) + 1):
        sample.offer(k, cloud(k / 10))
    stamps = np.array([c.stamp for c in sample.clouds])
    assert 1 <= len(stamps) <= MOST
    assert stamps[0] == 0
    assert seconds - stamps[-1] <= sample.period
    np.testing.assert_allclose(np.diff(stamps), sample.period, atol=1e-6)
    np.testing.assert_allclose(np.array(sample.scans) / 10, stamps, atol=1e-6)
    assert len(stamps) > min(seconds, MOST / 2 - 1)


def test_points_on_walkers_are_left_out() -> None:
    sample = CloudSample()
    sample.offer(0, cloud(0.0), np.array([False, True, False]))
    assert sample.clouds[0].ring.tolist() == [0, 2]
    assert sample.clouds[0].xyz.tolist() == [[0, 1, 2], [6, 7, 8]]
