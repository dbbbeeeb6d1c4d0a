"""The odometry's calibration in the loop with the mapper that it serves: minutes of one kind of step."""

import math

import numpy as np
import pytest

from lirs_wct.geometry.pose import Pose2
from slam_baselines.hector.mapper import HectorMapper
from tests.slam_baselines.synthetic import room_scan

SECONDS, RADIUS = 300, 1.5


@pytest.mark.parametrize(("rate", "speed"), [(5.0, 0.5), (5.0, 0.3)])
def test_five_minutes_of_circles_teach_nothing_wrong(rate: float, speed: float) -> None:
    """Odometry 3 % long and turning by itself; with plain forgetting a gain grew beyond 2 within 200 s."""
    rng, mapper, odometry = np.random.default_rng(1), HectorMapper(), Pose2()
    poses = [circle(speed * k / rate) for k in range(int(SECONDS * rate))]
    for k, (before, pose) in enumerate(zip([poses[0], *poses], poses, strict=False)):
        step = before.inverse() @ pose
        slip = Pose2(
            1.03 * step.x + rng.normal(0, 0.001), step.y, step.yaw + 0.02 * step.x + rng.normal(0, 0.002)
        )
        odometry = odometry @ slip if k else odometry
        found = mapper.update(room_scan(pose, k / rate, rng, beams=181), odometry, None)
        assert (poses[0] @ found).distance(pose) < 0.06
        calibration = mapper.reckoning.calibration
        assert max(map(abs, calibration.gain)) < 0.1
        p, q, r = calibration.covariance
        assert p > 0
        assert p * r > q * q
    straight = calibration.correct(Pose2(1.0))
    assert straight.distance(Pose2(1.0)) < 0.05


def circle(meters: float) -> Pose2:
    """Pose after meters of a circle through the room."""
    a = meters / RADIUS
    return Pose2(RADIUS * math.sin(a), RADIUS * (1 - math.cos(a)) - 0.5, a)
