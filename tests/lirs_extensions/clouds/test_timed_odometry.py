"""Odometry whose poses have times of their own: frames, waiting for readings, deskewing."""

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lirs_extensions.clouds.packages import TimedOdometry, TimedSystem, deskew, matrix_of, poses_at
from lirs_wct.arrays import FloatArray
from lirs_wct.geometry import ImuReadings, PointCloud, Pose3
from slam_baselines.kiss_icp import pose_of

PERIOD, SPAN = 0.1, 0.09


def moving(time: float) -> Pose3:
    """Return a base that drives on an arc, tilted, in the system's world."""
    tilted = Pose3.from_rpy(3.0, -1.0, 0.5, 0.1, -0.2, 0.7)
    return tilted @ Pose3.from_rpy(0.8 * time, 0.05 * time, 0.0, 0.0, 0.0, 0.05 * time)


class FakeSystem(TimedSystem):
    """Know the true poses at a share of each sweep; an inertial one needs a second to start."""

    def __init__(self, share: float, *, inertial: bool = False) -> None:
        self.share, self.inertial = share, inertial
        self.reached, self.registered = -1.0, list[float]()

    def add_readings(self, readings: ImuReadings) -> None:
        self.reached = float(readings.stamps[-1])

    def register(self, cloud: PointCloud) -> Sequence[tuple[float, FloatArray]]:
        end = cloud.stamp + SPAN
        assert not self.inertial or self.reached >= end - 2e-3
        self.registered.append(cloud.stamp)
        time = cloud.stamp + self.share * SPAN
        running = not self.inertial or cloud.stamp >= 1.0
        return [(time, matrix_of(moving(time - 1.5 * self.inertial) if running else Pose3()))]


def sweep(stamp: float, points: int = 2) -> PointCloud:
    times = np.linspace(0, SPAN, points, dtype=np.float32)
    return PointCloud(np.ones((points, 3), np.float32), np.zeros(points, np.uint16), times, stamp)


def readings(stamp: float) -> ImuReadings:
    stamps = np.arange(20 if stamp else 0) * 0.005 + stamp - 0.095
    return ImuReadings(stamps, np.zeros((len(stamps), 3)), np.zeros((len(stamps), 3)))


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_poses_are_those_at_the_stamps(share: float) -> None:
    mapper = TimedOdometry(FakeSystem(share))
    online = [mapper.update(sweep(PERIOD * k), None) for k in range(30)]
    first = moving(0.0 if share == 0 else share * SPAN).inverse()
    found = mapper.trajectory()
    for k in range(1, 30):
        expected = (first @ moving(PERIOD * k)).position
        np.testing.assert_allclose(found.positions[k], expected, atol=2e-4)
        if k > 1:
            np.testing.assert_allclose(online[k].position, expected, atol=2e-4)
    assert found.stamps.tolist() == [PERIOD * k for k in range(30)]


def test_a_sweep_waits_for_the_readings_that_cover_it() -> None:
    system = FakeSystem(1.0, inertial=True)
    mapper = TimedOdometry(system)
    for k in range(40):
        mapper.update(sweep(PERIOD * k), None, readings(PERIOD * k))
        assert len(system.registered) == k
    assert mapper.stats.skipped == {"after the last reading": 1}
    assert (mapper.stats.received, mapper.stats.used) == (40, 39)
    # The first pose that differs from the initial one is the first base pose.
    first = moving(1.0 + SPAN - 1.5).inverse()
    np.testing.assert_allclose(mapper.trajectory().positions[5], np.zeros(3), atol=1e-12)
    expected = (first @ moving(3.5 - 1.5)).position
    np.testing.assert_allclose(mapper.trajectory().positions[35], expected, atol=2e-4)


def test_a_sweep_without_points_is_counted_and_left_out() -> None:
    system = FakeSystem(0.0)
    mapper = TimedOdometry(system)
    for k in range(6):
        mapper.update(sweep(PERIOD * k, 0 if k == 3 else 2), None)
    assert mapper.stats.skipped == {"empty": 1}
    np.testing.assert_allclose(mapper.trajectory().positions[3, 0], 0.24, atol=2e-3)


def test_poses_between_and_beyond_two_are_those_of_a_constant_velocity() -> None:
    poses = [Pose3.from_rpy(0, 0, 0, 0, 0, 0.1), Pose3.from_rpy(1, 0, 2, 0, 0, 0.2)]
    middle, beyond = poses_at([1.0, 2.0], poses, [1.5, 2.5])
    np.testing.assert_allclose(middle.position, (0.5, 0, 1))
    np.testing.assert_allclose(beyond.position, (1.5, 0, 3))
    assert middle.yaw == pytest.approx(0.15)
    assert beyond.yaw == pytest.approx(0.25, abs=1e-4)


def test_a_rolling_sweep_is_seen_from_its_middle() -> None:
    """Points that stand still in the world, each seen from where the sensor was at its time."""
    rng = np.random.default_rng(1)
    world, times = rng.uniform(-20, 20, (500, 3)), np.linspace(0, SPAN, 500)
    twist = np.array((0.01, -0.02, 0.06))

    def sensor(time: float) -> Pose3:
        q = Rotation.from_rotvec(twist * time / SPAN).as_quat(scalar_first=True)
        return Pose3.from_arrays(np.array((0.1, 0.0, 0.02)) * time / SPAN, q)

    seen = np.array([sensor(t).inverse().apply(p) for t, p in zip(times, world, strict=True)])
    motion = matrix_of(sensor(SPAN))
    expected = sensor(SPAN / 2).inverse().apply(world)
    assert np.abs(seen - expected).max() > 0.3
    np.testing.assert_allclose(deskew(seen, times, motion), expected, atol=3e-3)
    np.testing.assert_array_equal(deskew(seen, np.empty(0), motion), seen)


def test_the_pose_of_a_matrix_is_scipys() -> None:
    for rotation in Rotation.random(50, rng=np.random.default_rng(2)):
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = rotation.as_matrix(), (1, 2, 3)
        np.testing.assert_allclose(pose_of(matrix).rotation, rotation.as_matrix(), atol=1e-14)
        np.testing.assert_array_equal(pose_of(matrix).position, (1, 2, 3))
