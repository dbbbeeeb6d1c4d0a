"""The large site is what tests of memory and of sparse scans take it for."""

import numpy as np
import pytest

from tests.slam_baselines.large_site import RANGE, drive_site


def test_the_large_site_is_seen_from_afar_on_a_long_drive():
    drive = drive_site()
    assert len(drive.scans) == len(drive.odometry) == len(drive.truth) == 2000
    steps = [a.distance(b) for a, b in zip(drive.truth, drive.truth[1:], strict=False)]
    assert sum(steps) == pytest.approx(1750, abs=2)
    assert max(steps) < 0.9
    ranges = np.array([scan.ranges for scan in drive.scans])
    hit = np.isfinite(ranges)
    assert 0.6 < hit.mean() < 0.9
    assert np.quantile(ranges[hit], 0.95) > 60
    assert ranges[hit].max() <= RANGE + 0.1
    assert 10 < drive.truth[-1].distance(drive.odometry[-1]) < 60
