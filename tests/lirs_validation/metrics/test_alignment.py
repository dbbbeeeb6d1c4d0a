"""The alignment as an error of the start frame, aligned map metrics, coverage of the scans."""

import math

import numpy as np
import pytest

from lirs_validation.metrics.alignment import start_alignment
from lirs_validation.metrics.map import map_scores
from lirs_validation.metrics.trajectory import trajectory_errors
from lirs_wct.geometry.grid import OccupancyGrid
from lirs_wct.geometry.heightfield import HeightField
from lirs_wct.geometry.pose import Pose2, Trajectory
from lirs_wct.geometry.walls import WallGrid

FLAT = HeightField(np.zeros((2, 2), np.float32), (60.0, 60.0), (-30.0, -30.0))
START = Pose2(20.0, -7.0, 0.4)


def path(n: int = 101) -> Trajectory:
    """A half circle from the start pose on, in the world frame, 25 scans a second."""
    arc = [START @ Pose2(3 * math.sin(a), 3 - 3 * math.cos(a), a) for a in np.linspace(0, math.pi, n)]
    return Trajectory.from_poses([0.04 * k for k in range(n)], arc)


def room(origin: Pose2) -> tuple[OccupancyGrid, WallGrid]:
    """A room with an L-shaped wall, as a map and as wall cells."""
    p = np.full((120, 160), 0.1)
    p[20, 20:140] = 0.9
    p[20:100, 20] = 0.9
    return OccupancyGrid.from_probability(p, 0.05, origin), WallGrid(p > 0.5, 0.05, origin)


def test_a_shift_and_a_turn_of_the_start_are_measured_at_the_start() -> None:
    """A turn of 3 deg about the start pose moves nothing there, though it is far from the world's origin."""
    turned = path().moved(START @ Pose2(0, 0, math.radians(3)) @ START.inverse())
    found = start_alignment(path(), turned)
    assert found.shift == pytest.approx(0.0, abs=1e-9)
    assert found.turn == pytest.approx(math.radians(3))
    shifted = start_alignment(path(), path().moved(Pose2(0.12, -0.05, 0.0)))
    assert (shifted.shift, shifted.turn) == (pytest.approx(0.13), pytest.approx(0.0, abs=1e-9))


def test_a_path_without_a_meter_says_nothing_of_the_start() -> None:
    still = Trajectory.from_poses([0.0, 0.04, 0.08], [START] * 3)
    assert start_alignment(still, still) is None
    late = Trajectory(path().stamps + 99.0, path().positions, path().quaternions)
    assert start_alignment(path(), late) is None


def test_a_map_that_is_right_but_for_its_start_is_right_after_the_alignment() -> None:
    reference, walls = room(Pose2(18.0, -9.0, 0.2))
    error = Pose2(0.3, 0.1, 0.04)
    alignment = start_alignment(path(), path().moved(error))
    scores = map_scores(reference.moved(error), reference, surface=FLAT, walls=walls, alignment=alignment)
    assert scores.f1 < 0.6
    assert scores.f1_aligned == pytest.approx(1.0)
    assert scores.false_occupied > 0.4
    assert scores.false_occupied_aligned == 0.0
    assert scores.start_turn == pytest.approx(0.04)
    T_back = error.inverse()
    assert scores.start_shift == pytest.approx((T_back @ START).distance(START))
    assert map_scores(reference, reference, surface=FLAT, walls=walls).f1_aligned is None


def test_false_walls_of_the_reference_are_its_own() -> None:
    """A reference with a wall where there is none confirms the same wall of the built map."""
    reference, walls = room(Pose2())
    solid = walls.solid.copy()
    solid[20:100, 20] = False
    scores = map_scores(reference, reference, surface=FLAT, walls=WallGrid(solid, 0.05, Pose2()))
    assert scores.f1 == 1.0
    assert scores.reference_false_occupied == scores.false_occupied
    assert 0.3 < scores.reference_false_occupied < 0.45


def test_two_poses_cover_two_scans() -> None:
    """Two poses can be aligned with any truth: the ATE was 0.000."""
    truth = path()
    two = Trajectory(truth.stamps[[0, -1]], truth.positions[[0, -1]], truth.quaternions[[0, -1]])
    errors = trajectory_errors(truth, two)
    assert errors.ate_rmse == pytest.approx(0.0, abs=1e-9)
    assert errors.scan_coverage == pytest.approx(2 / 101)
    assert trajectory_errors(truth, truth).scan_coverage == 1.0


@pytest.mark.parametrize(("meters", "some"), [(0.999, False), (1.001, True)])
def test_a_meter_of_common_path_is_enough(meters: float, some: bool) -> None:
    """The path is that of the poses compared, not of the whole truth."""
    truth = Trajectory.from_poses(
        [0.0, 1.0, 2.0, 9.0], [Pose2(5.0), Pose2(5.5), Pose2(5.0 + meters), Pose2(99.0)]
    )
    estimate = Trajectory.from_poses([0.0, 1.0, 2.0], [truth.pose2(k) for k in range(3)])
    assert (start_alignment(truth, estimate) is not None) == some


def test_two_common_poses_are_enough_and_a_turn_is_not_negative() -> None:
    truth = Trajectory.from_poses([0.0, 1.0], [Pose2(2.0, 3.0), Pose2(4.0, 3.0)])
    for turn in (0.25, -0.25):
        estimate = Trajectory.from_poses([0.0, 1.0], [Pose2(0.0, 0.0, turn) @ truth.pose2(k) for k in (0, 1)])
        found = start_alignment(truth, estimate)
        assert found.turn == pytest.approx(0.25)
        np.testing.assert_allclose(found.T_world_aligned.as_array(), (0.0, 0.0, -turn), atol=1e-12)
        one = Trajectory.from_poses([0.0], [truth.pose2(0)])
        assert start_alignment(truth, one) is None
